"""The drives of a farm: what its maps keep of them, in the farm's plane and by the farm's names."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

from fieldgrid.core import ConfigError
from fieldgrid.geometry import Bounds, Trajectory
from fieldgrid.maps.farm.content import FarmPart
from fieldgrid.maps.farm.maps import Maps
from fieldgrid.maps.file.arrays import Array
from fieldgrid.maps.file.header import MapHeader
from fieldgrid.maps.file.records import FrameRecord


class FarmDrives:
    """The part of `Farm` that tells of its sessions, each found in the map that has it."""

    path: Path
    _maps: Maps

    @property
    @abstractmethod
    def _parts(self) -> tuple[FarmPart, ...]:
        """The maps, each drive in one of them."""

    @property
    @abstractmethod
    def _header(self) -> MapHeader:
        """The plane, the own cells and the rule of the farm."""

    def _part_of(self, session: str) -> FarmPart:
        """The map that has a session; ConfigError for a name that no session has."""
        found = next((part for part in self._parts if session in part.names), None)
        if found is None:
            raise ConfigError(
                f"{self.path} has no session {session!r}; `fieldgrid farm` lists the drives of "
                "its maps."
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


def _renamed(part: FarmPart, frames: Iterable[FrameRecord]) -> Iterator[FrameRecord]:
    """Frames of a map with the names that its sessions have in the farm."""
    names = {own: name for name, own in part.names.items()}
    return (replace(one, session=names[one.session]) for one in frames)
