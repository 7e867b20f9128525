"""Small maps for the tests: made-up local grids at made-up poses."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from fieldgrid.geometry import Datum, GridSpec, LocalGrid, Pose, Status, Trajectory
from fieldgrid.maps import MapFile, Transfer, create_map

DATUM = Datum(39.407121234, -1.219356789, 702.417)
CELL_M = 0.1
SPEC = GridSpec(width_m=4.0, length_m=6.0, cell_m=0.1)

Frame = tuple[LocalGrid, Pose]


def grid_of(seed: int, spec: GridSpec = SPEC) -> LocalGrid:
    random = np.random.default_rng(seed)
    observed = random.random(spec.shape) < 0.7
    density = random.integers(0, 256, spec.shape, dtype=np.uint8)
    return LocalGrid(spec, np.where(observed, density, np.uint8(0)), observed)


def pose_at(
    east_m: float,
    north_m: float,
    heading_deg: float,
    *,
    time_ns: int = 0,
    status: Status = Status.OK,
    reason: str = "",
) -> Pose:
    return Pose(time_ns, east_m, north_m, 0.7, heading_deg, 0.02, 0.5, 1.5, status, reason)


def drive(
    count: int = 6, step_m: float = 3.137, heading_deg: float = 37.3, start: int = 0
) -> list[Frame]:
    """Frames along a line. The steps are odd, so that no cell centre falls on a cell edge."""
    phi = np.radians(heading_deg)
    return [
        (
            grid_of(k),
            pose_at(
                -7.0431 + k * step_m * np.sin(phi),
                4.0117 + k * step_m * np.cos(phi),
                heading_deg + 1.31 * k,
                time_ns=1_000_000_000 * k + 17,
            ),
        )
        for k in range(start, start + count)
    ]


def one_cell(east_m: float, north_m: float, density: int) -> Frame:
    """A frame in which a single cell is observed, whose centre lands at (east, north)."""
    row, column = 41, 7
    x, y = SPEC.centres_m()
    values = np.zeros(SPEC.shape, dtype=np.uint8)
    observed = np.zeros(SPEC.shape, dtype=np.bool_)
    values[row, column], observed[row, column] = density, True
    # At 90 degrees the grid's y points east and its x south.
    pose = pose_at(east_m - float(y[row]), north_m + float(x[column]), 90.0)
    return LocalGrid(SPEC, values, observed), pose


def write_map(
    path: Path,
    sessions: Sequence[Iterable[Frame]],
    *,
    cell_m: float = CELL_M,
    transfer: Transfer = Transfer.CENTRE,
    trajectory: Trajectory | None = None,
    layers: Collection[str] = (),
) -> Path:
    """A new map with sessions "0", "1", ..., whose tiles hold some layers beside the core."""
    with create_map(path, DATUM, cell_m=cell_m, transfer=transfer, layers=layers) as universal:
        for k, frames in enumerate(sessions):
            write_session(universal, str(k), frames, trajectory)
    return path


def write_session(
    universal: MapFile, name: str, frames: Iterable[Frame], trajectory: Trajectory | None = None
) -> None:
    with universal.add_session(name, trajectory=trajectory) as session:
        for grid, pose in frames:
            session.add(grid, pose)


def track(count: int = 5, datum: Datum = DATUM) -> Trajectory:
    """A trajectory with everything in it that a column may hold."""
    nan = float("nan")

    def column(*values: float) -> npt.NDArray[np.float64]:
        return np.resize(np.array(values, dtype=np.float64), count)

    return Trajectory(
        datum=datum,
        time_ns=1_600_000_000_000_000_001 + 200_000_000 * np.arange(count, dtype=np.int64),
        east_m=column(0.1, 12.3, -830.2, 7.0, 1e-9),
        north_m=column(-0.3, -45.6, 410.7, 8.0, 3.3333333333333335),
        up_m=column(0.0, -1.5, 0.25),
        heading_deg=column(80.1, -100.4, nan, 180.0),
        position_sigma_m=column(0.02, nan, 0.33),
        heading_sigma_deg=column(0.5, 0.7, nan),
        speed_mps=column(1.4, 0.0),
        gear=np.resize(np.array([1, -1, 0], dtype=np.int64), count),
        quality=np.resize(np.array([4, 5, 0, 1], dtype=np.int64), count),
        status=tuple((Status.OK, Status.REJECTED, Status.HELD)[k % 3] for k in range(count)),
        reason=tuple(("", "the implied speed is 40 m/s", "stands")[k % 3] for k in range(count)),
        heading_source="constant:80",
    )
