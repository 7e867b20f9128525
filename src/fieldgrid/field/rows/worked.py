"""What a drive worked: the ground that its implement went over, how often, and what it left out.

The implement is a line across the vehicle, some way behind the poses of the map. A cell is worked
when that line goes over its middle while the vehicle drives forward, and worked again when it does
so after the vehicle has driven on by more than the width: before, it is the same pass, which a turn
leads over the inner side twice. Where accepted poses are too far apart nothing is known of the way.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import shapely

from fieldgrid.core import Bool, ConfigError, Float64, UInt8
from fieldgrid.field.rows.ground import fill, polygons_of
from fieldgrid.field.rows.result import Planting
from fieldgrid.geometry import MAX_GAP_NS, Datum, Feature, Lattice, Trajectory, Window
from fieldgrid.maps import Evidence, MapFile

MAX_CELLS = 100_000_000
"""Cells that are counted at once; of a larger field they are twice as large."""

LEAST_MISSED_M2 = 0.1
"""A smaller place that was left out is no strip."""


class LaneWork(NamedTuple):
    """What was worked of a lane: of the square metres of its ground between the canopies, and how
    many strips of it were missed. A block has those of its lanes together, and no lane."""

    lane: str
    block: str
    ground_m2: float
    worked_m2: float
    missed: int

    @property
    def share(self) -> float:
        """The share of its ground that was worked, 0..1."""
        return self.worked_m2 / self.ground_m2 if self.ground_m2 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Worked:
    """What a session worked, with `width_m` at `behind_m` behind its poses.

    `times_m2` are the square metres that were worked once, twice and so on, `driven_m` the way on
    which they were, and `unknown_m` the distance of accepted poses between which the way is not
    known. `lanes` are those of the planting. `areas` are the outlines of what was worked, by how
    often; `missed` those of the ground of lanes that was not, by lane, but for what is nowhere
    wider than two `sigma_m`, the median standard deviation of the poses.
    """

    datum: Datum
    session: str
    width_m: float
    behind_m: float
    sigma_m: float
    driven_m: float
    unknown_m: float
    times_m2: tuple[float, ...]
    lanes: tuple[LaneWork, ...]
    areas: tuple[tuple[int, shapely.Polygon], ...]
    missed: tuple[tuple[str, shapely.Polygon], ...]

    @property
    def worked_m2(self) -> float:
        """Square metres that were worked, each counted once."""
        return sum(self.times_m2)

    @property
    def again_m2(self) -> float:
        """Square metres of them that were worked more than once."""
        return sum(self.times_m2[1:])

    @property
    def blocks(self) -> tuple[LaneWork, ...]:
        """The lanes of each block together."""
        found: dict[str, LaneWork] = {}
        for lane in self.lanes:
            had = found.get(lane.block, LaneWork("", lane.block, 0.0, 0.0, 0))
            found[lane.block] = LaneWork(
                "", lane.block, had.ground_m2 + lane.ground_m2, had.worked_m2 + lane.worked_m2,
                had.missed + lane.missed,
            )  # fmt: skip
        return tuple(found.values())


def find_worked(
    universal: MapFile, session: str, planting: Planting, width_m: float, behind_m: float = 0.0
) -> Worked:
    """What a session of a map worked of a planting, which may have no rows, on the map's own cells.

    Raises ConfigError for a session that is not in the map, for what is no width, and where no
    accepted pose tells of driving forward; MapError where no trajectory was stored.
    """
    if not (0.05 <= width_m <= 60.0 and abs(behind_m) <= 50.0):
        raise ConfigError(
            f"An implement {width_m:g} m wide and {behind_m:g} m behind is none; give a width of "
            "0.05 to 60 m and up to 50 m behind."
        )
    universal.check_sessions([session])
    track = universal.trajectory(session)
    way = _Way.of(track, width_m, behind_m)
    if not way.is_worked.any():
        raise ConfigError(
            f"Session {session} has no accepted poses between which the vehicle drove forward, so "
            "it worked nothing."
        )
    known = track.position_sigma_m[track.accepted & np.isfinite(track.position_sigma_m)]
    sigma_m = float(np.median(known)) if len(known) else 0.0
    grounds = _grounds(planting)
    places = [*grounds, shapely.MultiPoint(way.ends_m.reshape(-1, 2))]
    corners, lattice = shapely.total_bounds(places).reshape(2, 2), Lattice(universal.cell_m)
    while (window := _cells_of(corners, lattice)).width * window.height > MAX_CELLS:
        lattice = Lattice(2.0 * lattice.cell_m)
    times, label = _times(way, lattice, window, width_m), np.zeros(window.shape, dtype=np.int32)
    evidence = Evidence(lattice, window, times)
    for number, ground in enumerate(grounds, 1):
        # Cells on an outline are filled, too.
        fill(label, evidence, ground.buffer(-0.5 * lattice.cell_m), number)

    def outlines(mask: Bool, least_m2: float = 0.0) -> list[shapely.Polygon]:
        return polygons_of(evidence, mask.view(np.uint8), least_m2)

    left_out = outlines((label > 0) & (times == 0), LEAST_MISSED_M2)
    missed = [part for part in left_out if not part.buffer(-sigma_m).is_empty]
    lane_of = [int(np.argmin(shapely.distance(grounds, part.centroid))) for part in missed]
    cell_m2 = lattice.cell_m**2
    in_all, in_worked, strips = (
        np.bincount(np.ravel(numbers), minlength=len(grounds) + 1)[1:].tolist()
        for numbers in (label, label[times > 0], np.array(lane_of, dtype=np.intp) + 1)
    )
    counts = np.bincount(times.ravel())[1:].tolist()
    return Worked(
        universal.datum, session, width_m, behind_m, sigma_m,
        float(way.step_m[way.is_worked].sum()), float(way.step_m[way.is_unknown].sum()),
        tuple(count * cell_m2 for count in counts),
        tuple(
            LaneWork(lane.id, lane.block, cells * cell_m2, worked * cell_m2, count)
            for lane, cells, worked, count in zip(
                planting.lanes, in_all, in_worked, strips, strict=True
            )
        ),
        tuple((n, part) for n in range(1, len(counts) + 1) for part in outlines(times == n)),
        tuple((planting.lanes[k].id, part) for k, part in zip(lane_of, missed, strict=True)),
    )  # fmt: skip


def _grounds(planting: Planting) -> list[shapely.Geometry]:
    """The ground of each lane between the canopies of its rows."""
    canopies = {row.id: row.line.buffer(row.half_width_m) for row in planting.rows}
    return [
        lane.area.difference(shapely.union_all([canopies[name] for name in lane.rows]))
        for lane in planting.lanes
    ]


class _Way(NamedTuple):
    """The way of an implement at the poses of a drive, metres east and north: its middle [n, 2],
    the direction of the nose, its ends [n, 2, 2]; and of what lies between two poses [n - 1] how
    long it is, whether the vehicle drives forward, and whether the way is not known."""

    middle_m: Float64
    ahead: Float64
    ends_m: Float64
    step_m: Float64
    is_worked: Bool
    is_unknown: Bool

    @classmethod
    def of(cls, track: Trajectory, width_m: float, behind_m: float) -> _Way:
        """The way of the accepted poses."""
        ok = track.accepted
        phi = np.radians(track.heading_deg[ok])
        ahead = np.column_stack([np.sin(phi), np.cos(phi)])
        middle = np.column_stack([track.east_m[ok], track.north_m[ok]]) - behind_m * ahead
        aside = 0.5 * width_m * np.column_stack([ahead[:, 1], -ahead[:, 0]])
        gear = track.gear[ok]
        is_unknown = np.diff(track.time_ns[ok]) > MAX_GAP_NS
        is_worked = ~is_unknown & (gear[:-1] + gear[1:] > 0)
        return cls(
            middle, ahead, np.stack([middle - aside, middle + aside], axis=1),
            np.hypot(*np.diff(middle, axis=0).T), is_worked, is_unknown,
        )  # fmt: skip


def _times(way: _Way, lattice: Lattice, window: Window, width_m: float) -> UInt8:
    """How often each cell of a window was worked, at most 255 times."""
    times = np.zeros(window.shape, dtype=np.uint8)
    last_m = np.full(window.shape, -np.inf, dtype=np.float32)
    driven_m = np.cumsum(way.step_m)
    for k in np.flatnonzero(way.is_worked).tolist():
        box = _cells_of(way.ends_m[k : k + 2].reshape(-1, 2), lattice)
        east_m, north_m = lattice.centres(box)
        # How far ahead of the line each middle lies, and to its right, at either pose.
        (before, right), (after, right_after) = (
            (x * ahead[0] + y * ahead[1], x * ahead[1] - y * ahead[0])
            for (east, north), ahead in zip(
                way.middle_m[k : k + 2], way.ahead[k : k + 2], strict=True
            )
            for x, y in ((east_m - east, (north_m - north)[:, None]),)
        )
        crossed = (before > 0.0) != (after > 0.0)
        share = before / np.where(crossed, before - after, 1.0)
        hit = crossed & (np.abs(right + share * (right_after - right)) <= 0.5 * width_m)
        place = window.slices_of(box)
        again = hit & (driven_m[k] - last_m[place] > width_m) & (times[place] < 255)
        times[place][again] += 1
        last_m[place][hit] = driven_m[k]
    return times


def _cells_of(points_m: Float64, lattice: Lattice) -> Window:
    """The cells of a box about points [n, 2]."""
    i, j = lattice.index(points_m[:, 0], points_m[:, 1])
    return Window(int(i.min()), int(j.min()), int(np.ptp(i)) + 1, int(np.ptp(j)) + 1)


def worked_features(worked: Worked) -> list[Feature]:
    """What was worked, by how often, and over it what was left out of lanes."""
    areas: list[tuple[str, shapely.Polygon, dict[str, Any]]]
    areas = [("worked", part, {"times": n}) for n, part in worked.areas]
    areas += [("missed", part, {"lane": lane}) for lane, part in worked.missed]
    found = []
    for number, (kind, part, about) in enumerate(areas, 1):
        properties = {
            "id": str(number), **about, "area_m2": float(part.area),
            "session": worked.session, "sigma_m": worked.sigma_m,
        }  # fmt: skip
        found.append(Feature(kind, part, properties))
    return found
