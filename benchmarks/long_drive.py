"""A drive of any length, made from the example's images: for memory, which must not grow."""

from __future__ import annotations

import math
import shutil
from pathlib import Path

from benchmarks import EXAMPLE

STEP_M, STEP_S = 2.0, 1.2
START_NS = 1_308_133_811_000_000_000


def write_long_drive(folder: Path, frames: int) -> None:
    """A plain recording of `frames` pairs, 2 m apart, along a straight line north-east."""
    shutil.copytree(EXAMPLE / "calibration", folder / "calibration")
    shutil.copytree(EXAMPLE / "left", folder / "left")
    shutil.copytree(EXAMPLE / "right", folder / "right")
    names = sorted(path.name for path in (EXAMPLE / "left").glob("*.jpg"))
    with (folder / "frames.csv").open("w", encoding="utf-8") as out:
        out.write("frame_id,time_ns,left,right\n")
        for k in range(frames):
            name = names[k % len(names)]
            time_ns = START_NS + round((k + 1) * STEP_S * 1e9)
            out.write(f"{k:07d},{time_ns},left/{name},right/{name}\n")
    (folder / "gnss").mkdir()
    metres_a_degree = 111_320.0
    lat0, lon0 = 41.65, -4.72
    with (folder / "gnss" / "track.csv").open("w", encoding="utf-8") as out:
        out.write("time_ns,lat_deg,lon_deg,height_m,quality,satellites,speed_mps\n")
        for k in range(int(frames * STEP_S * 5) + 20):
            along_m = k / 5.0 / STEP_S * STEP_M
            lat = lat0 + along_m * math.sqrt(0.5) / metres_a_degree
            lon = lon0 + along_m * math.sqrt(0.5) / metres_a_degree / math.cos(math.radians(lat0))
            speed = STEP_M / STEP_S
            time_ns = START_NS + k * 200_000_000
            out.write(f"{time_ns},{lat:.9f},{lon:.9f},787.4,4,14,{speed:.3f}\n")
