"""Where a drive went and in which gears: its stations, and the first guess of its poses."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float64, Int64, PoseSettings
from fieldgrid.geometry import Motion, first_beyond, heading_deg, wrap_deg
from fieldgrid.poses.accepted import AcceptedFixes
from fieldgrid.poses.faults.leaps.leaps import leaps
from fieldgrid.poses.gears.course import STATION_M, stations
from fieldgrid.poses.gears.legs import REACH_M, REACH_SIGMAS, GearEvidence, Gears, gears
from fieldgrid.poses.measured import WHEEL_SIGMA_MPS, turn_back, wheel_speed_at
from fieldgrid.poses.nodes import Nodes, seconds
from fieldgrid.poses.smoother.envelope import STATES
from fieldgrid.poses.smoother.measurements import Measurements

STATION_SIGMAS = 2.0
"""A vehicle has moved on when it is a station, and beyond the noise, from where it was."""

TORN_M = 0.5
"""Nothing is said of gears across a jump of the positions of more than this."""

WINDING_NS = 2_000_000_000
"""Between courses that are farther apart a vehicle may turn by more than half a circle."""

WINDING_DEG = 90.0
"""A vehicle that turns by more than this along a chord does so on the spot, maybe by more than half
a circle, and the chord is no course."""

STEP_NATS, WHEEL_NATS, RECORDED_NATS = 8.0, 2.0, 4.0
"""How strongly a camera's step, a wheel's and a compass's sign speak of the gear."""

UNSIGNED_NATS = 0.3
"""How strongly the sign of wheels that never turn back speaks of the gear: they may not know
how."""

TELL_GEARS = "say --starts forward or --starts reverse, or give --gear FILE with spans"

HINT_NATS = 200.0
"""A hint of the user outweighs everything."""


class StationGears(NamedTuple):
    """The stations of a drive and their gears: `station` are fixes, the rest is at them."""

    station: Int64
    gears: Gears


NO_HINTS = PoseSettings()
"""The hints of gears are those of the settings: the gear that the drive starts in, and of spans."""


def station_gears(
    fixes: AcceptedFixes,
    at: Nodes,
    standing: Bool,
    resting: Bool,
    motion: Motion,
    recorded_deg: Float64,
    hints: PoseSettings,
) -> StationGears:
    """Stations and gears of accepted fixes; `standing` marks those at one place, `resting` those
    of them at which no gyro sees a turn, `recorded_deg` are headings that were recorded, NaN where
    there is none."""
    points, time_ns = fixes.points_m(), fixes.time_ns
    noise_m, steps_s = fixes.noise.across_m, np.diff(time_ns) / 1e9
    hole, torn = breaks(fixes)
    part = np.concatenate([[0], np.cumsum(hole | torn)])
    station = stations(
        points, part, standing, max(STATION_M, STATION_SIGMAS * float(np.median(noise_m)))
    )
    at_ns = time_ns[station]
    # A hole lasts from station to station, a jump only between its two fixes.
    holes, torn_s = (
        np.diff(np.concatenate([[0.0], np.cumsum(column)])[station])
        for column in (hole, np.where(torn, steps_s, 0.0))
    )
    gap_s = np.concatenate([[np.inf], np.where(holes > 0.0, np.diff(at_ns) / 1e9, torn_s)])
    track = GearEvidence(
        points[station],
        seconds(at_ns),
        gap_s,
        noise_m[station],
        _turned_deg(at, at_ns, time_ns[resting]),
        _forward_nats(points[station], at_ns, gap_s, motion, recorded_deg[station], hints),
    )
    return StationGears(station, gears(track))


def breaks(fixes: AcceptedFixes) -> tuple[Bool, Bool]:
    """Which steps [n - 1] between fixes are holes, and which of the others the motion before and
    after them does not make: of these one side is a jump that conditioning has let pass, or the
    solution has moved."""
    steps = leaps(
        *(fixes.points_m(), seconds(fixes.time_ns), fixes.noise.across_m),
        *(fixes.disputed, TORN_M),
    )
    return steps.hole, steps.torn


def _turned_deg(at: Nodes, time_ns: Int64, resting_ns: Int64) -> Float64:
    """What the gyro saw on the way to each instant, its bias taken out where the vehicle rests;
    NaN on the way across a hole in it."""
    if not at.has_gyro():
        return np.full(len(time_ns), np.nan)
    step_s = np.diff(at.time_ns) / 1e9
    seen = np.isfinite(at.turned_rad)
    still = np.isin(at.time_ns[:-1], resting_ns) & seen
    bias = 0.0
    if step_s[still].sum() > 2.0:
        bias = float(at.turned_rad[still].sum() / step_s[still].sum())
    steps = np.where(seen, at.turned_rad - bias * step_s, 0.0)
    node = np.searchsorted(at.time_ns, time_ns)
    angle, holes = (np.concatenate([[0.0], np.cumsum(c)])[node] for c in (steps, ~seen))
    turned = np.where(np.diff(holes) == 0.0, np.diff(angle), np.nan)
    return np.asarray(np.degrees(np.concatenate([[np.nan], turned])))


