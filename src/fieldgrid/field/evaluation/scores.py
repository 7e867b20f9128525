"""A map against surveyed or simulated truth: obstacles, free space, poses.

Everything is absolute: nothing is shifted or turned to fit. Frames are matched to the truth
by time, and a map is folded anew from the frames of each group, so that "driven forward on
the rows" can be told from "all".
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from fieldgrid.core import Bool, Float64, TruthError, shortened
from fieldgrid.field.evaluation.attitude import score_attitude
from fieldgrid.field.evaluation.results import (
    Evaluation,
    FrameError,
    GroupScores,
    ObstacleScores,
    PoseErrors,
)
from fieldgrid.field.evaluation.terrain import score_terrain
from fieldgrid.field.evaluation.truth import Truth, TruthPose
from fieldgrid.geometry import (
    FREE_UP_TO,
    GROUND_CHANNEL,
    OBSTACLE_ABOVE,
    GridSpec,
    Status,
    wrap_deg,
)
from fieldgrid.maps import FrameRecord, MapFile, MapView, to_universal
from fieldgrid.poses import Attitude

TOLERANCES_M = (0.10, 0.25)

OBSERVABLE_PIXELS = 100
"""A truth cell counts as observable from this many left-camera pixels in the whole drive.

With it plain SGBM on true poses has the recall of 0.978 that the vineyard's own verification
states; a cell of a handful of pixels seen past a canopy is not held against a map.
"""

MATCH_NS = 1_000_000
"""Frames and truth poses belong together when their times agree to a millisecond."""


def evaluate(
    universal: MapFile,
    truth: Truth,
    *,
    observable_pixels: int = OBSERVABLE_PIXELS,
    attitudes: Mapping[str, Attitude] | None = None,
) -> Evaluation:
    """Compare a map with a truth of the same datum.

    A map keeps no roll and pitch, but what they were estimated from: `attitudes` of its sessions,
    by name, as `fieldgrid.pipeline.repose.attitudes_of` estimates them again, are compared, too.

    Raises TruthError when the datums differ, or no frame of the map is in the truth.
    """
    if truth.datum is not None:
        lat, lon, height = truth.datum.lat_deg, truth.datum.lon_deg, truth.datum.height_m
        offset_m = float(np.linalg.norm(universal.datum.to_enu(lat, lon, height)))
        if offset_m > 0.001:
            raise TruthError(
                f"The truth's origin {lat}, {lon}, {height} m lies {offset_m:.3f} m from the map's "
                f"datum; build the map with --datum {lat},{lon},{height}."
            )
    matched: list[tuple[FrameRecord, TruthPose]] = []
    unmatched = 0
    times = np.array([pose.time_ns for pose in truth.poses], dtype=np.int64)
    for record in universal.frames():
        k = int(np.argmin(np.abs(times - record.pose.time_ns))) if times.size else 0
        if times.size and abs(int(times[k]) - record.pose.time_ns) <= MATCH_NS:
            matched.append((record, truth.poses[k]))
        else:
            unmatched += 1
    if not matched:
        raise TruthError(
            f"None of the map's {unmatched} frames is in the truth (by time, to a millisecond); "
            "is it the truth of this drive?"
        )
    on_rows = [pair for pair in matched if pair[1].forward_on_row]
    groups = [("forward on the rows", on_rows)] if on_rows else []
    groups.append(("all frames", matched))
    counts = Counter(record.session for record, _ in matched if record.accepted)
    return Evaluation(
        cell_m=universal.cell_m,
        observable_pixels=observable_pixels,
        unmatched_frames=unmatched,
        # Of sessions that tell no lean. Frames of those that do keep heights of the ground, unless
        # they found none.
        unlevelled_frames=sum(
            count
            for name, count in counts.items()
            if not any(
                channel.name == GROUND_CHANNEL
                for frame in universal.frames(name, with_grid=True)
                for channel in frame.load()
            )
        ),
        groups=tuple(
            GroupScores(
                name, _score_map(universal, truth, pairs, observable_pixels), _score_poses(pairs)
            )
            for name, pairs in groups
        ),
        frames=tuple(_frame_error(record, pose) for record, pose in matched),
        terrain=None if truth.ground is None else score_terrain(universal, truth.ground),
        attitude=score_attitude(attitudes or {}, matched),
    )


def _score_poses(pairs: list[tuple[FrameRecord, TruthPose]]) -> PoseErrors:
    errors = [_frame_error(record, pose) for record, pose in pairs]
    accepted = [error for error in errors if error.status == Status.OK.value]
    position = np.array([math.hypot(e.east_error_m, e.north_error_m) for e in accepted])
    heading = np.abs([e.heading_error_deg for e in accepted])
    return PoseErrors(
        frames=len(accepted),
        rejected=len(errors) - len(accepted),
        position_median_m=_quantile(position, 0.5),
        position_max_m=_quantile(position, 1.0),
        position_within_3_sigma=_within(position, [e.position_sigma_m for e in accepted]),
        heading_median_deg=_quantile(heading, 0.5),
        heading_p95_deg=_quantile(heading, 0.95),
        heading_max_deg=_quantile(heading, 1.0),
        heading_within_3_sigma=_within(heading, [e.heading_sigma_deg for e in accepted]),
    )


def _frame_error(record: FrameRecord, truth: TruthPose) -> FrameError:
    pose = record.pose
    return FrameError(
        frame_id=record.frame_id,
        segment=truth.segment,
        direction=truth.direction,
        status=pose.status.value,
        east_error_m=pose.east_m - truth.east_m,
        north_error_m=pose.north_m - truth.north_m,
        position_sigma_m=pose.position_sigma_m,
        heading_error_deg=float(wrap_deg(pose.heading_deg - truth.heading_deg)),
        heading_sigma_deg=pose.heading_sigma_deg,
    )


def _score_map(
    universal: MapFile,
    truth: Truth,
    pairs: list[tuple[FrameRecord, TruthPose]],
    observable_pixels: int,
) -> ObstacleScores:
    """Fold the accepted frames of a group and compare cell centres with the truth's."""
    accepted = [record for record, _ in pairs if record.pose.status is Status.OK]
    if not accepted:
        return ObstacleScores(0, 0, 0, _by_tolerance(None), _by_tolerance(None), None)
    keys = {(record.session, record.frame_id) for record in accepted}
    view = universal.read(frame_filter=lambda record: (record.session, record.frame_id) in keys)
    east, north = view.lattice.centres(view.window)
    bounds = truth.lattice.bounds(truth.window)
    inside = ((north > bounds.south_m) & (north < bounds.north_m))[:, None]
    inside = inside & (east > bounds.west_m) & (east < bounds.east_m)
    obstacle = view.observed & (view.density > OBSTACLE_ABOVE) & inside
    free = view.observed & (view.density <= FREE_UP_TO) & inside
    observable = truth.occupied & (truth.obstacle_pixels >= observable_pixels)
    observable &= _in_view(universal, truth, accepted)
    found, observed = _points(view, obstacle), _points(truth, observable)
    to_truth = _distances(found, _points(truth, truth.occupied))
    to_map = _distances(observed, found)
    hit = np.zeros(view.window.shape, dtype=np.bool_)
    i, j = view.lattice.index(*observed.T)
    known = (i >= view.window.i0) & (i < view.window.i0 + view.window.width)
    known &= (j >= view.window.j0) & (j < view.window.j0 + view.window.height)
    hit[j[known] - view.window.j0, i[known] - view.window.i0] = True
    return ObstacleScores(
        obstacle_cells=int(obstacle.sum()),
        observable_cells=int(observable.sum()),
        free_cells=int(free.sum()),
        precision=_by_tolerance(to_truth),
        recall=_by_tolerance(to_map),
        free_with_obstacle=float((hit & free).sum() / free.sum()) if free.any() else None,
    )


