"""Poses of another program, brought to their place and judged like all others."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import (
    Bool,
    ConfigError,
    Figure,
    Finding,
    Float64,
    GateLimits,
    GnssError,
    Int64,
    PoseSettings,
    Quality,
    commonest_reason,
    utc_text,
    warning,
)
from fieldgrid.geometry import (
    MAX_GAP_NS,
    Datum,
    FixColumns,
    GivenPoses,
    R_enu_level,
    R_level_vehicle,
    RecordedTilt,
    Rig,
    Trajectory,
    VehicleGeometry,
    wrap_deg,
)
from fieldgrid.poses.accepted import fix_offsets
from fieldgrid.poses.attitude.attitude import Attitude
from fieldgrid.poses.attitude.axes import RECORDED
from fieldgrid.poses.external.georeference import (
    LEAST_HEADING_SIGMA_DEG,
    Georeference,
    Pairs,
    by_fixes,
    declared,
)
from fieldgrid.poses.external.motion import Chords, chords_of, course_off_heading_deg, resting
from fieldgrid.poses.faults.unseen import accuracy_findings, unsure_fit_m
from fieldgrid.poses.gates.conditioning import condition
from fieldgrid.poses.gates.verdict import Gate
from fieldgrid.poses.sigmas import AddedSigma, as_unsure
from fieldgrid.poses.table import ConditionedLog, PoseTable
from fieldgrid.poses.verdict import ErrorBudget, judged

GIVEN = "given poses"
"""What a trajectory of them says where its headings come from."""

LEAST_POSITION_SIGMA_M = 0.02
"""What no comparison shows of another program's poses."""

DRIFT_SHARE = 0.01
"""How far poses drift from the nearest fix at least, as a share of the way from there."""

DRIFT_M = 100.0
"""As far from it, the variance of their heading has doubled."""

CLEAR_OFFSET_DEG = 1.0
"""A heading that is off the course by more is worth a word."""

POSE_SIGMA_M = 0.05
"""From pose to pose a trajectory errs by this at most: beyond it, it jumps."""


class GivenRows(NamedTuple):
    """Rows of poses, in order of time: those that were given, and between them accepted fixes.

    `way_m` is the way from the first one. `fix` is the accepted fix of a row, or -1.
    """

    poses: GivenPoses
    way_m: Float64
    fix: Int64


class PlacedPoses(NamedTuple):
    """Given poses in the LTP: the trajectory, the row of each fix in it (without fixes, all rows),
    and what was found. `pairs` are the fixes compared, None without any."""

    trajectory: Trajectory
    fix_row: Int64
    georeference: Georeference
    attitude: Attitude | None
    pairs: Pairs | None
    findings: tuple[Finding, ...]
    gear_doubt: Float64


def place_poses(
    poses: GivenPoses,
    tilt: RecordedTilt | None,
    log: ConditionedLog | None,
    rig: VehicleGeometry | None,
    datum: Datum,
    settings: PoseSettings,
    budget: ErrorBudget | None,
    *,
    level_grids: bool,
) -> PlacedPoses:
    """Given poses, laid along the accepted fixes of a log or where the settings declare them.

    `tilt` says how the vehicle leans, as far as that is known. Raises GnssError where fixes and
    poses do not fit together or nothing tells where these lie, ConfigError for half a declaration.
    """
    rows = _with_fixes(poses, log)
    pairs = _pairs(rows, log, rig)
    # Where the frame lies, and whether the body's forward axis is the vehicle's.
    found = _georeference(poses, pairs, log, datum, settings)
    unsure: tuple[Finding, ...] = ()
    if pairs is not None and found.by != "declared" and settings.accuracy_m is None:
        sigma_m = float(np.hypot(found.place_sigma_m, unsure_fit_m(pairs.fixes)))
        found, unsure = found._replace(place_sigma_m=sigma_m), tuple(accuracy_findings(pairs.fixes))
    chords = chords_of(rows.poses)
    aside_deg = course_off_heading_deg(chords, settings)
    # A row a pose, carried to the grid origin and judged; beside them the fixes that have none.
    table = _table(rows, log, pairs, found, chords, aside_deg, settings)
    attitude = None
    if tilt is not None and isinstance(rig, Rig):
        # How the vehicle leans, as the poses or the recording state it.
        at, told = table.time_ns - table.time_ns[0], tilt.time_ns - table.time_ns[0]
        roll, pitch, sigma = (np.interp(at, told, column) for column in tilt[1:])
        heading = np.unwrap(table.heading_deg, period=360.0)
        said = roll, pitch, sigma, sigma, heading, table.up_m
        attitude = Attitude(table.time_ns, *said, bodies=frozenset({RECORDED}))
    level_grids = level_grids and attitude is not None
    table = _at_origin(table, rows.poses, rig, level_grids=level_grids)
    table = _jumping(table, datum, settings.gnss)
    table, fix_row = _with_other_fixes(table, rows.fix, log)
    trajectory = judged(table, datum, settings, budget, GIVEN)
    findings = [*found.findings(), *unsure]
    if abs(aside_deg) > CLEAR_OFFSET_DEG:
        told = (
            f"The vehicle moves {aside_deg:+.1f}° off the forward axis of the poses where it "
            "drives straight; that is in the sigma of their heading."
        )
        remedy = "Check the camera's yaw, or the axes of the body."
        findings.append(warning("poses-aside", told, remedy, Figure(aside_deg, "deg")))
    if not trajectory.accepted.any():
        told = f"No pose can be used, mostly because: {commonest_reason(trajectory.reason)}."
        remedy = (
            "Say how good the fixes are with --accuracy METRES, or leave --poses out, so that "
            "poses are estimated from fixes and motion."
        )
        findings.append(warning("no-pose", told, remedy))
    return PlacedPoses(
        trajectory, fix_row, found, attitude, pairs, tuple(findings), table.gear_doubt
    )


