"""A drive in the plane of another datum, from what the map keeps of it: no images are needed.

Positions go through WGS84, which is exact, and headings turn by the convergence: the angle between
the two norths where the vehicle was. What a frame saw keeps its bits and is laid down at the new
pose. Its cells stay vertical by the old plane: planes 1 km apart lean by 0.16 mrad to each other,
so that the ground 15 m from the vehicle is 2 mm too high or low for each km between the datums.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from fieldgrid.core import Float64
from fieldgrid.geometry import Datum, Pose, Trajectory, wrap_deg
from fieldgrid.maps.file.metadata import SessionMetadata
from fieldgrid.maps.writing.corrections import Wander
from fieldgrid.maps.writing.transform import Transform, transform_of


class Redatum:
    """From the plane of one datum to that of another."""

    def __init__(self, old: Datum, new: Datum) -> None:
        self.old, self.new = old, new

    def places(
        self, east_m: npt.ArrayLike, north_m: npt.ArrayLike, up_m: npt.ArrayLike
    ) -> tuple[Float64, Float64, Float64]:
        """Metres east, north and up of the new datum; NaN where a place is not known. What has no
        height is taken as on the old plane, and gets none."""
        known = np.isfinite(np.asarray(up_m, np.float64))
        height_m = np.where(known, up_m, 0.0)
        east, north, up = self.new.to_enu(*self.old.to_geodetic(east_m, north_m, height_m))
        return east, north, np.where(known, up, np.nan)

    def turn_deg(self, east_m: npt.ArrayLike, north_m: npt.ArrayLike) -> Float64:
        """What headings turn by at places of the old plane: the heading of the old north."""
        east, north, _ = self.places(east_m, north_m, 0.0)
        ahead_east, ahead_north, _ = self.places(east_m, np.asarray(north_m) + 1.0, 0.0)
        return np.asarray(np.degrees(np.arctan2(ahead_east - east, ahead_north - north)))

    def pose(self, pose: Pose) -> Pose:
        """A pose as driven."""
        east_m, north_m, up_m = self.places(pose.east_m, pose.north_m, pose.up_m)
        heading = wrap_deg(pose.heading_deg + self.turn_deg(pose.east_m, pose.north_m))
        return replace(
            pose,
            east_m=float(east_m),
            north_m=float(north_m),
            up_m=float(up_m),
            heading_deg=float(heading),
        )

    def trajectory(self, track: Trajectory) -> Trajectory:
        """A trajectory as driven."""
        east_m, north_m, up_m = self.places(track.east_m, track.north_m, track.up_m)
        heading = wrap_deg(track.heading_deg + self.turn_deg(track.east_m, track.north_m))
        return replace(
            track, datum=self.new, east_m=east_m, north_m=north_m, up_m=up_m, heading_deg=heading
        )

    def transform(self, given: Transform, near: Pose) -> Transform:
        """A shift and turn of a drive that has a pose as driven."""
        if given.is_identity and given.aligned is None:
            return given
        pivot = self.places(given.pivot_east_m, given.pivot_north_m, np.nan_to_num(near.up_m))
        phi = np.radians(float(self.turn_deg(near.east_m, near.north_m)))

        def turned(east_m: npt.ArrayLike, north_m: npt.ArrayLike) -> tuple[Float64, Float64]:
            east, north = np.asarray(east_m), np.asarray(north_m)
            return (
                east * np.cos(phi) + north * np.sin(phi),
                north * np.cos(phi) - east * np.sin(phi),
            )

        east, north = turned(given.shift_east_m, given.shift_north_m)
        wander = given.wander
        if wander is not None:
            wander_east, wander_north = turned(wander.east_m, wander.north_m)
            wander = Wander(
                wander.time_ns, tuple(wander_east.tolist()), tuple(wander_north.tolist())
            )
        aligned = given.aligned
        if aligned is not None:
            before = self.transform(transform_of(aligned.before), near)
            aligned = replace(aligned, before=before.to_text())
        return replace(
            given,
            shift_east_m=float(east),
            shift_north_m=float(north),
            pivot_east_m=float(pivot[0]),
            pivot_north_m=float(pivot[1]),
            wander=wander,
            aligned=aligned,
        )

    def metadata(self, given: SessionMetadata, near: Pose) -> SessionMetadata:
        """What is kept beside its frames of a session that has a pose as driven; its inputs are
        absolute."""
        track = given.trajectory
        return given._replace(
            trajectory=None if track is None else self.trajectory(track),
            transform=self.transform(given.transform, near),
        )
