"""Truth folders: obstacle cells, how often each could be seen, and poses by frame."""

from __future__ import annotations

import csv
import math
import tokenize
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from fieldgrid.core import (
    MAX_BYTES,
    AnyArray,
    Bool,
    Int32,
    LimitError,
    TruthError,
    bounded_lines,
    counted_rows,
    file_bytes,
    parse_json,
    shortened,
)
from fieldgrid.field.evaluation.terrain import TrueGround
from fieldgrid.geometry import Datum, Lattice, Window

_OBSTACLES = "obstacle_raster_5cm.npz"
_GROUND = "ground_dtm_25cm.npz"
_MAX_TRUTH_CELLS = 100_000_000
_MAX_TRUTH_BYTES = 4 * _MAX_TRUTH_CELLS + 4096  # int32, and what stands before them


@dataclass(frozen=True, slots=True)
class TruthPose:
    """Where the middle of the stereo baseline really was, and what was being driven.

    `roll_deg` is positive with the right side down, `pitch_deg` with the nose up; both NaN where
    the truth does not have them.
    """

    time_ns: int
    east_m: float
    north_m: float
    heading_deg: float
    direction: str
    segment: str
    roll_deg: float = math.nan
    pitch_deg: float = math.nan

    @property
    def forward_on_row(self) -> bool:
        """Driven forward along a lane between rows."""
        return self.segment.startswith("lane") and self.direction == "forward"


@dataclass(frozen=True, slots=True)
class Truth:
    """A truth folder: obstacle cells, how often each could be seen, poses by frame, and the ground
    where the folder has it."""

    lattice: Lattice
    window: Window
    occupied: Bool
    obstacle_pixels: Int32
    poses: tuple[TruthPose, ...]
    datum: Datum | None
    ground: TrueGround | None = None


def read_truth(folder: str | Path) -> Truth:
    """Read a truth folder, or that of a drive which has one as `truth/`; every problem with it is a
    TruthError that names the file."""
    folder = Path(folder)
    if not (folder / _OBSTACLES).exists() and (folder / "truth").is_dir():
        folder = folder / "truth"
    if not folder.is_dir():
        raise TruthError(f"There is no truth folder {folder}; give the folder with the rasters.")
    obstacles = _read_npz(folder / _OBSTACLES, ("occupied", "east0", "north0", "cell"))
    observable = _read_npz(folder / "observable_raster_5cm.npz", ("obstacle_pixels",))
    lattice = Lattice(float(obstacles["cell"]))
    occupied = obstacles["occupied"].astype(bool)
    pixels = observable["obstacle_pixels"].astype(np.int32)
    if occupied.ndim != 2 or occupied.shape != pixels.shape or occupied.size > _MAX_TRUTH_CELLS:
        raise TruthError(
            f"The obstacle raster {occupied.shape} and the observable raster {pixels.shape} in "
            f"{folder} do not belong together; they must have one shape."
        )
    i0, j0 = lattice.index(
        float(obstacles["east0"]) + lattice.cell_m / 2,
        float(obstacles["north0"]) + lattice.cell_m / 2,
    )
    window = Window(int(i0), int(j0), occupied.shape[1], occupied.shape[0])
    poses = _read_poses(folder / "poses_frames.csv")
    ground = _read_ground(folder / _GROUND) if (folder / _GROUND).exists() else None
    return Truth(lattice, window, occupied, pixels, poses, _read_datum(folder), ground)


def _read_ground(path: Path) -> TrueGround:
    """The heights of the true ground, which a truth folder may hold."""
    found = _read_npz(path, ("ground_U", "east0", "north0", "cell"))
    try:
        up_m = found["ground_U"].astype(np.float64)
        west_m, south_m, cell_m = (float(found[name]) for name in ("east0", "north0", "cell"))
    except (TypeError, ValueError) as error:
        raise TruthError(f"{path} cannot be read as heights of the ground: {error}.") from error
    if up_m.ndim != 2 or not math.isfinite(west_m + south_m) or not 0.0 < cell_m < math.inf:
        raise TruthError(
            f"{path} has heights of shape {up_m.shape} from {west_m}, {south_m} in cells of "
            f"{cell_m} m; give ground_U [north, east], and east0, north0 and cell in metres."
        )
    return TrueGround(up_m, west_m, south_m, cell_m)


def _read_npz(path: Path, names: tuple[str, ...]) -> dict[str, AnyArray]:
    try:
        file_bytes(path)
        with path.open("rb") as file, zipfile.ZipFile(file) as archive:
            claimed = sum(archive.getinfo(f"{name}.npy").file_size for name in names)
        if claimed > _MAX_TRUTH_BYTES:
            raise ValueError(f"it unfolds to {claimed >> 20} MiB, more than a raster can have")
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in names}
    except FileNotFoundError as error:
        raise TruthError(f"The truth folder lacks {path.name}; looked for {path}.") from error
    except (
        OSError,
        ValueError,
        KeyError,
        EOFError,
        NotImplementedError,
        zipfile.BadZipFile,
        zlib.error,
        tokenize.TokenError,
    ) as error:
        raise TruthError(f"{path} cannot be read as a truth raster: {error}.") from error


def _read_poses(path: Path) -> tuple[TruthPose, ...]:
    try:
        file_bytes(path)
        with path.open(newline="", encoding="utf-8") as lines:
            rows = csv.DictReader(bounded_lines(lines, path))
            return tuple(_truth_pose(row) for row in counted_rows(rows, path))
    except LimitError:
        raise
    except (OSError, KeyError, TypeError, ValueError, csv.Error) as error:
        raise TruthError(
            f"{path} cannot be read as poses by frame: {shortened(repr(error))}."
        ) from error


def _truth_pose(row: dict[str, str]) -> TruthPose:
    columns = ("timestamp_utc_s", "cam_mid_E", "cam_mid_N", "heading_deg")
    time_s, east_m, north_m, heading_deg = (float(row[column]) for column in columns)
    if not all(math.isfinite(v) for v in (time_s, east_m, north_m, heading_deg)):
        raise ValueError(f"{time_s}, {east_m}, {north_m}, {heading_deg} are not all numbers")
    if not row["direction"] or not row["segment"]:
        raise ValueError(f"the row of {time_s} s lacks its direction or segment")
    time_ns = round(time_s * 1000) * 1_000_000
    leaning = [float(row.get(column) or "nan") for column in ("roll_deg", "pitch_deg")]
    if math.isfinite(leaning[0]) != math.isfinite(leaning[1]):
        raise ValueError(f"the row of {time_s} s has only one of roll and pitch")
    return TruthPose(
        time_ns, east_m, north_m, heading_deg, row["direction"], row["segment"], *leaning
    )


def _read_datum(folder: Path) -> Datum | None:
    """The truth's origin, from the session.json that stands in the folder or beside it."""
    for path in (folder / "session.json", folder.parent / "session.json"):
        if path.is_file():
            try:
                if path.stat().st_size > MAX_BYTES:
                    raise ValueError(f"it has more than {MAX_BYTES} bytes")
                origin = parse_json(path.read_bytes())["ltp_origin"]
                return Datum(
                    float(origin["lat_deg"]),
                    float(origin["lon_deg"]),
                    float(origin["ellipsoid_height_m"]),
                )
            except (OSError, KeyError, TypeError, ValueError) as error:
                raise TruthError(
                    f"{path} does not state the truth's origin: {shortened(repr(error))}."
                ) from error
    return None
