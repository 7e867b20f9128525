"""Rows in metres: from reference lines to fitted curves with sigma, ends, gaps and width."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import shapely
from scipy.spatial import cKDTree

from fieldgrid.core import Float64
from fieldgrid.field.rows.chains import without_doubles
from fieldgrid.field.rows.crops import Crop
from fieldgrid.field.rows.measuring.contrast import chances_of_noise, contrast, stand_out
from fieldgrid.field.rows.measuring.extent import Extent, connected_run, find_extent
from fieldgrid.field.rows.measuring.fit import fit_curve
from fieldgrid.field.rows.measuring.neighbours import is_apart, outer_lines
from fieldgrid.field.rows.measuring.profile import (
    STATION_M,
    Faces,
    Profile,
    find_faces,
    moved,
    take_profile,
)
from fieldgrid.geometry import extended, lengths, part, project, resampled
from fieldgrid.maps import Evidence

_BEYOND_M = 4.0
"""How far a row may go on beyond its reference line."""

_WIDTH_SIGMA_M = 0.05
"""How much the canopies of two rows of a field differ in half width."""

_PARALLEL = np.cos(np.radians(30.0))
_GATE = 0.42
"""Cells that are nearer than this share of the way to the next row belong to a row."""


class MeasuredRow(NamedTuple):
    """A row: its middle line from end to end, sigma at its points, extent along the line, half
    width of the canopy, from how many sides it was seen (0 to 2, a mean), its obstacle cells."""

    line: Float64
    sigma_m: Float64
    extent: Extent
    half_width_m: float
    sides: float
    cells: int
    scatter_m: float


class RowSection(NamedTuple):
    """What is known of a row before it is fitted: its profile about its own middle, its faces, and
    how far from its line its cells may lie."""

    profile: Profile
    faces: Faces
    gate_m: float


def measure_rows(evidence: Evidence, lines: list[Float64], crop: Crop) -> list[MeasuredRow]:
    """The rows near reference lines; a line that turns out to be none, or that does not stand out
    from the ground beside it, is left out."""
    settled = _all_settled(evidence, lines, _gates(lines, crop), crop)
    width = _half_width(settled, crop)
    candidates = _candidates(evidence, settled, width, crop)
    rows = _standing_out(candidates, crop)
    # Too little of a row beyond the last may have been seen to find it without its neighbour.
    outer, apart_m = outer_lines([row.line for row in rows], crop)
    settled = _all_settled(evidence, outer, [_GATE * apart_m] * len(outer), crop)
    for candidate in _candidates(evidence, settled, width, crop):
        known = cKDTree(np.concatenate([row.line for row, _ in candidates]))
        if is_apart(candidate[0].line, known, apart_m):
            candidates.append(candidate)
    return _standing_out(candidates, crop)


def _uncrossed(candidates: list[tuple[MeasuredRow, float]]) -> list[tuple[MeasuredRow, float]]:
    """The candidates but for those that lead across two others which are less likely noise: trees
    on a grid stand in line that way, too."""
    if len(candidates) < 3:
        return candidates
    lines = [shapely.LineString(row.line) for row, _ in candidates]
    first, second = shapely.STRtree(lines).query(lines, predicate="crosses")
    chance = np.array([chance for _, chance in candidates])
    crossed = np.bincount(first[chance[second] < chance[first]], minlength=len(lines))
    return [pair for pair, count in zip(candidates, crossed, strict=True) if count < 2]


def _all_settled(
    evidence: Evidence, lines: list[Float64], gates: list[float], crop: Crop
) -> list[RowSection]:
    """The rows near lines that are near one, each with its gate."""
    found = []
    for line, gate in zip(lines, gates, strict=True):
        gate_m = max(gate, 3.0 * evidence.cell_m)
        profile = _settled(evidence, line, gate_m, crop)
        if profile is not None:
            found.append(RowSection(profile, find_faces(profile), gate_m))
    return found


def _candidates(
    evidence: Evidence, settled: list[RowSection], width: tuple[float, float], crop: Crop
) -> list[tuple[MeasuredRow, float]]:
    """The rows of profiles, each with its chance to be noise."""
    found, contrasts = [], []
    for near in settled:
        row = _measured(evidence, near, width, crop)
        if row is not None:
            half_way_m = 0.5 / _GATE * near.gate_m
            found.append(row)
            contrasts.append(contrast(evidence, row.line, row.half_width_m, half_way_m, crop))
    return list(zip(found, chances_of_noise(contrasts).tolist(), strict=True))


def _standing_out(candidates: list[tuple[MeasuredRow, float]], crop: Crop) -> list[MeasuredRow]:
    candidates = _uncrossed(candidates)
    # The two faces of a wide canopy both lead to its middle: the longer one is kept.
    kept = without_doubles([row.line for row, _ in candidates], crop)
    candidates = [candidates[k] for k in kept]
    are_rows = stand_out(np.array([chance for _, chance in candidates]))
    return [row for (row, _), is_row in zip(candidates, are_rows, strict=True) if is_row]


def _gates(lines: list[Float64], crop: Crop) -> list[float]:
    """How far from its line the cells of a row may lie: less than half of the way to the next."""
    most = _GATE * crop.max_spacing_m
    if len(lines) < 2:
        return [_GATE * 0.5 * (crop.min_spacing_m + crop.max_spacing_m)] * len(lines)
    points = [resampled(line, 2.0) for line in lines]
    owner = np.repeat(np.arange(len(lines)), [len(p) for p in points])
    every = np.concatenate(points)
    nearest = np.full(len(every), np.inf)
    tree = cKDTree(every)
    distance, index = tree.query(every, k=24, distance_upper_bound=4.0 * crop.max_spacing_m)
    beside = owner[np.minimum(index, len(every) - 1)]
    # Trees on a grid make lines across the rows, too, which are no neighbours.
    along = np.array([line[-1] - line[0] for line in lines])
    along /= np.hypot(along[:, 0], along[:, 1])[:, None]
    is_parallel = np.abs((along[owner][:, None] * along[beside]).sum(axis=2)) > _PARALLEL
    nearest = np.where((beside != owner[:, None]) & is_parallel, distance, np.inf).min(axis=1)
    spacing = np.array([np.median(nearest[owner == k]) for k in range(len(lines))])
    usual = float(np.median(spacing[np.isfinite(spacing)])) if np.isfinite(spacing).any() else most
    return [float(np.clip(_GATE * min(s, 1.2 * usual), 0.0, most)) for s in spacing]


def _settled(evidence: Evidence, line: Float64, gate_m: float, crop: Crop) -> Profile | None:
    """The profile of a row about its own middle: the line is moved onto the cells, read again."""
    for last in (False, True):
        wide = extended(line, _BEYOND_M, _BEYOND_M)
        profile = take_profile(evidence, wide, gate_m)
        # Beyond the line only what lies in the canopy is the row: between two rows of the next
        # block there are cells to either side.
        beyond = (profile.along_m < _BEYOND_M) | (profile.along_m > lengths(wide)[-1] - _BEYOND_M)
        inner = profile.offset_m[~beyond & (profile.weight > 0.0)]
        middle_m = float(np.median(inner)) if len(inner) else 0.0
        canopy_m = crop.half_width_m + crop.half_width_sigma_m
        astray = np.abs(profile.offset_m - middle_m) > canopy_m
        profile = profile._replace(weight=np.where(beyond & astray, 0.0, profile.weight))
        span = connected_run(profile.weight, STATION_M, crop)
        if span is None or (span[1] - span[0]) * STATION_M < 0.5 * crop.min_row_m:
            return None
        weight = np.zeros(len(profile.weight))
        weight[slice(*span)] = profile.weight[slice(*span)]
        if (weight > 0.0).sum() < 6:
            return None
        profile = profile._replace(weight=weight)
        if not last:
            points = moved(profile, profile.offset_m)[slice(*span)]
            line = fit_curve(points, weight[slice(*span)]).line
    return profile


def _half_width(settled: list[RowSection], crop: Crop) -> tuple[float, float]:
    """Half the width of the canopies, metres, and its standard deviation: what the rows that were
    seen from both sides say, beside what is usual for the crop."""
    told = [near for near in settled if np.isfinite(near.faces.full_width_m)]
    widths = np.array([near.faces.full_width_m for near in told])
    weight = np.array([near.faces.both_share * near.profile.along_m[-1] for near in told])
    if not len(widths) or weight.sum() < 10.0:
        return crop.half_width_m, crop.half_width_sigma_m
    order = widths.argsort()
    middle = widths[order][np.searchsorted(weight[order].cumsum(), 0.5 * weight.sum())]
    measured = _WIDTH_SIGMA_M**-2
    prior = crop.half_width_sigma_m**-2
    half = (measured * 0.5 * float(middle) + prior * crop.half_width_m) / (measured + prior)
    return half, (measured + prior) ** -0.5


def _measured(
    evidence: Evidence, settled: RowSection, width: tuple[float, float], crop: Crop
) -> MeasuredRow | None:
    """The row of a profile: every station moved from the cells that were seen to the middle."""
    profile, faces, _ = settled
    both = faces.left_seen & faces.right_seen
    shift, side_sigma = np.zeros(len(both)), np.zeros(len(both))
    usual_m, usual_sigma_m = width
    half = usual_m
    if np.isfinite(faces.full_width_m) and faces.both_share >= 0.5:
        shift[:] = 0.5 * sum(faces.full_m)
        half = 0.5 * faces.full_width_m
        # A row that looks thinner than the others was hardly seen from both sides.
        side_sigma[:] = max(usual_m - half - 2.0 * _WIDTH_SIGMA_M, 0.0)
    else:
        for seen, face_m, sign in (
            (faces.left_seen & ~both, faces.left_m, -1.0),
            (faces.right_seen & ~both, faces.right_m, 1.0),
        ):
            if np.isfinite(face_m):
                shift[seen] = face_m + sign * usual_m
                side_sigma[seen] = usual_sigma_m
        side_sigma[~(faces.left_seen | faces.right_seen)] = usual_m
    used = np.flatnonzero(profile.weight > 0.0)
    inside = slice(int(used[0]), int(used[-1]) + 1)
    curve = fit_curve(moved(profile, profile.offset_m + shift)[inside], profile.weight[inside])
    line = extended(curve.line, 1.5, 1.5)
    extent = find_extent(evidence, line, (half, -half), crop)
    if extent is None or extent.stop_m - extent.start_m < 0.6 * crop.min_row_m:
        return None
    length = extent.stop_m - extent.start_m
    if length - sum(b - a for a, b in (*extent.gaps_m, *extent.unseen_m)) < 0.35 * length:
        return None
    sigma = np.sqrt(curve.sigma_m**2 + float(np.sqrt((side_sigma[inside] ** 2).mean())) ** 2)
    own = resampled(part(line, extent.start_m, extent.stop_m), 1.0)
    at, _ = project(own, curve.line)
    shifted = Extent(
        0.0,
        length,
        tuple((a - extent.start_m, b - extent.start_m) for a, b in extent.gaps_m),
        tuple((a - extent.start_m, b - extent.start_m) for a, b in extent.unseen_m),
        extent.ends_seen,
    )
    return MeasuredRow(
        own,
        np.interp(at, lengths(curve.line), sigma),
        shifted,
        float(half),
        float((faces.left_seen[inside].astype(int) + faces.right_seen[inside]).mean()),
        int(profile.weight.sum()),
        curve.scatter_m,
    )
