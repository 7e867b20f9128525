"""One made-up map that no mistake of an export maps onto itself, and the truth about it.

An "F" of obstacles stands on free ground, with doubtful patches, a hole, a notch and a cut corner
that nobody saw, on both sides of the datum, 742 m up. Every edge lies on a multiple of 0.25 m, so
that the truth holds at cells of 0.05 m and of 0.25 m alike. What is said here about the map comes
from rectangles and from PROJ, never from the code that exports it.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pyproj

from fieldgrid.geometry import Bounds, Datum, GridSpec, LocalGrid, Pose, Status, Trajectory
from fieldgrid.maps import create_map

DATUM = Datum(39.480412345, -1.220198765, 742.0)
CELL_M = 0.05
COARSE_M = 0.25
EXTENT = Bounds(-10.0, -7.0, 14.0, 9.0)
"""The outer edges of what was observed: 480 x 320 cells of 0.05 m."""

SPRING, SUMMER = "spring", "summer"
"""The sessions. Summer saw what lies east of `SUMMER_FROM_M`, a second time."""

SUMMER_FROM_M = 2.0
START_NS = {SPRING: 1_775_210_400_000_000_017, SUMMER: 1_781_164_800_000_000_000}

FREE, GROUND = 0, 12
STEM, TOP_ARM, MIDDLE_ARM = 220, 255, 160
DOUBT = 75
RAMP = (49, 50, 51, 52, 60, 74, 99, 100, 101, 102)
"""The densities of ten strips of 0.25 m, about the limits of free ground and of obstacles."""

DISPUTED = {SPRING: 40, SUMMER: 200}
"""What the sessions say of one patch: 120 in the mean, an obstacle in one of two."""

_STEP_NS = 200_000_000
_BLOCK_M = 4.0
_SPEC = GridSpec(width_m=_BLOCK_M, length_m=_BLOCK_M, cell_m=CELL_M)
_HEADINGS_DEG = (90.0, 0.0, -90.0, 180.0)

_Float64 = npt.NDArray[np.float64]
_Bool = npt.NDArray[np.bool_]

# Rectangles (west, south, east, north) and their densities; a later one covers earlier ones.
_PATCHES = (
    ((-10.0, -7.0, 14.0, 9.0), GROUND),
    ((-10.0, -7.0, -5.0, 9.0), FREE),
    ((-3.0, -4.0, -2.0, 6.0), STEM),
    ((-2.0, 5.0, 3.0, 6.0), TOP_ARM),
    ((-2.0, 1.0, 1.0, 2.0), MIDDLE_ARM),
    ((6.0, 0.0, 8.5, 1.5), DOUBT),
    *(((6.0 + 0.25 * k, 2.0, 6.25 + 0.25 * k, 3.25), value) for k, value in enumerate(RAMP)),
)
_DISPUTED_PATCH = (9.0, -6.0, 10.0, -5.0)
_UNKNOWN = (
    (10.0, 5.0, 14.0, 9.0),  # the notch
    (4.0, -5.0, 5.5, -3.75),  # the hole
    (-10.0, -7.0, -8.0, -4.0),  # the corner
)

F_BOXES = (
    Bounds(-3.0, -4.0, -2.0, 6.0),
    Bounds(-2.0, 5.0, 3.0, 6.0),
    Bounds(-2.0, 1.0, 1.0, 2.0),
)
"""The strokes of the F: stem, top arm, middle arm. Their union is one polygon of 18 m2."""


class Truth(NamedTuple):
    """What is true of cells: arrays of the shape of the points that were asked for.

    `density` is 0, `variance` and `persistence` are NaN where `observed` is False. `frames` counts
    the frames that saw a cell: one a session.
    """

    density: npt.NDArray[np.uint8]
    observed: _Bool
    sessions: npt.NDArray[np.int64]
    variance: _Float64
    highest: npt.NDArray[np.uint8]
    persistence: _Float64


def truth(east_m: npt.ArrayLike, north_m: npt.ArrayLike) -> Truth:
    """The truth at points, metres east and north of the datum, shapes broadcast.

    Right for cells of 0.05 m and 0.25 m when asked at their centres. In cells of 0.25 m `sessions`
    still counts sessions; frames saw each a single time as well.
    """
    east, north = np.broadcast_arrays(
        np.asarray(east_m, dtype=np.float64), np.asarray(north_m, dtype=np.float64)
    )
    by_session = {name: _seen_by(name, east, north) for name in (SPRING, SUMMER)}
    seen = np.stack([observed for _, observed in by_session.values()])
    values = np.stack([np.where(observed, value, 0.0) for value, observed in by_session.values()])
    count = seen.sum(axis=0)
    with np.errstate(invalid="ignore"):
        mean = values.sum(axis=0) / count
        variance = (values**2).sum(axis=0) / count - mean**2
        persistence = (values > 100).sum(axis=0) / count
    observed = count > 0
    return Truth(
        np.where(observed, mean, 0.0).astype(np.uint8),
        observed,
        count,
        variance,
        values.max(axis=0).astype(np.uint8),
        persistence,
    )


def cells(cell_m: float = CELL_M, bounds: Bounds = EXTENT) -> tuple[_Float64, _Float64, Truth]:
    """East of each column's centre, north of each row's, and the truth [rows from the south,
    columns from the west]."""
    width = round((bounds.east_m - bounds.west_m) / cell_m)
    height = round((bounds.north_m - bounds.south_m) / cell_m)
    east = bounds.west_m + (np.arange(width) + 0.5) * cell_m
    north = bounds.south_m + (np.arange(height) + 0.5) * cell_m
    return east, north, truth(east[None, :], north[:, None])


@cache
def probes() -> tuple[_Float64, _Float64]:
    """Points (east, north) that tell where the map lies to 1 cm: 5 mm on either side of every
    edge there is, at five places each, and 2000 points anywhere, some of them outside."""
    random = np.random.default_rng(5)
    boxes = [box for box, _ in _PATCHES] + [_DISPUTED_PATCH, *_UNKNOWN]
    east, north = [random.uniform(-12.0, 16.0, 2000)], [random.uniform(-9.0, 11.0, 2000)]
    for west_m, south_m, east_m, north_m in boxes:
        along_e = np.repeat(random.uniform(west_m + 0.01, east_m - 0.01, 5), 2)
        along_n = np.repeat(random.uniform(south_m + 0.01, north_m - 0.01, 5), 2)
        off_m = np.tile([-0.005, 0.005], 5)
        for edge in (west_m, east_m):
            east.append(edge + off_m)
            north.append(along_n)
        for edge in (south_m, north_m):
            east.append(along_e)
            north.append(edge + off_m)
    return np.concatenate(east), np.concatenate(north)


def geodetic(
    east_m: npt.ArrayLike, north_m: npt.ArrayLike, up_m: npt.ArrayLike = 0.0
) -> tuple[_Float64, _Float64, _Float64]:
    """WGS84 latitude, longitude (degrees) and ellipsoidal height of points, by PROJ."""
    east, north, up = np.broadcast_arrays(
        *(np.asarray(v, dtype=np.float64) for v in (east_m, north_m, up_m))
    )
    lon, lat, height = _proj().transform(east, north, up, direction="INVERSE")
    return np.asarray(lat), np.asarray(lon), np.asarray(height)


def enu(
    lat_deg: npt.ArrayLike, lon_deg: npt.ArrayLike, height_m: npt.ArrayLike = DATUM.height_m
) -> tuple[_Float64, _Float64, _Float64]:
    """East, north, up in metres of WGS84 positions, by PROJ."""
    lat, lon, height = np.broadcast_arrays(
        *(np.asarray(v, dtype=np.float64) for v in (lat_deg, lon_deg, height_m))
    )
    east, north, up = _proj().transform(lon, lat, height)
    return np.asarray(east), np.asarray(north), np.asarray(up)


@cache
def track(session: str) -> Trajectory:
    """The trajectory of a session: spring turns right and reverses, summer has a bad fix."""
    return _spring_track() if session == SPRING else _summer_track()


@cache
def frame_poses(session: str) -> tuple[Pose, ...]:
    """The poses of a session's frames, each of a block of 4 x 4 m; the last one is rejected."""
    corners = [
        (west, south)
        for south in np.arange(EXTENT.south_m, EXTENT.north_m, _BLOCK_M)
        for west in np.arange(EXTENT.west_m, EXTENT.east_m, _BLOCK_M)
        if session == SPRING or west >= SUMMER_FROM_M
    ]
    poses = [_pose_over(*corner, k, START_NS[session]) for k, corner in enumerate(corners)]
    lost = poses[0]
    time_ns = START_NS[session] + 400_000_000 * len(poses)
    return (
        *poses,
        Pose(time_ns, lost.east_m, lost.north_m, 0.3, lost.heading_deg, 0.4, 9.0, 1.0,
             Status.REJECTED, "the heading is known to 9 degrees only"),
    )  # fmt: skip


