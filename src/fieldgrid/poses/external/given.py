"""Poses of another program, as what the estimate takes: motion from pose to pose, and where their
frame is declared, fixes with a heading."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fieldgrid.core import (
    Bool,
    ConfigError,
    Figure,
    Finding,
    Float64,
    GnssError,
    Int64,
    PoseSettings,
    Quality,
    counted,
    utc_text,
    warning,
)
from fieldgrid.geometry import (
    MAX_GAP_NS,
    Carrier,
    Datum,
    FixColumns,
    GivenPoses,
    LeverArm,
    Motion,
    R_enu_level,
    R_level_vehicle,
    Rig,
    Steps,
    Trajectory,
    VehicleGeometry,
    heading_rad,
    roll_pitch_deg,
    wrap_deg,
)
from fieldgrid.poses.axle import ways_of
from fieldgrid.poses.external.georeference import (
    CLEAR_SIGMAS,
    Georeference,
    Pairs,
    check_mirrored,
    declared,
)
from fieldgrid.poses.fused import conditioned
from fieldgrid.poses.gates.conditioning import condition
from fieldgrid.poses.gates.verdict import Gate
from fieldgrid.poses.table import ConditionedLog
from fieldgrid.poses.travel_direction import travel

GIVEN = "given poses"
"""What a trajectory of them says where its headings come from."""

STEP_M, STEP_DEG, STEP_NS = 1.0, 3.0, 1_000_000_000
"""A step leads to the first pose that lies so far from its start, is turned by so much, or is so
late: what is white in poses adds up from step to step."""

WHITE_M, WHITE_DEG = 0.02, 0.05
"""How far each pose is off by itself, where its message does not say it."""

DRIFT_SHARE, DRIFT_DEG, DRIFT_M = 0.01, 1.0, 100.0
"""How far poses drift, as a share of each step; and their heading, over so long a way."""

HEADING_SIGMA_DEG = 0.5
"""How well the headings of a declared frame are taken to be known."""

MOST_OFTEN_NS = 50_000_000
"""Poses of a declared frame that follow each other faster say the same again."""

JUMP_SIGMA_M = 0.05
"""From pose to pose a trajectory errs by this at most: beyond it, it jumps."""

CLEAR_OFFSET_DEG = 1.0
"""A heading that is off the course by more is worth a word."""

BACKWARD_SHARE = 0.6
"""A vehicle that backs for a larger share of its way is one whose sensor looks backwards."""


class GivenDrive(NamedTuple):
    """What the estimate takes of a drive with given poses. `declared` is where their frame lies, if
    that is not left to the fixes: the `fixes` are then the poses."""

    fixes: FixColumns
    rig: VehicleGeometry | None
    datum: Datum | None
    settings: PoseSettings
    motion: Motion
    declared: Georeference | None
    findings: tuple[Finding, ...]


def given_drive(
    fixes: FixColumns,
    rig: VehicleGeometry | None,
    datum: Datum | None,
    settings: PoseSettings,
    motion: Motion,
) -> GivenDrive:
    """A drive with given poses. Raises GnssError where fixes and poses do not belong together, or
    nothing tells where these lie, ConfigError for half a declaration."""
    poses, origin, heading_deg = motion.poses, settings.frame_origin, settings.frame_heading_deg
    assert poses is not None
    log, findings = None, list[Finding]()
    declare = "declare the frame with --frame-origin LAT,LON,HEIGHT and --frame-heading DEG."
    try:
        log = conditioned(fixes, settings, datum)
    except GnssError as problem:
        if origin is None and len(fixes):
            raise
        if len(fixes):
            findings.append(warning("fixes", str(problem)))
    steps, jumps = steps_of_poses(poses, rig)
    aside_deg, aside = _aside(steps, settings)
    findings += [*jumps, *aside]
    motion = motion._replace(steps=steps)
    pairs = None if log is None else pairs_of(poses, log, rig)
    if heading_deg is not None and isinstance(rig, (Rig, Carrier)):
        # The headings are those of the poses, whatever a log would call its own.
        rig = replace(rig, heading_offset_deg=None, heading_convention="cw_north")
    sigma_deg = float(np.hypot(HEADING_SIGMA_DEG, aside_deg))
    if origin is not None:
        own = Datum(origin.lat_deg, origin.lon_deg, origin.height_m)
        datum = datum or (own if log is None else log.datum)
        frame = _declared_frame(own, datum, pairs, settings)
        fixes = _as_fixes(poses, frame, rig, datum, fixes, settings, sigma_deg)
        if isinstance(rig, Rig):
            rig = replace(rig, antenna=LeverArm(0.0, 0.0, 0.0))
        limits = settings.gnss.model_copy(update={"allowed_quality": frozenset({Quality.UNKNOWN})})
        settings = settings.model_copy(update={"gnss": limits, "quality": None, "accuracy_m": None})
        motion = Motion(tilt=motion.tilt, poses=poses)
        return GivenDrive(fixes, rig, datum, settings, motion, frame, tuple(findings))
    if log is None:
        raise GnssError(f"No fix tells where the poses lie; give a log with --gnss, or {declare}")
    if pairs is None:
        spans = " and the fixes ".join(
            f"({utc_text(one[0])} to {utc_text(one[-1])})"
            for one in (poses.time_ns, log.accepted.time_ns)
        )
        raise GnssError(
            f"The poses {spans} do not overlap in time; add the seconds between their clocks with "
            f"--poses-offset, choose another log with --gnss, or {declare}"
        )
    check_mirrored(pairs)
    if heading_deg is not None:
        fixes = _with_headings(fixes, poses, heading_deg, sigma_deg)
    return GivenDrive(fixes, rig, datum, settings, motion, None, tuple(findings))


def steps_of_poses(
    poses: GivenPoses, rig: VehicleGeometry | None
) -> tuple[Steps, tuple[Finding, ...]]:
    """The motion from pose to pose of the ground below the sensor, and a finding where some jump
    away from the others: these are left out, and no step leads across a jump for good."""
    kept, part, findings = _driven(poses)
    place, R = _ground(poses, rig)
    heading = np.unwrap(poses.heading_deg, period=360.0)
    start, stop, last = [], [], int(kept[0])
    for k in kept[1:].tolist():
        way_m = np.hypot(*(place[k] - place[last])[:2])
        late = poses.time_ns[k] - poses.time_ns[last] >= STEP_NS
        if late or way_m >= STEP_M or abs(heading[k] - heading[last]) >= STEP_DEG:
            if part[k] == part[last]:
                start.append(last)
                stop.append(k)
            last = k
    a, b = np.array(start, dtype=np.int64), np.array(stop, dtype=np.int64)
    back = np.swapaxes(R[a], 1, 2)
    right_m, forward_m, up_m = np.einsum("nij,nj->in", back, place[b] - place[a])
    turned = back @ R[b]
    roll_deg, pitch_deg = roll_pitch_deg(turned)
    length_m = np.hypot(right_m, forward_m)
    drift_deg = DRIFT_DEG * np.sqrt(length_m / DRIFT_M)
    sigma_deg = _step_sigma(poses.sigma_deg, a, b, WHITE_DEG, drift_deg)
    # Poses made in the plane do not tell how the vehicle leans.
    told = np.where(poses.roll_deg.any() or poses.pitch_deg.any(), 1.0, np.nan)
    steps = Steps(
        poses.time_ns[a],
        poses.time_ns[b],
        forward_m,
        right_m,
        np.degrees(heading_rad(turned)),
        _step_sigma(poses.sigma_m, a, b, WHITE_M, DRIFT_SHARE * length_m),
        sigma_deg,
        told * up_m,
        told * roll_deg,
        told * pitch_deg,
        told * sigma_deg,
    )
    return steps, findings


def _step_sigma(
    stated: Float64, start: Int64, stop: Int64, white: float, drift: Float64
) -> Float64:
    """The error of steps between poses of which an error is `stated`, NaN where none is. By as much
    as its variance changes poses drift, and no less than is usual; each by itself is off by no more
    than it states, and no more than is usual, for what does not change may be slow."""
    one, other = stated[start] ** 2, stated[stop] ** 2
    said = np.maximum(np.abs(other - one), drift**2) + np.minimum(one + other, 2.0 * white**2)
    return np.sqrt(np.where(np.isnan(said), drift**2 + 2.0 * white**2, said))


def _driven(poses: GivenPoses) -> tuple[Int64, Int64, tuple[Finding, ...]]:
    """The poses through which a vehicle can have driven, and which of them belong to one part: a
    program may go on elsewhere."""
    x_m, y_m, z_m = (column - column[0] for column in poses[1:4])
    lat, lon, height = Datum(1.0, 1.0, 0.0).to_geodetic(x_m, y_m, z_m)
    sigma_m = np.full(len(lat), JUMP_SIGMA_M)
    verdicts = condition(
        FixColumns.of(poses.time_ns, lat_deg=lat, lon_deg=lon, height_m=height, sigma_m=sigma_m)
    )
    jumps = np.array([gate not in (Gate.NONE, Gate.REPEAT, Gate.SEAM) for gate in verdicts.gate])
    seams = np.array([gate is Gate.SEAM for gate in verdicts.gate])
    kept = np.flatnonzero(~jumps)
    if len(kept) < 2:
        raise GnssError("No vehicle can have driven through the poses; check their times and axes.")
    findings: tuple[Finding, ...] = ()
    if (jumps | seams).any():
        first = int(np.argmax(jumps | seams))
        why = verdicts.reason[first].replace("fixes", "poses").replace("fix", "pose")
        told = f"{counted(int((jumps | seams).sum()), 'pose')} of another program jump: {why}"
        findings = (warning("poses-jump", f"{told}. No motion is taken from there."),)
    return kept, np.cumsum(seams), findings


def _aside(steps: Steps, settings: PoseSettings) -> tuple[float, tuple[Finding, ...]]:
    """By how much the vehicle moves aside of the forward axis of the poses, degrees clockwise,
    where that is clear, and a finding then. Raises GnssError for an axis that is none of the
    vehicle's."""
    way_m = float(np.abs(steps.forward_m).sum())
    back = -float(np.minimum(steps.forward_m, 0.0).sum()) / max(way_m, 1e-9)
    if back > BACKWARD_SHARE and settings.starts is None and not settings.gear_spans:
        raise GnssError(
            f"By the poses the vehicle drives backwards for {100.0 * back:.0f} % of its way; if "
            "their body looks backwards, declare that with --poses-axes (bru for flu), and "
            "if the vehicle backed, say --starts reverse."
        )
    yaw = travel(ways_of(steps)).yaw_deg
    if yaw is None or abs(yaw.value) < max(CLEAR_OFFSET_DEG, CLEAR_SIGMAS * yaw.sigma):
        return 0.0, ()
    told = (
        f"The vehicle moves {-yaw.value:+.1f}° ± {yaw.sigma:.1f}° off the forward axis of the "
        "poses where it drives straight (clockwise)"
    )
    if abs(yaw.value) > settings.max_heading_offset_deg:
        raise GnssError(
            f"{told}; declare the axes of their body with --poses-axes, or of camera axes the "
            "camera's yaw in mounting.json."
        )
    remedy = "Check the camera's yaw, or the axes of the body."
    found = warning("poses-aside", f"{told}.", remedy, Figure(-yaw.value, "deg"))
    return -yaw.value, (found,)


