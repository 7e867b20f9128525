"""What is wrong with the images, by the pairs that were looked at closely."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.array_types import Float64
from fieldgrid.inspection.findings import Finding, error, stop, warning
from fieldgrid.inspection.looking import Unread
from fieldgrid.inspection.measures import Look
from fieldgrid.plane_fit import robust_plane

DARK_SHARE, DARK_MEAN = 0.5, 30.0
"""An image is dark when half of it is noise, or its mean is so low."""

SATURATED_SHARE = 0.25
"""Sky and sun take some of any image; a quarter is too much."""

BLURRED = 0.42
"""Above that of a sharp image smoothed by 1.5 pixels; see :func:`~.measures.blur`."""

FEWEST_POINTS = 60
"""Odometry needs 30 in each of two frames, and not all are found again."""

EXPOSURE_RATIO = 1.25
"""The brighter image of a pair is brighter by more than this."""

WORTH_SHARE = 0.2
"""A fault in fewer of the pairs than this, and in fewer than two, is chance."""

SHIFT_WARN_PX, SHIFT_ERROR_PX = 0.5, 1.5
"""Vertical misalignment: matching suffers, and matching fails."""

SCATTER_PX = 1.0
"""The shift of a pair that changes by more than this between pairs is no calibration."""

FEWEST_SHIFTS = 40

SHIFT_SIGMA_PX = (1e6, 30.0, 30.0)
"""Nothing is known of the shift itself, and little of how it grows across the image: enough to
leave it level where all matches lie on a line."""


class Misalignment(NamedTuple):
    """How many rows lower the right images lie, in pixels: `median_px` of all matches,
    `residual_px` the median size of a shift that may also grow across the image;
    `roll_deg` of the right camera against the left, `scatter_px` between the pairs, `matches`
    how many points."""

    median_px: float
    residual_px: float
    roll_deg: float
    scatter_px: float
    matches: int

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return self._asdict()


def misalignment(looks: Sequence[Look], size_px: tuple[int, int]) -> Misalignment | None:
    """The vertical misalignment of all pairs together; None with too few matches."""
    shifts = np.concatenate([look.shifts for look in looks]) if looks else np.zeros((0, 3))
    if len(shifts) < FEWEST_SHIFTS:
        return None
    width, height = size_px
    x, y = shifts[:, 0] / width - 0.5, shifts[:, 1] / height - 0.5
    median_px = float(np.median(shifts[:, 2]))

    def cutoff(_: int, residuals: Float64) -> float:
        return 4.0 * max(1.4826 * float(np.median(np.abs(residuals))), 0.05)

    plane, _ = robust_plane(
        x,
        y,
        shifts[:, 2],
        np.ones(len(x)),
        cutoff,
        prior_sigma=SHIFT_SIGMA_PX,
        start=(median_px, 0.0, 0.0),
    )
    # What matching meets of it, without the scatter of the matches themselves.
    residual_px = float(np.median(np.abs(plane[0] + plane[1] * x + plane[2] * y)))
    each = [look.shift_px for look in looks]
    known = np.array([shift for shift in each if shift is not None])
    off = np.abs(known - np.median(known)) if known.size else np.zeros(1)
    return Misalignment(
        median_px=median_px,
        residual_px=residual_px,
        roll_deg=float(np.degrees(np.arctan(plane[1] / width))),
        scatter_px=1.4826 * float(np.median(off)),
        matches=len(shifts),
    )


def unread_findings(unread: Sequence[Unread], looked: int) -> Iterator[Finding]:
    """Frames that cannot be had, at the first of which a build ends."""
    misfits = [one for one in unread if one.misfit]
    if misfits:
        yield stop(
            "image-size",
            f"{len(misfits)} of {looked} frames that were looked at are not those of the "
            f"calibration. First: {misfits[0].problem}",
            "Give the calibration of these images: of their size, and not turned or cropped.",
        )
    elif unread:
        yield stop(
            "images-unreadable",
            f"{len(unread)} of {looked} frames that were looked at cannot be read. First: "
            f"{unread[0].problem}",
            "Restore the files, or leave these frames out of the recording.",
        )


def image_findings(looks: Sequence[Look]) -> Iterator[Finding]:
    """Exposure, sharpness and texture."""
    count = len(looks)

    def share(is_so: Callable[[Look], bool]) -> int:
        found = sum(is_so(look) for look in looks)
        return found if found >= max(2.0, WORTH_SHARE * count) or found == count else 0

    dark = share(_is_dark)
    if dark:
        yield warning(
            "images-dark",
            f"{dark} of {count} pairs that were looked at are dark, the darkest with a mean of "
            f"{min(min(look.brightness) for look in looks):.0f} of 255.",
            "Expose longer, open the lens, or drive by day.",
        )
    saturated = share(lambda look: look.saturated_share > SATURATED_SHARE)
    if saturated:
        most = max(look.saturated_share for look in looks)
        yield warning(
            "images-saturated",
            f"{saturated} of {count} pairs that were looked at are saturated, up to "
            f"{100.0 * most:.0f} % of the image.",
            "Expose for the ground, not for the sky; shorten the exposure.",
        )
    blurred = share(lambda look: not _is_dark(look) and look.blur > BLURRED)
    if blurred:
        yield warning(
            "images-blurred",
            f"{blurred} of {count} pairs that were looked at are blurred: {_worst_blur(looks):.2f} "
            f"by Crete's measure, where sharp images have 0.2 to 0.3 and {BLURRED:g} is a blur of "
            "1.5 pixels.",
            "Focus and clean the lenses, and shorten the exposure.",
        )
    plain = share(lambda look: not _is_dark(look) and look.points < FEWEST_POINTS)
    if plain:
        yield warning(
            "images-plain",
            f"{plain} of {count} pairs that were looked at show fewer than {FEWEST_POINTS} points "
            f"with depth; the median is {np.median([look.points for look in looks]):.0f}.",
            "If the images are not fogged or featureless, look at the calibration, and whether "
            "left and right are of one moment.",
        )
    unequal = share(lambda look: _ratio(look) > EXPOSURE_RATIO)
    if unequal:
        ratio = float(np.median([_ratio(look) for look in looks]))
        yield warning(
            "exposure-differs",
            f"Left and right differ in brightness by a factor of {ratio:.2f} (median of {count} "
            "pairs).",
            "Let one camera's exposure and gain drive both.",
        )


def misalignment_findings(found: Misalignment | None) -> Iterator[Finding]:
    """Rows that do not match: a calibration that has drifted, or of other cameras."""
    if found is None:
        return
    told = (
        f"In {found.matches} matches the right images lie {found.median_px:+.2f} pixels lower than "
        f"the left ones, {found.residual_px:.2f} up or down"
    )
    remedy = "Calibrate the pair anew; give the rectification that belongs to these images."
    if found.residual_px > SHIFT_ERROR_PX:
        yield error("vertical-misalignment", f"{told}; rows must match to match pixels.", remedy)
    elif found.residual_px > SHIFT_WARN_PX:
        yield warning("vertical-misalignment", f"{told}: the calibration has drifted.", remedy)
    if found.scatter_px > SCATTER_PX:
        yield warning(
            "vertical-scatter",
            f"The rows of left and right are shifted by {found.scatter_px:.2f} pixels more or less "
            "from pair to pair.",
            "Trigger both cameras at once, and look whether one is loose.",
        )


def _is_dark(look: Look) -> bool:
    return look.dark_share > DARK_SHARE or min(look.brightness) < DARK_MEAN


def _worst_blur(looks: Sequence[Look]) -> float:
    return max(look.blur for look in looks if not _is_dark(look))


def _ratio(look: Look) -> float:
    """How many times brighter the brighter image is."""
    low, high = sorted(look.brightness)
    return high / max(low, 1.0)
