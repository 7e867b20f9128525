"""Heading from positions alone: the course over a baseline, and where it turns around.

Two consecutive fixes say nothing (at 5 Hz and 5 km/h they are 0.28 m apart), so a curve is
fitted to all fixes within a baseline around each one. In reverse the course is the heading
turned by 180°, so the path is first cut where it turns back on itself.
"""

from __future__ import annotations

import itertools
import math
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Bool, Float64, Int64, kernel
from fieldgrid.geometry import first_beyond, heading_deg, wrap_deg

CUSP_DEG = 110.0
"""A path whose direction before and after a point differs by more has turned back there."""


NOISE_SHARE = 0.3
"""Of the error of a fix this share is noise; the rest wanders slowly and cancels in a slope."""

STATION_M = 0.05
"""Fixes closer together than this say nothing more of the course than one of them."""

WINDOW_POINTS = 200
"""A window of more points than this is thinned: a crawl at 100 Hz has no end of them."""

CUSP_REACH_M = 1.0
"""How far around a point its turning is looked at, when the fixes are good enough: two cusps
that are closer together than twice this are taken for one."""

TURN_SHARE = 0.06
"""A parabola follows a turn to about this share of it: 0.6° where the window turns by 10°."""

NOSE_DEG = 0.4
"""How far a nose that follows its course still wanders from it: slip, sway, short weaving."""

SWAY_DEG = 0.4
"""How much a vehicle rolls on a field; an antenna 3 m up sways by 2 cm with it."""


class Course(NamedTuple):
    """The vehicle's heading at each position, its 1-sigma error, and the gear.

    All length n. `heading_deg` points along the nose; NaN where it is not known. `gear` is
    +1 forward, -1 reverse. `span_m` is the length of path that the estimate rests on.
    """

    heading_deg: Float64
    sigma_deg: Float64
    gear: Int64
    span_m: Float64


def course(
    east_m: Float64,
    north_m: Float64,
    sigma_m: Float64,
    part: Int64,
    baseline_m: float,
    height_m: float = 0.0,
) -> Course:
    """Heading at each of n positions (metres, in time order) of a vehicle that follows its nose.

    `part` numbers the uninterrupted parts of the drive; no estimate reaches across. In each,
    the path is cut at its cusps and the gear changes at each cut; the gear in which more of
    the part is driven is taken to be forward. `height_m` is the antenna's, for its sway.
    """
    sway_m = height_m * float(np.radians(SWAY_DEG))
    n = len(east_m)
    result = Course(np.full(n, np.nan), np.full(n, np.inf), np.ones(n, dtype=np.int64), np.zeros(n))
    for number in np.unique(part):
        members = np.flatnonzero(part == number)
        points = np.stack([east_m[members], north_m[members]], axis=1)
        cuts = [0, *(k + 1 for k in cusps(points, sigma_m[members], baseline_m)), len(points)]
        legs = [(a, b) for a, b in itertools.pairwise(cuts) if b > a]
        way_m = np.append(0.0, np.cumsum(np.hypot(*np.diff(points, axis=0).T)))
        lengths_m = [way_m[stop - 1] - way_m[start] for start, stop in legs]
        forward_parity = int(sum(lengths_m[::2]) < sum(lengths_m[1::2]))
        for k, (start, stop) in enumerate(legs):
            gear = 1 if k % 2 == forward_parity else -1
            result.gear[members[start:stop]] = gear
            leg = points[start:stop]
            noise_m = np.hypot(NOISE_SHARE * sigma_m[members[start:stop]], sway_m)
            for at, window in enumerate(_windows(leg, baseline_m)):
                direction, sigma, span = _direction(leg, noise_m, at, window, baseline_m)
                index = members[start + at]
                result.heading_deg[index] = wrap_deg(direction if gear > 0 else direction + 180.0)
                # What no residual shows: the nose's own wandering, and that of the fixes
                # between the ends of the window.
                drift_m = NOISE_SHARE * math.sqrt(2.0) * sigma_m[index]
                wander_deg = math.degrees(drift_m / max(span, 1e-3))
                result.sigma_deg[index] = math.hypot(sigma, NOSE_DEG, wander_deg)
                result.span_m[index] = span
    return result