def _in_view(universal: MapFile, truth: Truth, accepted: list[FrameRecord]) -> Bool:
    """Truth cells inside the field of view, the grid and the range of at least one frame."""
    mask = np.zeros(truth.window.shape, dtype=np.bool_)
    sessions = {info.name: info for info in universal.sessions()}
    for record in accepted:
        info = sessions[record.session]
        if info.grid is None:
            raise TruthError(f"Session {info.name} has no frames to judge; build the map again.")
        x, y = _view_points(info.grid, info.config, truth.lattice.cell_m / 2.0)
        east, north = to_universal(x, y, record.pose)
        i, j = truth.lattice.index(east, north)
        i, j = i - truth.window.i0, j - truth.window.j0
        ok = (i >= 0) & (j >= 0) & (i < truth.window.width) & (j < truth.window.height)
        mask[j[ok], i[ok]] = True
    return mask


def _view_points(
    spec: GridSpec, config: Mapping[str, Any], step_m: float
) -> tuple[Float64, Float64]:
    """Points of the local grid that the camera sees the ground of, of a pair the left one, within
    range. A lidar looks to all sides."""
    try:
        rig, max_range_m = config["rig"], float(config["max_range_m"])
        if "lidar" in rig:
            left = right = math.inf
            nearest_m, offset_m = step_m, 0.0
        else:
            camera = rig["camera"] if "camera" in rig else rig["depth_camera"]
            is_pair = "camera" in rig
            fx_px, fy_px = (
                camera[key] for key in (("focal_px",) * 2 if is_pair else ("fx_px", "fy_px"))
            )
            left, right, lowest, offset_m = (
                camera["cx_px"] / fx_px,
                (camera["width_px"] - 1 - camera["cx_px"]) / fx_px,
                (camera["height_px"] - 1 - camera["cy_px"]) / fy_px,
                -camera["baseline_m"] / 2.0 if is_pair else 0.0,
            )
            lowest_deg = rig["mount"]["tilt_deg"] + math.degrees(math.atan(lowest))
            nearest_m = rig["mount"]["height_m"] / math.tan(math.radians(max(lowest_deg, 0.1)))
    except (KeyError, TypeError, ValueError, ZeroDivisionError) as error:
        raise TruthError(
            f"The map's session does not say what its camera saw ({shortened(repr(error))} in its "
            "settings), so recall cannot be judged; build the map again."
        ) from error
    x, y = np.meshgrid(
        np.arange(-spec.width_m / 2.0, spec.width_m / 2.0, step_m),
        np.arange(nearest_m, spec.length_m, step_m),
    )
    seen = (
        (np.hypot(x, y) <= max_range_m) & (x - offset_m >= -left * y) & (x - offset_m <= right * y)
    )
    return x[seen], y[seen]


