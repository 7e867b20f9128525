"""A GNSS log as it comes out of a file: fixes, what moves the vehicle, and remarks."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from fieldgrid.geometry import FixColumns, Motion


class FixLog(NamedTuple):
    """The fixes of a log in its order, remarks on it, and the motion that it also holds; its
    stamps are moved by `moved_ns` against those that it was written with."""

    fixes: FixColumns
    notes: tuple[str, ...] = ()
    motion: Motion = Motion()

    moved_ns: int = 0

    def moved(self, offset_ns: int) -> FixLog:
        """The log with all its stamps moved by `offset_ns`, which `moved_ns` keeps."""
        parts = {
            name: part._replace(time_ns=part.time_ns + offset_ns)
            for name, part in self.motion._asdict().items()
            if part is not None
        }
        return FixLog(
            replace(self.fixes, time_ns=self.fixes.time_ns + offset_ns),
            self.notes,
            Motion(**parts),
            self.moved_ns + offset_ns,
        )
