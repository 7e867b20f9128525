"""Several maps read as if they were one."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import cached_property, reduce
from pathlib import Path
from typing import NamedTuple

from fieldgrid.core import Closing, ConfigError, DatumError, MapError, quoted
from fieldgrid.geometry import MAX_DISTANCE_M, Bounds, Datum, Trajectory
from fieldgrid.maps.farm.catalogue import FarmBlock, find_blocks
from fieldgrid.maps.farm.content import FarmContent, FarmPart, moved_bounds
from fieldgrid.maps.farm.maps import Maps
from fieldgrid.maps.file.arrays import Array
from fieldgrid.maps.file.header import MapHeader
from fieldgrid.maps.file.map_file import MapFile
from fieldgrid.maps.file.records import FrameRecord, SessionInfo
from fieldgrid.maps.layers.registry import ALL_LAYERS, kept_groups
from fieldgrid.maps.vector.marks import Mark
from fieldgrid.maps.views.readable import DrivenMap
from fieldgrid.maps.writing.merge import free_name, marks_together
from fieldgrid.maps.writing.redatum import Redatum
from fieldgrid.maps.writing.twins import REMEDY, Twin, twin_of

_EARTH_RADIUS_M = 6.37e6
_REACH_M = 15.0
"""How far from the vehicle the ground is seen."""


class RebasedMap(NamedTuple):
    """A map that is read in the plane of another datum, metres: how far apart the two are, and by
    how much its ground may be too high or low. Places are exact: they go through WGS84."""

    block: FarmBlock
    distance_m: float
    height_error_m: float


class Farm(DrivenMap, Closing):
    """The maps of a folder. Use it with `with`, or close it; one thread at a time.

    `blocks` lists them, those that cannot be read included. `read`, `read_blocks` and
    `sessions` are those of a map with all their sessions: what `merge_maps` would make of them, bit
    for bit, without making it. So `Costmap.from_map` and `export_map` take a farm as they take a
    map. `query`, `frames`, `trajectory` and `session_inputs` are those of a map, too, in the plane
    of the farm, and `map_of` says which map has a session. Only maps that a window touches are
    opened.

    Maps of one datum share their plane; with a `datum` others are laid into its plane, as `moved`
    says. The cells are the largest that a map has, by the rule of the first map; maps of other
    cells, rules or datums are folded anew from their frames. A drive that two maps have counts
    once. With `verify` every map is verified by `jobs` threads. ConfigError for a folder without
    maps.
    """

    def __init__(
        self,
        folder: str | Path,
        *,
        datum: Datum | None = None,
        verify: bool = False,
        jobs: int | None = None,
    ) -> None:
        self.path = Path(folder)
        self.blocks = tuple(find_blocks(self.path, verify=verify, jobs=jobs))
        self._given = datum
        self._maps = Maps()

    def close(self) -> None:
        """Close the maps that are open."""
        self._maps.close()

    @property
    def problems(self) -> tuple[FarmBlock, ...]:
        """What lies in the folder and cannot be read: views leave it out."""
        return tuple(block for block in self.blocks if block.problem)

    @property
    def datum(self) -> Datum:
        """The origin of the plane. DatumError when the maps have several and none was given."""
        return self._header.datum

    @property
    def cell_m(self) -> float:
        """Side of the own cells in metres."""
        return self._header.lattice.cell_m

    @property
    def bounds(self) -> Bounds:
        """The extent of the observed cells in metres; of maps of other datums, up to a metre."""
        return reduce(Bounds.union, (part.bounds for part in self._parts))

    @property
    def moved(self) -> tuple[RebasedMap, ...]:
        """The maps of other datums, and what that does to them."""
        found = []
        for part in self._parts:
            if part.moved is not None:
                east, north, _ = part.moved.places(0.0, 0.0, 0.0)
                distance_m = math.hypot(float(east), float(north))
                error_m = _REACH_M * distance_m / _EARTH_RADIUS_M
                found.append(RebasedMap(part.block, distance_m, error_m))
        return tuple(found)

    def sessions(self) -> list[SessionInfo]:
        """The active sessions of all maps. One whose name another map has too is called
        `NAME (MAP)`."""
        found = []
        for part in self._parts:
            own = {info.name: info for info in part.block.sessions}
            found += [replace(own[was], name=name) for name, was in part.names.items()]
        return found

    def map_of(self, session: str) -> FarmBlock:
        """The map that has a session of `sessions`; ConfigError for another."""
        return self._part_of(session).block

    def extents(self) -> dict[str, Bounds]:
        """The extents of the maps that are read, by the names of their blocks, in metres of the
        farm's plane."""
        return {part.block.name: part.bounds for part in self._parts}

    def marks(self) -> tuple[Mark, ...]:
        """The marks of all maps; what two of them have counts once."""
        return self._marks

    def check_sessions(self, names: Collection[str]) -> None:
        """As `MapFile.check_sessions`."""
        for name in names:
            self._part_of(name)

    @contextmanager
    def content(self) -> Iterator[FarmContent]:
        """As `MapFile.content`, but that each map is held in its state only while it is read."""
        yield FarmContent(self._maps, self._parts, self._header, self._marks)

    def _part_of(self, session: str) -> FarmPart:
        """The map that has a session; ConfigError for a name that no session has."""
        found = next((part for part in self._parts if session in part.names), None)
        if found is None:
            raise ConfigError(
                f"{self.path} has no session {quoted(session)}; `fieldgrid farm` lists the drives "
                "of its maps."
            )
        return found

    def trajectory(self, session: str) -> Trajectory:
        """The trajectory of a session as it is placed; MapError where none was stored."""
        part = self._part_of(session)
        with self._maps.reading(part.block) as opened:
            track = opened.universal.trajectory(part.names[session])
        return track if part.moved is None else part.moved.trajectory(track)

    def frames(self, session: str) -> Iterator[FrameRecord]:
        """The frames of a session, rejected ones included, in time order, without their grids."""
        part = self._part_of(session)
        with self._maps.reading(part.block) as opened:
            found = list(opened.universal.frames(part.names[session]))
        moved = part.moved
        if moved is not None:
            found = [
                replace(one, pose=moved.pose(one.pose), driven=moved.pose(one.driven))
                for one in found
            ]
        return _renamed(part, found)

    def session_inputs(self, session: str) -> dict[str, Array]:
        """As `MapFile.session_inputs`."""
        part = self._part_of(session)
        with self._maps.reading(part.block) as opened:
            return opened.universal.session_inputs(part.names[session])

    @contextmanager
    def frames_near(self, near: Bounds) -> Iterator[list[FrameRecord]]:
        """As `MapFile.frames_near`."""
        frames: list[FrameRecord] = []
        with ExitStack() as open_maps:  # the grids are read while it lasts
            for part in self._parts:
                if part.names and part.bounds.overlaps(near):
                    opened = open_maps.enter_context(self._maps.reading(part.block))
                    evidence = part.content(opened.content).evidence
                    found = evidence.accepted(near, tuple(part.names.values()), None)
                    frames += _renamed(part, found)
            yield sorted(frames, key=lambda one: (one.pose.time_ns, one.session, one.frame_id))

    @cached_property
    def _usable(self) -> list[tuple[FarmBlock, MapHeader, Bounds]]:
        """The maps that can be read and have seen anything; MapError when there is none."""
        found = [(b, b.header, b.bounds) for b in self.blocks if b.header and b.bounds]
        if not found:
            why = self.problems[0].problem if self.problems else "they have no observed cell."
            raise MapError(f"No map of {self.path} can be read: {why}")
        return found

    @cached_property
    def _header(self) -> MapHeader:
        (first, header, _), *others = self._usable
        datum = self._given or header.datum
        for other, found, _ in others:
            if self._given is None and not found.is_datum(datum):
                raise DatumError(
                    f"{other.path} has the datum {found.datum.described()} and {first.path} has "
                    f"{datum.described()}; lay all maps of {self.path} into one plane with "
                    f"--datum-from {first.path}, or from Python with Farm(folder, datum=...)."
                )
        lattice = max((found.lattice for _, found, _ in self._usable), key=lambda one: one.cell_m)
        return MapHeader(datum, lattice, header.transfer, kept_groups([ALL_LAYERS]))

    @cached_property
    def _parts(self) -> tuple[FarmPart, ...]:
        """The maps, each drive in one of them."""
        parts: list[FarmPart] = []
        names: set[str] = set()
        for block, header, bounds in self._usable:
            moved = None
            if not self._header.is_datum(header.datum):
                moved = Redatum(header.datum, self.datum)
                bounds = moved_bounds(moved, bounds)
                farthest_m = max(map(abs, bounds))
                if farthest_m > MAX_DISTANCE_M:
                    raise DatumError(
                        f"{block.path} lies {farthest_m / 1000:.0f} km from the datum, and a plane "
                        f"reaches {MAX_DISTANCE_M / 1000:.0f} km; give a datum between the maps, "
                        "or make a farm of its own of those far away."
                    )
            own: dict[str, str] = {}
            for info in block.sessions:
                if not any(self._is_twin(part, (block, moved), info) for part in parts):
                    own[free_name(info.name, block.name, {*names, *own})] = info.name
            names |= own.keys()
            parts.append(FarmPart(block, bounds, own, moved, self._header))
        return tuple(parts)

    def _is_twin(
        self, part: FarmPart, other: tuple[FarmBlock, Redatum | None], info: SessionInfo
    ) -> bool:
        """Whether a part has the drive of another map, too; ConfigError when it lies elsewhere."""
        block, moved = other
        for own in part.block.sessions:
            if own.name not in part.names.values():
                continue
            if part.moved is None and moved is None:
                if own.digest != info.digest:
                    continue
            elif (own.first_time_ns, own.frames) != (info.first_time_ns, info.frames):
                continue
            one, two = self._twin(part.block, own, part.moved), self._twin(block, info, moved)
            if not one.is_drive(two):
                continue
            if (why := two.contradiction(one)) is not None:
                raise ConfigError(
                    f"Session {quoted(info.name)} of {block.path} is the same drive as "
                    f"{quoted(own.name)} of {part.block.path}, but it {why}; {REMEDY}."
                )
            return True
        return False

    def _twin(self, block: FarmBlock, info: SessionInfo, moved: Redatum | None) -> Twin:
        with self._maps.reading(block) as opened:
            return twin_of(opened.universal, info, moved)

    @cached_property
    def _marks(self) -> tuple[Mark, ...]:
        def maps() -> Iterator[MapFile]:
            for part in self._parts:
                if part.block.has_marks:
                    with self._maps.reading(part.block) as opened:
                        yield opened.universal

        found = marks_together(maps(), self.datum)
        return tuple(mark._replace(id=number) for number, mark in enumerate(found, 1))


def _renamed(part: FarmPart, frames: Iterable[FrameRecord]) -> Iterator[FrameRecord]:
    """Frames of a map with the names that its sessions have in the farm."""
    names = {own: name for name, own in part.names.items()}
    return (replace(one, session=names[one.session]) for one in frames)
