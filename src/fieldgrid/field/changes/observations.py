"""What one frame observes of cells: an obstacle, or free ground.

A *look* of a frame at a cell is an obstacle where a local cell above 100 lands in it, and free
where only local cells up to 50 do. Values between are unsure and ignored. A free look is *hidden*,
and also ignored, if an obstacle is in the line of sight shortly before the cell: a camera that
looks at ground below a plant does not see what is above that ground. So the far face of a row, seen
from its other side, is not new.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from fieldgrid.core import (
    Bool,
    ConfigError,
    FieldgridError,
    Float32,
    quoted,
)
from fieldgrid.field.changes.relative_sigmas import RelativeSigma
from fieldgrid.geometry import (
    FREE_UP_TO,
    OBSTACLE_ABOVE,
    Lattice,
    Rig,
    StereoCamera,
    Window,
)
from fieldgrid.maps import (
    FrameRecord,
    SessionInfo,
    Transfer,
    footprint,
    hidden,
    land,
    sight_lines,
)

APART_M = 0.5
"""Frames from one stretch of the path of this length count as one look together."""


class Observation(NamedTuple):
    """What a frame observes of the cells of `window`, arrays [rows north, columns east].

    `stands` is where an obstacle or something unsure is seen, `observed` where anything is, hidden
    ground too. `pose_m2` is the variance of the
    place along one axis by the sigma of position and heading, `range_m2` that by the sensor's
    range.
    """

    window: Window
    obstacle: Bool
    free: Bool
    stands: Bool
    observed: Bool
    pose_m2: Float32
    range_m2: Float32


class FrameObserver(NamedTuple):
    """A frame with the weight of its look (1 over the frames of its stretch of the path), and the
    growth of its sensor's range error: sigma = `range_sigma_1pm` · range²."""

    frame: FrameRecord
    reach: Window
    weight: float
    range_sigma_1pm: float
    position_sigma_m: float
    heading_sigma_deg: float

    def observe(self, lattice: Lattice, window: Window) -> Observation | None:
        """What the frame says of the cells of a window; None when it does not reach there."""
        place = self.reach.intersect(window)
        if place is None:
            return None
        pose, grid = self.frame.pose, self.frame.grid()
        cell = land(grid, pose, lattice, place, Transfer.CENTRE).cell
        hit = cell >= 0
        at, size = cell[hit], place.width * place.height
        density = grid.density[hit]

        def where(chosen: Bool) -> Bool:
            flags = np.zeros(size, dtype=np.bool_)
            flags[at[chosen]] = True
            return flags.reshape(place.shape)

        obstacle, stands = where(density > OBSTACLE_ABOVE), where(density > FREE_UP_TO)
        free = where((density <= FREE_UP_TO) & ~hidden(grid)[hit]) & ~stands
        observed = where(np.ones(density.shape, dtype=np.bool_))
        range_m = np.zeros(size, dtype=np.float32)
        range_m[at] = sight_lines(grid.spec).range_m[hit]
        range_m = range_m.reshape(place.shape)
        heading = math.radians(self.heading_sigma_deg)
        return Observation(
            place,
            obstacle,
            free,
            stands,
            observed,
            np.square(range_m * np.float32(heading)) + np.float32(self.position_sigma_m**2),
            np.square(np.square(range_m) * np.float32(self.range_sigma_1pm)),
        )


def observers(
    frames: Iterable[FrameRecord],
    info: SessionInfo,
    lattice: Lattice,
    windows: Sequence[Window],
    position_sigma_m: float | None,
    beside: RelativeSigma | None = None,
) -> list[FrameObserver]:
    """The accepted frames of a session that reach into any of the windows, in time order.

    Positions have the error `beside` the drives on the other side, where there is one.
    Raises ConfigError for a frame without sigma where `position_sigma_m` gives none.
    """
    range_sigma_1pm = _range_sigma_1pm(info.config)
    found, stretches = list[tuple[int, FrameObserver]](), Counter[int]()
    along_m, last = 0.0, None
    for frame in frames:
        if not frame.accepted:
            continue
        pose = frame.pose
        if last is not None:
            along_m += math.hypot(pose.east_m - last.east_m, pose.north_m - last.north_m)
        last = pose
        stretch = math.floor(along_m / APART_M)
        stretches[stretch] += 1
        reach = footprint(frame.spec, pose, lattice)
        if all(reach.intersect(window) is None for window in windows):
            continue
        sigmas = pose.position_sigma_m, pose.heading_sigma_deg
        if position_sigma_m is not None:
            known_deg = pose.heading_sigma_deg if math.isfinite(pose.heading_sigma_deg) else 0.0
            sigmas = position_sigma_m, known_deg
        if not all(map(math.isfinite, sigmas)):
            raise ConfigError(
                f"Frame {quoted(frame.frame_id)} of session {quoted(info.name)} does not say how "
                "sure its pose is, so an edge that was seen elsewhere cannot be told from a "
                "change; estimate its poses again with `fieldgrid build --repose`, or give "
                "--position-sigma."
            )
        if beside is not None:
            sigmas = beside.of(sigmas[0]), sigmas[1]
        found.append((stretch, FrameObserver(frame, reach, 1.0, range_sigma_1pm, *sigmas)))
    return [one._replace(weight=1.0 / stretches[stretch]) for stretch, one in found]


def _range_sigma_1pm(config: Mapping[str, Any]) -> float:
    """sigma_d / (f·b) of a session by a stereo pair; 0 where the error of ranges is not known."""
    try:
        sensor = Rig.from_dict(config["rig"]).sensor
        sigma_px = config["settings"]["stereo"]["disparity_sigma_px"]
    except (KeyError, TypeError, FieldgridError):
        return 0.0
    if not isinstance(sensor, StereoCamera) or not isinstance(sigma_px, int | float):
        return 0.0
    return float(sensor.range_sigma_m(1.0, sigma_px))
