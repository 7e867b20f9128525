"""Roll and pitch of the vehicle against the truth."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from fieldgrid.field.evaluation.truth import TruthPose
from fieldgrid.maps import FrameRecord
from fieldgrid.poses import Attitude


@dataclass(frozen=True, slots=True)
class AttitudeScores:
    """Absolute errors of roll and pitch, both together, in degrees, in `frames` of accepted poses.

    `within_3_sigma` is the share of them that are at most three times their stated sigma.
    """

    frames: int
    median_deg: float
    p95_deg: float
    max_deg: float
    within_3_sigma: float


def score_attitude(
    attitudes: Mapping[str, Attitude], pairs: Iterable[tuple[FrameRecord, TruthPose]]
) -> AttitudeScores | None:
    """Compare the attitude of sessions, by name, with the truth at the instants of their accepted
    frames; None where no session has one, or the truth has neither roll nor pitch."""
    errors, sigmas = [], []
    for record, true in pairs:
        attitude = attitudes.get(record.session)
        if attitude is None or not record.accepted or not np.isfinite(true.roll_deg):
            continue
        at = attitude.at(np.array([record.driven.time_ns]))
        errors.append((at.roll_deg[0] - true.roll_deg, at.pitch_deg[0] - true.pitch_deg))
        sigmas.append((at.roll_sigma_deg[0], at.pitch_sigma_deg[0]))
    if not errors:
        return None
    away = np.abs(errors)
    return AttitudeScores(
        frames=len(errors),
        median_deg=float(np.median(away)),
        p95_deg=float(np.percentile(away, 95)),
        max_deg=float(away.max()),
        within_3_sigma=float(np.mean(away <= 3.0 * np.array(sigmas))),
    )