def _points(of: Truth | MapView, mask: Bool) -> Float64:
    """The centres [n, 2] of the cells of a mask, metres east and north."""
    east, north = of.lattice.centres(of.window)
    rows, columns = np.nonzero(mask)
    return np.stack([east[columns], north[rows]], axis=1)


def _distances(points: Float64, targets: Float64) -> Float64:
    """Distance in metres from each point to the nearest target; infinite without targets."""
    if len(targets) == 0 or len(points) == 0:
        return np.full(len(points), np.inf)
    return np.asarray(cKDTree(targets).query(points)[0], dtype=np.float64)


def _by_tolerance(distances: Float64 | None) -> dict[str, float | None]:
    if distances is None or distances.size == 0:
        return {f"{tolerance:.2f}": None for tolerance in TOLERANCES_M}
    return {
        f"{tolerance:.2f}": float(np.mean(distances <= tolerance + 1e-6))
        for tolerance in TOLERANCES_M
    }


def _within(errors: Float64, sigmas: Sequence[float]) -> float | None:
    """Share of the errors of at most three sigmas; None of nothing."""
    return float(np.mean(errors <= 3.0 * np.asarray(sigmas))) if errors.size else None


def _quantile(values: Float64, share: float) -> float | None:
    return float(np.quantile(values, share)) if values.size else None