def _with_fixes(poses: GivenPoses, log: ConditionedLog | None) -> GivenRows:
    """The poses, and between them one for each accepted fix."""
    fix_ns = np.zeros(0, dtype=np.int64) if log is None else log.accepted.time_ns
    inside = _within(fix_ns, poses.time_ns)
    time_ns = np.union1d(poses.time_ns, fix_ns[inside])
    fix = np.full(len(time_ns), -1, dtype=np.int64)
    fix[np.searchsorted(time_ns, fix_ns[inside])] = np.flatnonzero(inside)
    first_ns = poses.time_ns[0]
    columns = poses._replace(heading_deg=np.unwrap(poses.heading_deg, period=360.0))[1:]
    joint = GivenPoses._make(
        [time_ns, *(np.interp(time_ns - first_ns, poses.time_ns - first_ns, c) for c in columns)]
    )
    way_m = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(joint.x_m), np.diff(joint.y_m)))])
    return GivenRows(joint, way_m, fix)


def _within(wanted_ns: Int64, pose_ns: Int64) -> Bool:
    """Instants that have a pose, or lie between two that follow each other closely."""
    after = np.clip(np.searchsorted(pose_ns, wanted_ns), 1, len(pose_ns) - 1)
    between = (wanted_ns >= pose_ns[0]) & (wanted_ns <= pose_ns[-1])
    between &= pose_ns[after] - pose_ns[after - 1] <= MAX_GAP_NS
    return np.asarray(between | np.isin(wanted_ns, pose_ns))


def _pairs(
    rows: GivenRows, log: ConditionedLog | None, rig: VehicleGeometry | None
) -> Pairs | None:
    """The accepted fixes that poses were given for; None without any."""
    at = rows.fix >= 0
    if log is None or not at.any():
        return None
    poses = GivenPoses._make(column[at] for column in rows.poses)
    antenna_m = np.stack([poses.x_m, poses.y_m, poses.z_m], axis=1)
    if isinstance(rig, Rig):
        right_m, forward_m, up_m = rig.antenna.right_m, rig.antenna.forward_m, rig.antenna.up_m
        level = R_level_vehicle(poses.roll_deg, poses.pitch_deg)
        axes = np.asarray(R_enu_level(poses.heading_deg) @ level)
        antenna_m = antenna_m + axes @ [right_m, forward_m, up_m - rig.mount.height_m]
    return Pairs(log.accepted.part(rows.fix[at]), antenna_m)