def cusps(points: Float64, sigma_m: Float64, baseline_m: float) -> list[int]:
    """Indices of the positions [n, 2] (metres) at which the path turns back on itself."""
    noise_m = NOISE_SHARE * float(np.median(sigma_m))
    reach_m = min(baseline_m / 2.0, max(CUSP_REACH_M, 6.0 * noise_m))
    before, after = first_beyond(points, reach_m, -1), first_beyond(points, reach_m, 1)
    known = (before >= 0) & (after >= 0)
    incoming, outgoing = points - points[before], points[after] - points
    turn = wrap_deg(heading_deg(*outgoing.T) - heading_deg(*incoming.T))
    turning = np.where(known, np.abs(turn), 0.0)
    found = []
    for start, stop in runs_of(turning > CUSP_DEG):
        feet = (points[before[start]] + points[after[stop - 1]]) / 2.0
        found.append(start + int(np.argmax(np.hypot(*(points[start:stop] - feet).T))))
    return found


def runs_of(marked: Bool) -> list[tuple[int, int]]:
    """The runs of marked points: the first of each, and the one behind it."""
    edges = np.diff(np.concatenate([[False], marked, [False]]).astype(np.int8))
    starts, stops = np.flatnonzero(edges > 0), np.flatnonzero(edges < 0)
    return list(zip(starts.tolist(), stops.tolist(), strict=True))


@kernel
def stations(points, part, standing, step_m):  # type: ignore[no-untyped-def]
    """Indices of the points [n, 2] worth an estimate: each `step_m` from the one before.

    A vehicle that waits an hour adds tens of thousands of fixes and nothing to its course.
    `standing` marks points at which the receiver saw no motion: what they wander is no path.
    Every part begins with a station.
    """
    found = np.empty(len(points), dtype=np.int64)
    count, last = 0, -1
    for k in range(len(points)):
        if last >= 0 and part[k] == part[last]:
            if standing[k]:
                continue
            d_east, d_north = points[k, 0] - points[last, 0], points[k, 1] - points[last, 1]
            if d_east * d_east + d_north * d_north < step_m * step_m:
                continue
        found[count], last = k, k
        count += 1
    return found[:count]


def _windows(leg: Float64, baseline_m: float) -> list[tuple[int, int]]:
    """The (start, stop) of the points that each point's direction is fitted to.

    Half a baseline to each side; near an end of the leg, a whole one to the other side.
    """
    n, half_m = len(leg), baseline_m / 2.0
    before, after = first_beyond(leg, half_m, -1), first_beyond(leg, half_m, 1)
    far_before, far_after = first_beyond(leg, baseline_m, -1), first_beyond(leg, baseline_m, 1)
    start = np.where(after < 0, far_before, before)
    stop = np.where(before < 0, far_after, after)
    start, stop = np.where(start < 0, 0, start), np.where(stop < 0, n - 1, stop) + 1
    return list(zip(start.tolist(), stop.tolist(), strict=True))


