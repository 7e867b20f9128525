"""What the drive would cover, and how fine the cells are that it can support."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from fieldgrid.core import BuildSettings, Finding, info, warning
from fieldgrid.geometry import GridSpec, Pose, Rig, Status, StereoCamera, Trajectory
from fieldgrid.maps import to_universal
from fieldgrid.perception import reliable_range_m
from fieldgrid.recordings import Recording

COUNT_CELL_M = 0.5
"""The covered area is counted in cells of this size."""

MOST_PLACED = 2_000
"""Number of frames that are placed at most: of a longer drive every n-th frame is, so that the area
is a little too small."""

CELLS_M = (0.05, 0.1, 0.2, 0.25, 0.5, 1.0, 2.0, 5.0)

HOLE_SHARE = 0.05
"""More of the steps between frames than this that are too long are worth a word."""


class ExpectedMap(NamedTuple):
    """The expected map. `area_m2` is that of the grids of frames with a pose, as far as points
    enter; `spacing_m` the median way between such frames; `grid_m` how far along the way one grid
    reaches, from where the ground comes into view; `holes_share` the share of steps longer than
    that. The rest are 1-sigma errors of a cell at the far end, and the cell they support.
    """

    frames: int
    area_m2: float
    spacing_m: float | None
    grid_m: float
    holes_share: float
    position_sigma_m: float
    heading_error_m: float
    range_error_m: float | None
    cell_m: float | None


def coverage(recording: Recording, settings: BuildSettings, trajectory: Trajectory) -> ExpectedMap:
    """What the grids of a recording would cover, one of whose frames has a pose at least."""
    rig, spec = recording.rig, GridSpec.of(settings.grid)
    reach_m = reliable_range_m(rig, spec, settings.stereo, settings.density)
    poses = map(trajectory.at, recording.image_times_ns().tolist())
    used = [pose for pose in poses if pose.status is Status.OK]
    near_m = min(nearest_m(rig), reach_m)
    ways_m = np.hypot(*np.diff([(pose.east_m, pose.north_m) for pose in used], axis=0).T)
    grid_m = reach_m - near_m
    position_m = float(np.median([pose.position_sigma_m for pose in used]))
    heading_m = reach_m * math.radians(float(np.median([p.heading_sigma_deg for p in used])))
    range_m = None
    if isinstance(rig.sensor, StereoCamera):
        range_m = float(rig.sensor.range_sigma_m(reach_m, settings.stereo.disparity_sigma_px))
    off_m = math.hypot(position_m, heading_m, range_m or 0.0)
    return ExpectedMap(
        frames=len(used),
        area_m2=_area_m2(used, spec.width_m, near_m, reach_m),
        spacing_m=float(np.median(ways_m)) if len(ways_m) else None,
        grid_m=grid_m,
        holes_share=float((ways_m > grid_m).mean()) if len(ways_m) else 0.0,
        position_sigma_m=position_m,
        heading_error_m=heading_m,
        range_error_m=range_m,
        cell_m=next((cell for cell in CELLS_M if cell >= off_m), None),
    )


def nearest_m(rig: Rig) -> float:
    """Where the ground comes into view ahead of the grid origin, metres: 0 for all-round views."""
    camera = rig.sensor
    if not isinstance(camera, StereoCamera):
        return 0.0
    below = math.atan((camera.height_px - camera.cy_px) / camera.focal_px)
    down = math.radians(rig.mount.tilt_deg) + below
    return rig.mount.height_m / math.tan(down) if 0.0 < down < math.pi / 2.0 else 0.0


def coverage_findings(found: ExpectedMap, settings: BuildSettings) -> Iterator[Finding]:
    """Holes between grids, and cells finer than the data, a warning where somebody chose them."""
    cell_m = settings.universal_cell_m
    if found.grid_m <= 0.0:
        yield warning(
            "nothing-in-view",
            "With its height and tilt, the camera sees the ground only beyond the largest range of "
            "the points used.",
            "Check height and tilt in mounting.json; `fieldgrid mount` measures them.",
        )
    elif found.holes_share > HOLE_SHARE:
        yield warning(
            "holes",
            f"{100.0 * found.holes_share:.0f} % of the steps between usable frames are longer than "
            f"the {found.grid_m:.1f} m of path that a local grid covers.",
            "The map has holes there; record more frames, or drive more slowly.",
        )
    if found.cell_m is None or found.cell_m > cell_m:
        most, remedy = "coarser than 5 m", "Use better fixes."
        if found.cell_m is not None:
            most = f"{found.cell_m:g} m"
            remedy = f"For planning read the map with --cell {found.cell_m:g}."
        yield (info if settings.map.cell_m is None else warning)(
            "cell-size",
            f"At the far end a cell is off by {found.position_sigma_m:.2f} m for the position, "
            f"{found.heading_error_m:.2f} m for the heading"
            + (f", {found.range_error_m:.2f} m for the range" if found.range_error_m else "")
            + f", 1-sigma: that supports cells of {most}, and they will be {cell_m:g} m.",
            remedy,
        )


def _area_m2(placed: Sequence[Pose], width_m: float, near_m: float, reach_m: float) -> float:
    """The union of the parts of local grids that points enter."""
    every = max(1, math.ceil(len(placed) / MOST_PLACED))
    across = np.arange(-width_m / 2.0, width_m / 2.0, COUNT_CELL_M / 2.0)
    ahead = np.arange(near_m, reach_m, COUNT_CELL_M / 2.0)
    x, y = (grid.ravel() for grid in np.meshgrid(across, ahead))
    inside = np.hypot(x, y) <= reach_m
    found = []
    for pose in placed[::every]:
        at_m = np.stack(to_universal(x[inside], y[inside], pose))
        column, row = np.floor(at_m / COUNT_CELL_M).astype(np.int64)
        found.append(np.unique((column << 32) + row))
    return len(np.unique(np.concatenate(found))) * COUNT_CELL_M**2