def _georeference(
    poses: GivenPoses,
    pairs: Pairs | None,
    log: ConditionedLog | None,
    datum: Datum,
    settings: PoseSettings,
) -> Georeference:
    origin, heading_deg = settings.frame_origin, settings.frame_heading_deg
    declare = "--frame-origin LAT,LON,HEIGHT and --frame-heading DEG"
    if origin is not None:
        if heading_deg is None:
            raise ConfigError(
                "--frame-origin says where the frame of the poses lies, and nothing how it is "
                "turned; give --frame-heading DEG, the heading of its forward axis."
            )
        if pairs is None and settings.accuracy_m is None:
            raise ConfigError(
                "No fix tells how good the poses are; say it with --accuracy METRES, the 1-sigma "
                "error of a position along one axis."
            )
        own = Datum(origin.lat_deg, origin.lon_deg, origin.height_m)
        ends = own.to_geodetic(np.zeros(2), np.array([0.0, 100.0]), np.zeros(2))
        east, north, up = datum.to_enu(*ends)
        turned_deg = float(np.degrees(np.arctan2(east[1] - east[0], north[1] - north[0])))
        frame = (float(east[0]), float(north[0]), float(up[0]), heading_deg + turned_deg)
        return declared(*frame, pairs)
    if log is None:
        raise GnssError(f"No fix tells where the poses lie; declare it with {declare}.")
    if pairs is None:
        spans = " and the fixes ".join(
            f"({utc_text(one[0])} to {utc_text(one[-1])})"
            for one in (poses.time_ns, log.accepted.time_ns)
        )
        raise GnssError(
            f"The poses {spans} do not overlap in time; add the seconds between their clocks with "
            f"--poses-offset, choose another log with --gnss, or declare the frame with {declare}."
        )
    found = by_fixes(pairs, heading_deg)
    if found.frame_heading_sigma_deg > settings.max_heading_sigma_deg:
        raise GnssError(
            f"The fixes do not tell how the frame of the poses is turned: to "
            f"{found.frame_heading_sigma_deg:.1f}° > {settings.max_heading_sigma_deg:g}°; drive "
            "farther, take a better receiver, or declare it with --frame-heading DEG."
        )
    return found


def _table(
    rows: GivenRows,
    log: ConditionedLog | None,
    pairs: Pairs | None,
    found: Georeference,
    chords: Chords,
    aside_deg: float,
    settings: PoseSettings,
) -> PoseTable:
    """A row a pose, still at the sensor, not yet judged."""
    poses, n = rows.poses, len(rows.way_m)
    place = found.place(poses.x_m, poses.y_m)
    scatter_m = slow_m = 0.0
    alone_m, offset_m, stated_m = np.zeros(n), np.zeros(n), np.full(n, np.inf)
    quality = np.full(n, Quality.ESTIMATED, dtype=np.int64)
    remark = [""] * n
    if pairs is not None and log is not None:
        scatter_m, slow_m = found.scatter_m, float(np.median(pairs.fixes.sigma_m))
        off_m = found.place(*pairs.frame_m[:, :2].T) - pairs.fixes.points_m()
        offset_m, stated_m = fix_offsets(poses.time_ns, pairs.fixes, off_m)
        with_fix, near = rows.fix >= 0, np.isfinite(stated_m)
        alone_m = np.abs(rows.way_m[_ends(with_fix)] - rows.way_m).min(axis=0)
        offset_m, stated_m = (
            np.where(near, column, column[_ends(near)].max(axis=0))
            for column in (offset_m, stated_m)
        )
        quality[with_fix] = pairs.fixes.quality
        said = np.array(log.verdicts.reason, dtype=object)[log.verdicts.ok]
        for k in np.flatnonzero(with_fix).tolist():
            remark[k] = said[rows.fix[k]]
    elif settings.accuracy_m is not None:
        scatter_m = settings.accuracy_m
    wander_deg = np.linalg.norm(
        [np.nan_to_num(found.drift_deg), aside_deg, LEAST_HEADING_SIGMA_DEG]
    )
    drifted_m = np.hypot(
        max(DRIFT_SHARE, float(np.radians(wander_deg))) * alone_m, LEAST_POSITION_SIGMA_M
    )
    beyond_m = np.sqrt(max(scatter_m**2 - slow_m**2, 0.0))
    turned_deg = wander_deg * np.sqrt(1.0 + alone_m / DRIFT_M)
    doubts = (
        AddedSigma(found.sigma_m(place), heading_deg=found.frame_heading_sigma_deg),
        AddedSigma(scatter_m, beyond_m),
        AddedSigma(drifted_m, drifted_m, turned_deg),
    )
    still = resting(chords)
    speed = np.where(still, 0.0, chords.ahead_m / chords.seconds)
    return as_unsure(
        PoseTable(
            poses.time_ns,
            place[:, 0],
            place[:, 1],
            poses.z_m + found.up_m,
            np.asarray(wrap_deg(poses.heading_deg + found.frame_heading_deg - 90.0)),
            np.zeros(n),
            np.zeros(n),
            np.zeros(n),
            speed,
            np.sign(speed).astype(np.int64),
            np.zeros(n),
            offset_m,
            stated_m,
            quality,
            still,
            [""] * n,
            remark,
        ),
        doubts,
    )