def _direction(
    leg: Float64,
    least_noise_m: Float64,
    at: int,
    between: tuple[int, int],
    baseline_m: float,
) -> tuple[float, float, float]:
    """Direction of travel at one point of a leg: degrees, 1-sigma, and the span used, metres.

    Along the window's chord a parabola is fitted to the offsets across it; the direction is
    its tangent.
    """
    start, stop = between
    stride = max((stop - start) // WINDOW_POINTS, 1)
    window = leg[start:stop:stride]
    chord = window[-1] - window[0]
    span_m = float(np.hypot(*chord))
    if span_m < baseline_m / 2.0 or len(window) < 3:
        return float("nan"), float("inf"), span_m
    along = (window - leg[at]) @ chord / span_m
    across = (window - leg[at]) @ np.array([chord[1], -chord[0]]) / span_m
    slope, slope_sigma = _slope_at_zero(
        along, across, float(np.median(least_noise_m[start:stop])), span_m
    )
    tangent_deg = float(np.degrees(np.arctan(slope)))
    noise_deg = np.degrees(slope_sigma / (1.0 + slope * slope))
    middle = len(window) // 2
    first, second = window[middle] - window[0], window[-1] - window[middle]
    turn_deg = abs(float(wrap_deg(heading_deg(*second) - heading_deg(*first))))
    sigma_deg = float(np.hypot(noise_deg, TURN_SHARE * turn_deg))
    return float(heading_deg(*chord)) + tangent_deg, sigma_deg, span_m


def _slope_at_zero(
    along_m: Float64, across_m: Float64, least_noise_m: float, span_m: float
) -> tuple[float, float]:
    """Slope at 0 of the curve across = f(along), and its 1-sigma error.

    A parabola, or a line where too few places support one. Where a curve begins or ends no
    parabola fits; a cubic's slope then differs by more than noise explains, and the excess is
    added to the error.
    """
    scaled = along_m / span_m
    distinct = len(np.unique(np.round(scaled * 20.0)))
    degree = 2 if distinct >= 5 else 1
    slope, leverage, residual = _fit(scaled, across_m, degree)
    freedom = max(len(along_m) - degree - 1, 1)
    # The scatter about the curve, but not less than what is known to be there: few residuals
    # can be small by luck, and sway is too slow to show in them.
    noise_m = max(float(np.sqrt(residual @ residual / freedom)), least_noise_m)
    variance = noise_m**2 * leverage
    if distinct >= 7:
        cubic, cubic_leverage, _ = _fit(scaled, across_m, 3)
        explained = noise_m**2 * max(cubic_leverage - leverage, 0.0)
        variance += max((cubic - slope) ** 2 - explained, 0.0)
    return slope / span_m, float(np.sqrt(variance)) / span_m


def _fit(x: Float64, y: Float64, degree: int) -> tuple[float, float, Float64]:
    """Least squares polynomial: its slope at 0, that slope's variance for noise 1, residuals."""
    design = np.vander(x, degree + 1, increasing=True)
    inverse = np.linalg.inv(design.T @ design + 1e-9 * np.eye(degree + 1))
    coefficients = inverse @ (design.T @ y)
    return float(coefficients[1]), float(inverse[1, 1]), y - design @ coefficients


def course_of_axle(
    found: Course,
    east_m: Float64,
    north_m: Float64,
    part: Int64,
    ahead_m: float,
) -> Course:
    """The heading from the course of an antenna that sits `ahead_m` before the fixed axle.

    The axle follows the antenna as a trailer does: d(heading)/d(path) = sin(course - heading)
    / ahead. Forward that is stable in the direction of time, in reverse against it, so each
    leg is followed from its stable end, starting as if its first curve had gone on for ever;
    how wrong that can be is added to sigma and fades with exp(-path/ahead).
    """
    heading, sigma = found.heading_deg.copy(), found.sigma_deg.copy()
    known = np.flatnonzero(~np.isnan(found.heading_deg))
    if abs(ahead_m) < 0.01 or known.size == 0:
        return found
    cut = (np.diff(part[known]) != 0) | (np.diff(found.gear[known]) != 0)
    for leg in np.split(known, np.flatnonzero(cut) + 1):
        # An antenna behind the axle turns stability around.
        ordered = leg if found.gear[leg[0]] * ahead_m > 0 else leg[::-1]
        path_m = np.hypot(np.diff(east_m[ordered]), np.diff(north_m[ordered]))
        lead_deg = _trailing_lead(np.radians(found.heading_deg[ordered]), path_m, abs(ahead_m))
        along_m = np.concatenate([[0.0], np.cumsum(path_m)])
        fading = 0.5 * abs(lead_deg[0]) * np.exp(-along_m / abs(ahead_m))
        heading[ordered] = wrap_deg(found.heading_deg[ordered] - lead_deg)
        sigma[ordered] = np.hypot(found.sigma_deg[ordered], fading)
    return found._replace(heading_deg=heading, sigma_deg=sigma)


def _trailing_lead(course_rad: Float64, path_m: Float64, ahead_m: float) -> Float64:
    """By how much the course leads the heading along one leg, degrees, in the order given.

    Exact for a course that is constant over a step: tan(lead/2) fades with exp(-path/ahead).
    """
    lead = np.zeros(len(course_rad))
    turns = np.asarray(np.radians(wrap_deg(np.degrees(np.diff(course_rad)))))
    first = np.searchsorted(np.cumsum(path_m), ahead_m) + 1
    length_m = float(path_m[:first].sum())
    if length_m > 0.0:
        rate = float(turns[:first].sum()) / length_m
        lead[0] = math.asin(max(-0.95, min(0.95, ahead_m * rate)))
    for k, (turn, step_m) in enumerate(zip(turns.tolist(), path_m.tolist(), strict=True)):
        # Half of the turn before the step and half after it: the middle of the step's course.
        half = math.tan((lead[k] + turn / 2.0) / 2.0) * math.exp(-step_m / ahead_m)
        lead[k + 1] = 2.0 * math.atan(half) + turn / 2.0
    return np.degrees(lead)