def _ground(poses: GivenPoses, rig: VehicleGeometry | None) -> tuple[Float64, Float64]:
    """The ground below the sensor, along the vehicle's own axis, in the frame of the poses [n, 3],
    and the vehicle's axes [n, 3, 3]; without a rig, the antenna."""
    R = R_enu_level(poses.heading_deg) @ R_level_vehicle(poses.roll_deg, poses.pitch_deg)
    place = np.stack([poses.x_m, poses.y_m, poses.z_m], axis=1)
    return place - R[:, :, 2] * (rig.mount.height_m if isinstance(rig, Rig) else 0.0), R


def poses_at(poses: GivenPoses, time_ns: Int64) -> GivenPoses:
    """The poses of other instants."""
    first_ns = poses.time_ns[0]
    columns = poses._replace(heading_deg=np.unwrap(poses.heading_deg, period=360.0))[1:]
    at = [np.interp(time_ns - first_ns, poses.time_ns - first_ns, column) for column in columns]
    return GivenPoses(time_ns, *at)


def _within(wanted_ns: Int64, pose_ns: Int64) -> Bool:
    """Instants that have a pose, or lie between two that follow each other closely."""
    after = np.clip(np.searchsorted(pose_ns, wanted_ns), 1, len(pose_ns) - 1)
    between = (wanted_ns >= pose_ns[0]) & (wanted_ns <= pose_ns[-1])
    between &= pose_ns[after] - pose_ns[after - 1] <= MAX_GAP_NS
    return np.asarray(between | np.isin(wanted_ns, pose_ns))


