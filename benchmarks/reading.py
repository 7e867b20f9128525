"""`python -m benchmarks.reading`: what reading costs beside the stereo stage, and its memory.

The example is written into every container by the writers of the tests, and read back as a build
reads it: frames in order, each read, decoded and hashed. The stereo stage, matching and the grid,
is that of the same run and core, taking turns. Raw pairs that are rectified while they are read
are beside the repository in ../shared/data, and left out where they are absent.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from benchmarks import EXAMPLE
from benchmarks.long_drive import write_long_drive
from benchmarks.peak import peak_mb
from benchmarks.rectified import VINEYARD, raw_drive
from fieldgrid.perception import LocalGridder
from fieldgrid.recordings import Recording, open_recording
from fieldgrid.recordings.files import parse_time_ns
from tests.recordings import bags
from tests.recordings.test_euroc import table, write_euroc

LOG = "gnss_rtk.nmea"
RUNS = 3
LENGTHS = (100, 400)
"""Pairs of the recordings whose memory is compared."""


class Cost(NamedTuple):
    """Milliseconds a frame: streaming (`frames()`), decoding (`images()` and hashes), and the
    stereo stage; and for the whole recording the opening, with its fixes and gyro."""

    frames: int
    open_ms: float
    stream_ms: float
    decode_ms: float
    stereo_ms: float

    def line(self, name: str) -> str:
        """A line of the table."""
        share = (self.stream_ms + self.decode_ms) / self.stereo_ms
        return (
            f"{name:<34}{self.frames:>7}{self.open_ms:>9.0f}{self.stream_ms:>9.2f}"
            f"{self.decode_ms:>9.2f}{self.stereo_ms:>9.1f}{100 * share:>8.1f} %"
        )


def main() -> None:
    """Measure and print both tables; with a path, only read that recording, for its memory."""
    if len(sys.argv) > 1:
        print(peak_of_reading_mb(Path(sys.argv[1])))
        return
    cv2.setNumThreads(1)
    print("ms a frame on one core; asked: reading, which is streaming and decoding, ≤ 15 %")
    print(
        f"{'':<34}{'frames':>7}{'open, ms':>9}{'stream':>9}{'decode':>9}{'stereo':>9}"
        f"{'reading':>10}"
    )
    with ExitStack() as stack:
        for name, path in containers(Path(stack.enter_context(tempfile.TemporaryDirectory()))):
            print(cost(path).line(name), flush=True)
        if VINEYARD.exists():
            print(cost(stack.enter_context(raw_drive())).line("plain folder, raw jpg, rectified"))
        else:
            print(f"{VINEYARD.name}: not at hand, left out")
    lengths = "".join(f"{f'{pairs} pairs':>12}" for pairs in LENGTHS)
    print(f"\n{'peak memory of reading, MB':<34}{lengths}")
    for line in memory():
        print(line, flush=True)


def cost(path: Path) -> Cost:
    """Medians of some runs over a recording."""
    times = [_once(path) for _ in range(RUNS)]
    return Cost(*np.median(times, axis=0))._replace(frames=times[0].frames)


def _once(path: Path) -> Cost:
    start = time.perf_counter()
    with _opened(path) as drive:
        drive.fixes()
        drive.motion()
        open_s = time.perf_counter() - start
        gridder, frames = LocalGridder(drive.rig), drive.frames()
        spent = np.zeros(3)
        for _ in range(drive.frame_count):
            started = time.perf_counter()
            frame = next(frames)
            streamed = time.perf_counter()
            left, right = frame.images()
            for source in frame.sources:
                source.sha256()
            decoded = time.perf_counter()
            gridder(left, right)
            spent += np.diff([started, streamed, decoded, time.perf_counter()])
        return Cost(drive.frame_count, 1e3 * open_s, *(1e3 * spent / drive.frame_count))


def containers(folder: Path) -> Iterator[tuple[str, Path]]:
    """The example as JPEG and as PNG, in every container; each is gone when the next is asked."""
    yield "plain folder, jpg", EXAMPLE
    png = _as_png(folder / "png")
    yield "plain folder, png", png
    euroc = write_euroc(png, folder / "euroc")
    yield "EuRoC, png", euroc
    for container in bags.CONTAINERS:
        for kind, source in (("raw", EXAMPLE), ("jpg", EXAMPLE), ("png", png)):
            compressed = kind != "raw"
            bag = write(folder / "bag" / "drive", source, container, compressed=compressed)
            yield f"{container}, {kind}", bag
            shutil.rmtree(folder / "bag")


def write(path: Path, source: Path, container: bags.Container, *, compressed: bool) -> Path:
    """A plain folder as a bag, with the fixes of the example."""
    maker = bags.Maker(container)
    with open_recording(EXAMPLE, LOG) as drive:
        camera = drive.rig.camera
    focal_px = camera.focal_px
    P = np.array(
        [[focal_px, 0.0, camera.cx_px, 0.0], [0.0, focal_px, camera.cy_px, 0.0], [0.0, 0, 1, 0]]
    )
    P_right = P.copy()
    P_right[0, 3] = -camera.focal_baseline_px_m
    pairs = [(parse_time_ns(r), r["left"], r["right"]) for r in table(source / "frames.csv")]
    said = list(bags.images_said(maker, source, pairs, (P, P_right), compressed=compressed))
    said += bags.sentences_said(maker, EXAMPLE / "gnss" / LOG, pairs[0][0])
    bag = bags.write_bag(path, container, maker, said)
    shutil.copy(EXAMPLE / "calibration" / "mounting.json", bag if bag.is_dir() else bag.parent)
    return bag


def memory() -> Iterator[str]:
    """Lines of peak memory by container and length, each read in a process of its own."""
    for container in bags.CONTAINERS:
        for kind in ("raw", "jpg"):
            peaks = []
            for pairs in LENGTHS:
                with tempfile.TemporaryDirectory() as folder:
                    drive = Path(folder) / "drive"
                    drive.mkdir()
                    write_long_drive(drive, pairs)
                    out = Path(folder) / "bag" / "drive"
                    peaks.append(_peak_mb(write(out, drive, container, compressed=kind != "raw")))
            yield f"{f'{container}, {kind}':<34}" + "".join(f"{peak:>12.0f}" for peak in peaks)


def _peak_mb(path: Path) -> float:
    command = [sys.executable, "-m", "benchmarks.reading", str(path)]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


def peak_of_reading_mb(path: Path) -> float:
    """The peak memory of this process after reading a recording."""
    with _opened(path) as drive:
        for frame in drive.frames():
            frame.images()
    return peak_mb()


def _opened(path: Path) -> Recording:
    """A recording by its RTK log, where it has logs to choose from."""
    return open_recording(path, LOG if (path / "gnss" / LOG).exists() else None)


def _as_png(folder: Path) -> Path:
    """The example with PNG images."""
    shutil.copytree(EXAMPLE, folder)
    for path in folder.glob("*/*.jpg"):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        assert cv2.imwrite(str(path.with_suffix(".png")), image)
        path.unlink()
    frames = folder / "frames.csv"
    frames.write_text(frames.read_text().replace(".jpg", ".png"))
    return folder


if __name__ == "__main__":
    main()
