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
        said = self.motion
        gyro, wheels, inertial, tilt = said.gyro, said.wheels, said.inertial, said.tilt
        return FixLog(
            replace(self.fixes, time_ns=self.fixes.time_ns + offset_ns),
            self.notes,
            said._replace(
                gyro=gyro and gyro._replace(time_ns=gyro.time_ns + offset_ns),
                wheels=wheels and wheels._replace(time_ns=wheels.time_ns + offset_ns),
                inertial=inertial and inertial._replace(time_ns=inertial.time_ns + offset_ns),
                tilt=tilt and tilt._replace(time_ns=tilt.time_ns + offset_ns),
            ),
            self.moved_ns + offset_ns,
        )