def pairs_of(poses: GivenPoses, log: ConditionedLog, rig: VehicleGeometry | None) -> Pairs | None:
    """The accepted fixes that poses were given for, of a vehicle that stands level; None without
    any."""
    rows = np.flatnonzero(_within(log.accepted.time_ns, poses.time_ns))
    if not len(rows):
        return None
    at = poses_at(poses, log.accepted.time_ns[rows])
    antenna_m, _ = _ground(at, rig)
    if isinstance(rig, Rig):
        lever_m = [rig.antenna.right_m, rig.antenna.forward_m, rig.antenna.up_m]
        antenna_m = antenna_m + R_enu_level(at.heading_deg) @ lever_m
    return Pairs(rows, log.accepted.part(rows), antenna_m, at.heading_deg)


def _with_headings(
    fixes: FixColumns, poses: GivenPoses, frame_deg: float, sigma_deg: float
) -> FixColumns:
    """Fixes with the headings of the poses, whose frame is turned by what is declared."""
    fixes = fixes.in_order()
    heading = wrap_deg(poses_at(poses, fixes.time_ns).heading_deg + frame_deg - 90.0)
    known = np.where(_within(fixes.time_ns, poses.time_ns), heading, np.nan)
    sigmas_deg = np.full(len(fixes), sigma_deg)
    return fixes.replace(heading_deg=known, heading_sigma_deg=sigmas_deg)


