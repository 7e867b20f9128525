"""Whether the rows of the images of a rectified pair match, by what both of them show."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import cv2
import numpy as np

from fieldgrid.core import Float32, Float64, UInt8
from fieldgrid.geometry import StereoCamera, robust_plane

SHIFT_ERROR_PX = 1.5
"""Vertical misalignment from which on matching fails."""

PATCH_PX = 7
"""Half the side of the patches that are looked up in the right image."""

SEARCH_SHARE, MOST_SEARCHED = 0.05, 160
"""Of an image's height: how far up and down a patch is looked for. Of how many patches."""

ALIKE, LEAD = 0.8, 0.05
"""A patch is found where its correlation is at least this, and larger by this than elsewhere."""

FEWEST_SHIFTS = 40

PARTS, FEWEST_PAIRS = 5, 2
"""Number of parts between which a drive may be split, and the least number of pairs on a side."""

SHIFT_SIGMA_PX = (1e6, 30.0, 30.0)
"""Nothing is known of the shift itself, and little of how it grows across the image: enough to
leave it level where all matches lie on a line."""


class Misalignment(NamedTuple):
    """How many rows lower the right images lie, in pixels: `median_px` of all matches,
    `residual_px` the median size of a shift that may also grow across the image;
    `roll_deg` of the right camera against the left, `scatter_px` between the pairs, `matches`
    the number of points, and `pairs` the number of pairs that they are of."""

    median_px: float
    residual_px: float
    roll_deg: float
    scatter_px: float
    matches: int
    pairs: int

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return self._asdict()


def misalignment(pairs: Sequence[Float64], size_px: tuple[int, int]) -> Misalignment | None:
    """The vertical misalignment of pairs together, by the shifts [n, 3] of each; None with too
    few matches."""
    shifts = np.concatenate(pairs) if pairs else np.zeros((0, 3))
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
    each = [shift_px(shifts) for shifts in pairs]
    known = np.array([shift for shift in each if shift is not None])
    off = np.abs(known - np.median(known)) if known.size else np.zeros(1)
    return Misalignment(
        median_px=median_px,
        residual_px=residual_px,
        roll_deg=float(np.degrees(np.arctan(plane[1] / width))),
        scatter_px=1.4826 * float(np.median(off)),
        matches=len(shifts),
        pairs=len(pairs),
    )


def drive_misalignment(pairs: Sequence[Float64], size_px: tuple[int, int]) -> Misalignment | None:
    """Misalignment of all pairs of a drive, in order of time; or of those before or after some
    moment where only these are so far off that matching fails, since a camera was pushed."""
    whole = misalignment(pairs, size_px)
    if whole is not None and whole.residual_px > SHIFT_ERROR_PX:
        return whole
    splits = np.linspace(0, len(pairs), PARTS + 1)[1:-1].round().astype(int).tolist()
    parts = [
        part for at in splits for part in (pairs[:at], pairs[at:]) if len(part) >= FEWEST_PAIRS
    ]
    found = [one for one in (misalignment(part, size_px) for part in parts) if one is not None]
    worst = max(found, key=lambda one: one.residual_px, default=whole)
    return worst if worst is not None and worst.residual_px > SHIFT_ERROR_PX else whole


def shift_px(shifts: Float64) -> float | None:
    """The median of the shifts of a pair [n, 3]; None with fewer than eight."""
    return float(np.median(shifts[:, 2])) if len(shifts) >= 8 else None


def vertical_shifts(left: UInt8, right: UInt8, camera: StereoCamera) -> Float64:
    """How many rows lower corners of the left image are in the right one: [n, 3] with column,
    row and shift. In a rectified pair all shifts are 0."""
    height, width = left.shape
    reach = max(4, round(SEARCH_SHARE * height))
    nearest = min(camera.focal_baseline_px_m / 2.0, camera.width_px / 3.0)
    far, near = round(camera.disparity_offset_px) - 2, round(camera.disparity_offset_px + nearest)
    found = []
    for column, row in _corners(left):
        x, y = round(float(column)), round(float(row))
        first = max(x - near - PATCH_PX, 0)
        last = min(x - far + PATCH_PX + 3, width - 1)
        inside = PATCH_PX <= x < width - PATCH_PX
        inside &= reach + PATCH_PX <= y < height - reach - PATCH_PX
        if not inside or last - first < 4 * PATCH_PX:
            continue
        patch = left[y - PATCH_PX : y + PATCH_PX + 1, x - PATCH_PX : x + PATCH_PX + 1]
        strip = right[y - reach - PATCH_PX : y + reach + PATCH_PX + 1, first : last + 1]
        rows = _found(cv2.matchTemplate(strip, patch, cv2.TM_CCOEFF_NORMED))
        if rows is not None:
            found.append((float(column), float(row), rows - reach))
    return np.array(found, dtype=np.float64).reshape(-1, 3)


def _corners(image: UInt8) -> Float64:
    """Column and row of corners [n, 2], well apart."""
    apart_px = max(6.0, image.shape[0] / 40.0)
    found = cv2.goodFeaturesToTrack(image, MOST_SEARCHED, 0.01, apart_px)
    return np.zeros((0, 2)) if found is None else found.reshape(-1, 2).astype(np.float64)


def _found(scores: Float32) -> float | None:
    """The row, to a fraction, at which a patch is found for certain."""
    _, best, _, place = cv2.minMaxLoc(scores)
    x, y = int(place[0]), int(place[1])
    height, width = scores.shape
    if best < ALIKE or not (0 < y < height - 1 and 0 < x < width - 1):
        return None
    before, after = float(scores[y - 1, x]), float(scores[y + 1, x])
    rest = scores.copy()
    rest[max(y - 3, 0) : y + 4, max(x - 3, 0) : x + 4] = -1.0
    curvature = before - 2.0 * best + after
    if float(rest.max()) > best - LEAD or curvature >= 0.0:
        return None
    return float(y + 0.5 * (before - after) / curvature)
