"""The fixes of a drive: how good they are, over time, and how near to the images."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import (
    Bool,
    BuildSettings,
    FieldgridError,
    Figure,
    Finding,
    Float64,
    Int64,
    Quality,
    commonest_reason,
    grouped_reasons,
    info,
    warning,
)
from fieldgrid.geometry import MAX_GAP_NS, NOT_SAID, FixColumns, Status, Steps, Trajectory
from fieldgrid.pipeline.poses import estimate_drive
from fieldgrid.poses import ConditioningSummary, Estimate, Gate
from fieldgrid.recordings import Recording

REJECTED_SHARE, UNUSABLE_SHARE = 0.1, 0.1
"""More of the fixes, or of the frames, than this are worth a warning."""

LEAST_RATE_HZ = 0.9
"""A receiver of 1 Hz may be late."""

COARSE_QUANTUM_M = 0.05
"""Positions that are written more coarsely than a cell."""

POOR_SIGMA_M = 0.5

_HEADINGS = ("smooth", "recorded", "course")

STRETCHES = 10
"""Parts of equal time over which the quality is told."""

_NEVER_NS = 1 << 61
"""Before the first fix and after the last one: no drive is so far from 1970."""


class Sync(NamedTuple):
    """How near the images are to accepted fixes, seconds, and the share of them that has none
    near enough on both sides for a pose. Image times include the declared offset."""

    median_s: float
    most_s: float
    without_share: float


class FixStretch(NamedTuple):
    """A part of the drive: seconds since its first fix, its fixes, and how good they are."""

    start_s: float
    fixes: int
    accepted_share: float | None
    quality: str
    sigma_m: float | None


class FixSummary(NamedTuple):
    """The fixes in numbers; None for what the receiver does not say. `accepted` are those with a
    pose that a build uses, of those that `log` lets pass."""

    log: ConditioningSummary
    accepted: int
    quality: dict[str, float]
    satellites: float | None
    hdop: float | None
    age_s: float | None
    sigma_m: float | None
    stretches: tuple[FixStretch, ...]

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            **self.log.as_dict(),
            "accepted": self.accepted,
            "quality_share": self.quality,
            "satellites_median": self.satellites,
            "hdop_median": self.hdop,
            "age_s_median": self.age_s,
            "sigma_m_median": self.sigma_m,
            "over_time": [stretch._asdict() for stretch in self.stretches],
        }


def summarise_fixes(fixes: FixColumns, estimate: Estimate) -> FixSummary:
    """The quality of the fixes of a drive, as a whole and over time, judged by an estimate."""
    fixes, log = fixes.in_order(), estimate.report.conditioning
    accepted = estimate.trajectory.accepted[estimate.fix_row]
    counts = sorted(log.quality, key=lambda one: -one[1])
    return FixSummary(
        log=log,
        accepted=int(accepted.sum()),
        quality={quality.label: count / len(fixes) for quality, count in counts},
        satellites=_median(fixes.satellites[fixes.satellites != NOT_SAID]),
        hdop=_median(fixes.hdop),
        age_s=_median(fixes.age_s),
        sigma_m=_median(fixes.position_sigma_m()),
        stretches=_stretches(fixes, accepted),
    )


def synchronisation(images_ns: Int64, times_ns: Int64) -> Sync | None:
    """How near images are to accepted fixes, both in order of time; None without either."""
    if not len(times_ns) or not len(images_ns):
        return None
    known_ns = np.concatenate([[-_NEVER_NS], times_ns, [_NEVER_NS]])
    after = np.searchsorted(known_ns, images_ns)
    earlier, later = known_ns[after - 1], known_ns[after]
    nearest_ns = np.minimum(later - images_ns, images_ns - earlier)
    without = (nearest_ns > 0) & (later - earlier > MAX_GAP_NS)
    return Sync(
        float(np.median(nearest_ns)) / 1e9, float(nearest_ns.max()) / 1e9, float(without.mean())
    )


def fix_findings(summary: FixSummary) -> Iterator[Finding]:
    """What is wrong with the fixes."""
    log = summary.log
    repeats = sum(one.fixes for one in log.rejected if one.gate is Gate.REPEAT)
    if repeats > REJECTED_SHARE * log.fixes:
        yield info(
            "fix-repeats",
            f"{repeats} of {log.fixes} fixes repeat the position before them and are left out.",
            "The log is written more often than the receiver solves; no data are lost.",
        )
    written, faulty = log.fixes - repeats, log.fixes - log.accepted - repeats
    if faulty > REJECTED_SHARE * written:
        commonest = next(one for one in log.rejected if one.gate is not Gate.REPEAT)
        yield warning(
            "fixes-rejected",
            f"{faulty} of {written} fixes are rejected, {commonest.fixes} of them because: "
            f"{commonest.example}.",
            "Choose a better log with --gnss, or loosen the gates of [pose.gnss] in --config.",
        )
    if 0.0 < log.rate_hz < LEAST_RATE_HZ:
        yield warning(
            "fix-rate",
            f"The fixes come at {log.rate_hz:.2f} Hz, and there are no poses in gaps of more than "
            f"{MAX_GAP_NS / 1e9:.1f} s.",
            "Let the receiver write 5 Hz or more.",
            Figure(log.rate_hz, "Hz"),
        )
    if log.gaps:
        longest = max(log.gaps, key=lambda gap: gap.seconds)
        yield warning(
            "fix-gaps",
            f"There are {len(log.gaps)} gaps without a usable fix, the longest of "
            f"{longest.seconds:.1f} s.",
            "Frames in them have no pose, unless gyro, wheels and camera bridge the gap.",
            Figure(longest.seconds, "s"),
        )
    if log.seams:
        yield warning(
            "fix-seams",
            f"The GNSS solution shifts {len(log.seams)} times: {log.seams[0].reason}.",
            "The map has an offset there; prefer a log with one kind of solution throughout.",
        )
    if log.quantum_m > COARSE_QUANTUM_M:
        yield warning(
            "fix-digits",
            f"Positions are written in steps of {log.quantum_m:.2f} m.",
            "Let the receiver write more decimals (high precision mode, or UBX).",
            Figure(log.quantum_m, "m"),
        )
    if summary.sigma_m is not None and summary.sigma_m > POOR_SIGMA_M:
        yield info(
            "fix-sigma",
            f"The error of a fix is {summary.sigma_m:.2f} m, as reported or as is typical of "
            f"{next(iter(summary.quality))}.",
            "Use correction data (RTK, PPP) for cells finer than that.",
            Figure(summary.sigma_m, "m"),
        )


def sync_findings(sync: Sync) -> Iterator[Finding]:
    """What is wrong between images and fixes."""
    if sync.without_share > UNUSABLE_SHARE:
        yield info(
            "images-without-fix",
            f"{100.0 * sync.without_share:.0f} % of the images lie between no two accepted "
            f"fixes less than {MAX_GAP_NS / 1e9:.1f} s apart; the farthest is "
            f"{sync.most_s:.1f} s from a fix.",
            "Their poses rely on gyro, wheels and camera; start the receiver before the camera.",
        )


def pose_findings(
    recording: Recording, settings: BuildSettings, steps: Steps | None, reasons: Counter[str]
) -> Iterator[Finding]:
    """How many frames will be without a pose, mostly why, and the heading that gives more of them
    one, where one does."""
    lost, frames = reasons.total(), recording.frame_count
    if lost > UNUSABLE_SHARE * frames:
        count, reason = grouped_reasons(reasons)[0]
        fewest, advice = lost, ""
        for heading in _HEADINGS:
            pose = settings.pose.model_copy(update={"heading": heading})
            with suppress(FieldgridError):
                other = settings.model_copy(update={"pose": pose})
                track = estimate_drive(recording, other, steps=steps).trajectory
                left = rejections(recording.image_times_ns(), track).total()
                if left < fewest:
                    fewest, advice = left, f"With --heading {heading} {frames - left} have one. "
        yield warning(
            "frames-unusable",
            f"{lost} of {frames} frames will have no usable pose, {count} of them because: "
            f"{reason}.",
            f"{advice}See `fieldgrid track --figure`.",
        )


def rejections(images_ns: Int64, trajectory: Trajectory) -> Counter[str]:
    """How many frames would be rejected for each reason."""
    if not trajectory.accepted.any():
        return Counter({commonest_reason(trajectory.reason): len(images_ns)})
    poses = map(trajectory.at, images_ns.tolist())
    return Counter(pose.reason for pose in poses if pose.status is not Status.OK)


def _stretches(fixes: FixColumns, accepted: Bool) -> tuple[FixStretch, ...]:
    if not len(fixes):
        return ()
    times_s = (fixes.time_ns - fixes.time_ns[0]) / 1e9
    length_s = max(float(times_s[-1]), 1e-9) / STRETCHES
    part = np.minimum((times_s / length_s).astype(np.intp), STRETCHES - 1)
    found = []
    for k in range(STRETCHES):
        own = fixes[part == k]
        commonest = Counter(own.quality.tolist()).most_common(1)
        found.append(
            FixStretch(
                start_s=k * length_s,
                fixes=len(own),
                accepted_share=float(accepted[part == k].mean()) if len(own) else None,
                quality=Quality(commonest[0][0]).label if commonest else "",
                sigma_m=_median(own.position_sigma_m()),
            )
        )
    return tuple(found)


def _median(values: Float64 | Int64) -> float | None:
    known = values[np.isfinite(values)]
    return float(np.median(known)) if known.size else None
