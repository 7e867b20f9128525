"""Make examples/two_lanes from the full recording: grey images, and the truth that scores need.

python tools/compact_example.py FULL_RECORDING examples/two_lanes
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import cv2

JPEG_QUALITY = 82
KEPT = (
    "frames.csv",
    "session.json",
    "calibration/mounting.json",
    "calibration/stereo_opencv.yaml",
    "gnss/gnss_rtk.nmea",
    "gnss/gnss_sf1.nmea",
    "imu/imu_100hz.csv",
    "truth/obstacle_raster_5cm.npz",
    "truth/obstacle_raster_5cm.json",
    "truth/observable_raster_5cm.npz",
    "truth/ground_dtm_25cm.npz",
    "truth/poses_frames.csv",
    "truth/rows.geojson",
    "truth/lanes.geojson",
    "truth/obstacles.json",
)


def main(source: Path, target: Path) -> None:
    """Copy what is kept, and re-encode the images in grey."""
    for name in KEPT:
        (target / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source / name, target / name)
    for side in ("left", "right"):
        (target / side).mkdir(exist_ok=True)
        for path in sorted((source / side).glob("*.jpg")):
            image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            if image is None:
                raise SystemExit(f"{path} cannot be decoded")
            quality = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY, cv2.IMWRITE_JPEG_OPTIMIZE, 1]
            cv2.imwrite(str(target / side / path.name), image, quality)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