def _forward_nats(
    points: Float64,
    time_ns: Int64,
    gap_s: Float64,
    motion: Motion,
    recorded_deg: Float64,
    hints: PoseSettings,
) -> Float64:
    """Log odds of forward on the way to each station, from camera, wheels, compass and user."""
    nats = np.zeros(len(time_ns))
    steps, wheels = motion.steps, motion.wheels
    if steps is not None:
        to = np.searchsorted(time_ns, (steps.start_ns + steps.stop_ns) // 2)
        inside = (to > 0) & (to < len(time_ns))
        told = np.clip(steps.forward_m / (3.0 * steps.sigma_m), -1.0, 1.0) * STEP_NATS
        np.add.at(nats, to[inside], told[inside])
    if wheels is not None:
        speed = np.nan_to_num(wheel_speed_at(time_ns, wheels))
        each = WHEEL_NATS if turn_back(wheels) else UNSIGNED_NATS
        nats += np.clip(speed / (2.0 * WHEEL_SIGMA_MPS), -1.0, 1.0) * each
    if len(points) > 1:
        course = heading_deg(*np.diff(points, axis=0).T)
        agree = np.cos(np.radians(course - recorded_deg[1:]))
        nats[1:] += np.nan_to_num(agree) * RECORDED_NATS
    # What is said of the start holds where it is first seen to drive, not across a hole before.
    nats[np.flatnonzero(gap_s == 0.0)[:1]] += HINT_NATS * (
        0 if hints.starts is None else hints.starts.sign
    )
    for one in hints.gear_spans:
        nats[(time_ns > one.start_ns) & (time_ns <= one.stop_ns)] += HINT_NATS * one.gear.sign
    return nats


def first_guess(
    fixes: AcceptedFixes, at: Nodes, stations_of: StationGears, measured: Measurements
) -> Float64:
    """States [n, 8] with the right gears: course over a short chord, turned in reverse; in a hole
    turned on as gyro or camera saw it."""
    station, found = stations_of
    points = fixes.points_m()[station]
    reach_m = max(REACH_M, REACH_SIGMAS * float(np.median(fixes.noise.across_m)))
    heading, speed = np.full(len(station), np.nan), np.zeros(len(station))
    cuts = np.flatnonzero(np.diff(found.leg)) + 1
    seen_rad = measured.seen_turns_rad()
    turned_rad = np.append(0.0, np.cumsum(np.nan_to_num(seen_rad)))
    turned_deg = np.degrees(turned_rad[np.searchsorted(at.time_ns, fixes.time_ns[station])])
    for leg in np.split(np.arange(len(station)), cuts):
        time_s = seconds(fixes.time_ns[station[leg]])
        heading[leg], speed[leg] = _chords(points[leg], time_s, turned_deg[leg], reach_m)
    heading = np.where(found.gear < 0, heading + 180.0, heading)
    heading[~found.driven] = np.nan  # a wandering path, which would turn the guess around
    known = np.flatnonzero(np.isfinite(heading))
    guess = np.zeros((len(at.time_ns), STATES))
    guess[:, 0] = np.interp(at.time_ns, fixes.time_ns, fixes.east_m)
    guess[:, 1] = np.interp(at.time_ns, fixes.time_ns, fixes.north_m)
    if known.size:
        times = fixes.time_ns[station[known]]
        turns = np.asarray(wrap_deg(np.diff(heading[known])))
        # From one course to the next nobody turns by more than half a circle, but in a hole or on
        # the spot. The gyro's bias, a degree a second, leaves no doubt which way it was.
        # By how much the vehicle was seen to turn until each node [n], counted only in long gaps
        # between the instants, and there where all of it was seen (`seen_rad` [n - 1], NaN: not).
        gap = np.searchsorted(times, at.time_ns[:-1], side="right")
        unseen = np.bincount(gap[np.isnan(seen_rad)], minlength=len(times) + 1)
        length_ns = np.diff(times, prepend=at.time_ns[0], append=at.time_ns[-1])
        counts = (length_ns >= WINDING_NS) & (unseen == 0)
        turned = np.append(0.0, np.cumsum(np.where(counts[gap], seen_rad, 0.0)))
        seen_deg = np.asarray(np.degrees(turned))
        seen_then = seen_deg[np.searchsorted(at.time_ns, times)]
        turns_seen = np.diff(seen_then)
        turns = turns_seen + wrap_deg(turns - turns_seen)
        angle_deg = (
            heading[known[0]]
            - seen_then[0]
            + np.concatenate([[0.0], np.cumsum(turns - turns_seen)])
        )
        guess[:, 2] = np.radians(np.interp(at.time_ns, times, angle_deg) + seen_deg)
        guess[:, 3] = np.interp(at.time_ns, times, (speed * found.gear)[known])
        # Where there are no fixes, on as the steps have it.
        forward, right, _ = measured.step.T
        start = measured.step_nodes[:, 0]
        sin, cos = np.sin(guess[start, 2]), np.cos(guess[start, 2])
        for axis, way_m in enumerate((forward * sin + right * cos, forward * cos - right * sin)):
            path = np.append(0.0, np.cumsum(np.nan_to_num(measured.by_steps(way_m))))
            has = at.fix >= 0
            guess[:, axis] = path + np.interp(
                at.time_ns, at.time_ns[has], guess[has, axis] - path[has]
            )
    return guess


def _chords(
    points: Float64, time_s: Float64, turned_deg: Float64, reach_m: float
) -> tuple[Float64, Float64]:
    """Course, degrees, and speed, m/s, at each point of a leg, until which the vehicle was seen to
    turn by `turned_deg`; NaN for a leg that is a point, and where it turns on the spot."""
    before, after = first_beyond(points, reach_m, -1), first_beyond(points, reach_m, 1)
    start, stop = np.where(before < 0, 0, before), np.where(after < 0, len(points) - 1, after)
    chord = points[stop] - points[start]
    length_m, span_s = np.hypot(*chord.T), time_s[stop] - time_s[start]
    tells = (length_m > reach_m / 2.0) & (
        np.abs(turned_deg[stop] - turned_deg[start]) < WINDING_DEG
    )
    course = np.where(tells, heading_deg(*chord.T), np.nan)
    return course, length_m / np.maximum(span_s, 0.02)