def write_asymmetric_map(path: Path) -> Path:
    """Write the map, of both sessions and their trajectories, through the public way."""
    with create_map(path, DATUM, cell_m=CELL_M) as universal:
        for name in (SPRING, SUMMER):
            with universal.add_session(name, trajectory=track(name), source="made up") as session:
                for pose in frame_poses(name):
                    session.add(_grid_at(name, pose), pose)
    return path


def _seen_by(session: str, east: _Float64, north: _Float64) -> tuple[_Float64, _Bool]:
    value = np.zeros(east.shape)
    observed = _inside(EXTENT, east, north)
    for box, density in (*_PATCHES, (_DISPUTED_PATCH, DISPUTED[session])):
        value[_inside(box, east, north)] = density
    for box in _UNKNOWN:
        observed &= ~_inside(box, east, north)
    if session == SUMMER:
        observed &= east >= SUMMER_FROM_M
    return value, observed


def _inside(box: tuple[float, float, float, float], east: _Float64, north: _Float64) -> _Bool:
    west, south, east_end, north_end = box
    return (east >= west) & (east < east_end) & (north >= south) & (north < north_end)


def _pose_over(west: float, south: float, k: int, start_ns: int) -> Pose:
    """The pose of a grid that covers the block, by each of four headings in turn. It is unsure by a
    metre, so that no ground counts as driven over."""
    heading = _HEADINGS_DEG[k % 4]
    half = _BLOCK_M / 2.0
    east, north = {
        90.0: (west, south + half),
        0.0: (west + half, south),
        -90.0: (west + _BLOCK_M, south + half),
        180.0: (west + half, south + _BLOCK_M),
    }[heading]
    time_ns = start_ns + 400_000_000 * k
    return Pose(time_ns, float(east), float(north), 0.3, heading, 1.0, 0.5, 1.2)