def _ends(marked: Bool) -> Int64:
    """The marked rows [2, n] on either side of each row."""
    rows = np.flatnonzero(marked)
    after = np.searchsorted(rows, np.arange(len(marked)))
    return np.asarray(rows[np.clip([after - 1, after], 0, len(rows) - 1)])


def _at_origin(
    table: PoseTable, poses: GivenPoses, rig: VehicleGeometry | None, *, level_grids: bool
) -> PoseTable:
    """From the sensor to the ground below it: vertically, or for grids that are not level along
    the vehicle's own axis."""
    if not isinstance(rig, Rig):
        return table
    down_m = np.array([0.0, 0.0, -rig.mount.height_m])
    level = R_level_vehicle(poses.roll_deg, poses.pitch_deg)
    own = (R_enu_level(table.heading_deg) @ level) @ down_m
    moved = np.broadcast_to(down_m, own.shape) if level_grids else own
    return table._replace(
        east_m=table.east_m + moved[:, 0],
        north_m=table.north_m + moved[:, 1],
        up_m=table.up_m - rig.mount.height_m,
    )


def _jumping(table: PoseTable, datum: Datum, limits: GateLimits) -> PoseTable:
    """The rows with why a vehicle cannot have driven through some of them."""
    lat, lon, height = datum.to_geodetic(table.east_m, table.north_m, table.up_m)
    found = condition(
        FixColumns.of(
            table.time_ns,
            lat_deg=lat,
            lon_deg=lon,
            height_m=height,
            quality=Quality.UNKNOWN,
            sigma_m=POSE_SIGMA_M,
        ),
        limits.model_copy(update={"allowed_quality": frozenset(Quality)}),
    )
    rejection, remark = list(table.rejection), list(table.remark)
    for k, (gate, reason) in enumerate(zip(found.gate, found.reason, strict=True)):
        said = reason.replace("fixes", "poses").replace("fix", "pose")
        if gate is Gate.SEAM:
            remark[k] = remark[k] or said.replace("the solution has", "the poses have")
        elif gate not in (Gate.NONE, Gate.REPEAT):  # a vehicle at rest repeats its poses
            rejection[k] = said
    return table._replace(rejection=rejection, remark=remark)


def _with_other_fixes(
    table: PoseTable, own: Int64, log: ConditionedLog | None
) -> tuple[PoseTable, Int64]:
    """The rows, and beside them every fix that has none (`own` is the accepted fix of a row, or
    -1), rejected, with the pose of its time; and the row of each fix. Without fixes, all rows."""
    if log is None:
        return table, np.arange(len(table.time_ns), dtype=np.int64)
    of_row = np.full(len(own), -1, dtype=np.int64)
    of_row[own >= 0] = np.flatnonzero(log.verdicts.ok)[own[own >= 0]]
    extra = np.setdiff1d(np.arange(len(log.fixes)), of_row)
    fix_ns, node_ns = log.fixes.time_ns[extra], table.time_ns
    after = np.clip(np.searchsorted(node_ns, fix_ns), 1, len(node_ns) - 1)
    outside = ~_within(fix_ns, node_ns)
    none = "no pose was given for its time"
    whole = table.rows(np.concatenate([np.arange(len(own)), after]))
    fresh = np.arange(len(own), len(own) + len(extra))
    whole.time_ns[fresh] = fix_ns
    whole.quality[fresh] = log.fixes.quality[extra]
    beyond = fresh[outside]
    whole.heading_deg[beyond], whole.heading_sigma_deg[beyond] = np.nan, np.inf
    whole.speed_mps[beyond], whole.gear[beyond], whole.resting[beyond] = np.nan, 0, False
    for row, k in zip(fresh.tolist(), extra.tolist(), strict=True):
        whole.rejection[row] = log.verdicts.reason[k] if not log.verdicts.ok[k] else none
        whole.remark[row] = ""
    order = np.argsort(whole.time_ns, kind="stable")
    fix = np.concatenate([of_row, extra])[order]
    fix_row = np.empty(len(log.fixes), dtype=np.int64)
    fix_row[fix[fix >= 0]] = np.flatnonzero(fix >= 0)
    return whole.rows(order), fix_row