def risen(track: Trajectory, poses: GivenPoses, log: ConditionedLog) -> Float64:
    """Heights of a track, which are those of the fixes, with how the poses rise between them."""
    z_m = poses_at(poses, track.time_ns).z_m
    at_ns, fix_ns = (one - poses.time_ns[0] for one in (track.time_ns, log.accepted.time_ns))
    return np.asarray(track.up_m + z_m - np.interp(at_ns, fix_ns, np.interp(fix_ns, at_ns, z_m)))


def _declared_frame(
    own: Datum, datum: Datum, pairs: Pairs | None, settings: PoseSettings
) -> Georeference:
    """Where the settings say that the frame lies, whose origin is that of its `own` datum."""
    if settings.frame_heading_deg is None:
        raise ConfigError(
            "--frame-origin says where the frame of the poses lies, and nothing how it is "
            "turned; give --frame-heading DEG, the heading of its forward axis."
        )
    if pairs is None and settings.accuracy_m is None:
        raise ConfigError(
            "No fix tells how good the poses are; say it with --accuracy METRES, the 1-sigma "
            "error of a position along one axis."
        )
    ends = own.to_geodetic(np.zeros(2), np.array([0.0, 100.0]), np.zeros(2))
    east, north, up = datum.to_enu(*ends)
    turned_deg = float(np.degrees(np.arctan2(east[1] - east[0], north[1] - north[0])))
    return declared(
        float(east[0]),
        float(north[0]),
        float(up[0]),
        settings.frame_heading_deg + turned_deg,
        pairs,
    )


def _as_fixes(
    poses: GivenPoses,
    frame: Georeference,
    rig: VehicleGeometry | None,
    datum: Datum,
    fixes: FixColumns,
    settings: PoseSettings,
    sigma_deg: float,
) -> FixColumns:
    """Poses of a declared frame as fixes with a heading, also at the times of the fixes between
    them; of a fix without a pose nothing but its time is left."""
    has = _within(fixes.time_ns, poses.time_ns)
    apart = np.diff((poses.time_ns - poses.time_ns[0]) // MOST_OFTEN_NS, prepend=-1) > 0
    at = poses_at(poses, np.union1d(poses.time_ns[apart], fixes.time_ns[has]))
    ground, _ = _ground(at, rig)
    places = frame.place(ground[:, 0], ground[:, 1])
    lat, lon, height = datum.to_geodetic(places[:, 0], places[:, 1], ground[:, 2] + frame.up_m)
    scatter_m = settings.accuracy_m or frame.scatter_m
    stated_deg = np.fmax(at.sigma_deg, sigma_deg)
    without = np.unique(fixes.time_ns[~has])
    none = np.full(len(without), np.nan)
    return FixColumns.of(
        np.concatenate([at.time_ns, without]),
        lat_deg=np.concatenate([lat, none]),
        lon_deg=np.concatenate([lon, none]),
        height_m=np.concatenate([height, none]),
        sigma_m=np.concatenate([np.hypot(np.fmax(at.sigma_m, scatter_m), WHITE_M), none]),
        heading_deg=np.concatenate(
            [wrap_deg(at.heading_deg + frame.frame_heading_deg - 90.0), none]
        ),
        heading_sigma_deg=np.concatenate([stated_deg, none]),
    ).in_order()