def _grid_at(session: str, pose: Pose) -> LocalGrid:
    """The local grid that sees the truth from a pose, by Eq. 3 written out for four headings."""
    x, y = _SPEC.centres_m()
    x, y = x[None, :], y[:, None]
    east, north = {
        0.0: (x + 0 * y, y + 0 * x),
        90.0: (y + 0 * x, -x + 0 * y),
        180.0: (-x + 0 * y, -y + 0 * x),
        -90.0: (-y + 0 * x, x + 0 * y),
    }[pose.heading_deg]
    value, observed = _seen_by(session, east + pose.east_m, north + pose.north_m)
    return LocalGrid(_SPEC, np.where(observed, value, 0).astype(np.uint8), observed)


def _spring_track() -> Trajectory:
    """Clockwise on a circle of 5 m about (1, -1.5), then back in reverse by 40 degrees."""
    forward = np.linspace(-100.0, 80.0, 61)
    back = np.linspace(77.0, 40.0, 20)
    bearing = np.concatenate([forward, back])
    angle = np.radians(bearing)
    gear = np.concatenate([np.ones(61), -np.ones(20)])
    heading = (bearing + 90.0 + 180.0) % 360.0 - 180.0
    return _trajectory(SPRING, 1.0 + 5.0 * np.sin(angle), -1.5 + 5.0 * np.cos(angle), heading, gear)


def _summer_track() -> Trajectory:
    """Straight at -30 degrees from (12, -6); it stands at first, and the tenth fix is 40 m off."""
    way = np.concatenate([[0.0], 0.25 * np.arange(40)])
    east, north = 12.0 - 0.5 * way, -6.0 + np.sqrt(0.75) * way
    east[10] += 40.0
    gear = np.concatenate([[0], np.ones(40)])
    return _trajectory(
        SUMMER, east, north, np.full(41, -30.0), gear,
        {0: (Status.HELD, "stands"), 10: (Status.REJECTED, "the implied speed is 200 m/s")},
    )  # fmt: skip


def _trajectory(
    session: str,
    east: _Float64,
    north: _Float64,
    heading: _Float64,
    gear: npt.NDArray[np.float64],
    verdicts: dict[int, tuple[Status, str]] | None = None,
) -> Trajectory:
    n = len(east)
    verdict = [(verdicts or {}).get(k, (Status.OK, "")) for k in range(n)]
    return Trajectory(
        datum=DATUM,
        time_ns=START_NS[session] + _STEP_NS * np.arange(n, dtype=np.int64),
        east_m=east,
        north_m=north,
        up_m=0.3 + 0.01 * east,
        heading_deg=heading,
        position_sigma_m=np.full(n, 0.02),
        heading_sigma_deg=np.full(n, 0.5),
        speed_mps=1.25 * np.abs(gear),
        gear=gear.astype(np.int64),
        quality=np.where(np.arange(n) % 5 == 3, 5, 4).astype(np.int64),
        status=tuple(status for status, _ in verdict),
        reason=tuple(reason for _, reason in verdict),
        heading_source="smooth",
    )


@cache
def _proj() -> pyproj.Transformer:
    return pyproj.Transformer.from_pipeline(
        "+proj=pipeline +step +proj=unitconvert +xy_in=deg +xy_out=rad +step +proj=cart "
        f"+ellps=WGS84 +step +proj=topocentric +ellps=WGS84 +lat_0={DATUM.lat_deg!r} "
        f"+lon_0={DATUM.lon_deg!r} +h_0={DATUM.height_m!r}"
    )
