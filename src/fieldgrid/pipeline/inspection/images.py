"""What is wrong with the images, by the pairs that were looked at closely."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from fieldgrid.core import Figure, Finding, StopCode, error, warning
from fieldgrid.perception import EXPOSURE_RATIO, SHIFT_ERROR_PX, Misalignment
from fieldgrid.pipeline.inspection.frame_pass import UnreadFrame
from fieldgrid.pipeline.inspection.measures import ImageMeasures, PairMeasures

SATURATED_SHARE = 0.25
"""Sky and sun take some of any image; a quarter is too much."""

BLURRED = 0.42
"""Above that of a sharp image smoothed by 1.5 pixels; see :func:`~.measures.blur`."""

FEWEST_POINTS = 60
"""Odometry needs 30 in each of two frames, and not all are found again."""

WORTH_SHARE = 0.2
"""A fault in fewer of the pairs than this, and in fewer than two, is chance."""

SHIFT_WARN_PX = 0.5
"""Vertical misalignment from which on matching suffers."""

SCATTER_PX = 1.0
"""The shift of a pair that changes by more than this between pairs is no calibration."""


def unread_findings(unread: Sequence[UnreadFrame], looked: int) -> Iterator[Finding]:
    """Frames that cannot be had, at the first of which a build ends."""
    misfits = [one for one in unread if one.misfit]
    if misfits:
        what = misfits[0].problem.rsplit("; ", 1)[0].rstrip(".")  # the remedy says the rest
        yield error(
            "image-size",
            f"{len(misfits)} of {looked} examined frames do not fit the "
            f"calibration. First: {what}.",
            "Give the calibration of these images, for their size and orientation, uncropped.",
        )
    elif unread:
        yield error(
            "images-unreadable",
            f"{len(unread)} of {looked} examined frames cannot be read. First: {unread[0].problem}",
            "Restore the files, or leave these frames out of the recording.",
        )


def _faulty(are_so: Sequence[bool]) -> int:
    """How many pairs have a fault, 0 where it may be chance."""
    found = sum(are_so)
    return found if found >= max(2.0, WORTH_SHARE * len(are_so)) or all(are_so) else 0


def texture_findings(looks: Sequence[PairMeasures]) -> Iterator[Finding]:
    """Pairs that show too little for visual odometry."""
    plain = _faulty([not look.images.is_dark and look.points < FEWEST_POINTS for look in looks])
    if plain:
        yield warning(
            "images-plain",
            f"{plain} of {len(looks)} examined pairs show fewer than {FEWEST_POINTS} points "
            f"with depth; the median is {np.median([look.points for look in looks]):.0f}.",
            "If the images are not fogged or featureless, check the calibration, and that left and "
            "right are synchronised.",
        )


def image_findings(looks: Sequence[ImageMeasures]) -> Iterator[Finding]:
    """Exposure and sharpness."""
    count = len(looks)
    dark = _faulty([look.is_dark for look in looks])
    if dark:
        yield warning(
            "images-dark",
            f"{dark} of {count} examined pairs are dark, the darkest with a mean of "
            f"{min(min(look.brightness) for look in looks):.0f} of 255.",
            "Expose longer, open the lens, or drive by day.",
        )
    saturated = _faulty([look.saturated_share > SATURATED_SHARE for look in looks])
    if saturated:
        most = max(look.saturated_share for look in looks)
        yield warning(
            "images-saturated",
            f"{saturated} of {count} examined pairs are saturated, up to "
            f"{100.0 * most:.0f} % of the image.",
            "Expose for the ground, not for the sky; shorten the exposure.",
        )
    blurred = _faulty([not look.is_dark and look.blur > BLURRED for look in looks])
    if blurred:
        worst = max(look.blur for look in looks if not look.is_dark)
        yield warning(
            "images-blurred",
            f"{blurred} of {count} examined pairs are blurred: {worst:.2f} "
            f"by Crete's measure, where sharp images have 0.2 to 0.3 and {BLURRED:g} is a blur of "
            "1.5 pixels.",
            "Focus and clean the lenses, and shorten the exposure.",
        )
    ratios = [look.exposure_ratio for look in looks]
    if _faulty([ratio > EXPOSURE_RATIO for ratio in ratios]):
        ratio = float(np.median(ratios))
        yield warning(
            "exposure-differs",
            f"Left and right differ in brightness by a factor of {ratio:.2f} (median of {count} "
            "pairs).",
            "They are brought to the same exposure before they are matched; better, use the same "
            "exposure and gain for both cameras.",
            Figure(ratio, "times"),
        )


def misalignment_findings(found: Misalignment | None) -> Iterator[Finding]:
    """Rows that do not match: a calibration that has drifted, or of other cameras."""
    if found is None:
        return
    told = (
        f"In {found.matches} matches the right images are {found.median_px:+.2f} pixels lower than "
        f"the left ones, {found.residual_px:.2f} in absolute value"
    )
    remedy = "Calibrate the pair again, or give the rectification of these images."
    if found.residual_px > SHIFT_ERROR_PX:
        yield error(
            StopCode.VERTICAL_MISALIGNMENT.value,
            f"{told}; stereo matching needs equal rows.",
            remedy,
            Figure(found.median_px, "px"),
        )
    elif found.residual_px > SHIFT_WARN_PX:
        yield warning(
            "vertical-misalignment",
            f"{told}: the calibration has drifted.",
            remedy,
            Figure(found.median_px, "px"),
        )
    if found.scatter_px > SCATTER_PX:
        yield warning(
            "vertical-scatter",
            f"The row offset of left and right varies by {found.scatter_px:.2f} pixels from pair "
            "to pair.",
            "Trigger both cameras at once, and check that neither is loose.",
            Figure(found.scatter_px, "px"),
        )
