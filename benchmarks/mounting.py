"""`python -m benchmarks.mounting`: mounts found by drives, beside what is known of them.

The vineyard's truth is that of its making, the road's follows from its INS, the rendered drives
are those of the tests. Recordings that are not beside the repository are left out, and named.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks import EXAMPLE
from benchmarks.odometry import ROAD, ROAD_FIRST
from benchmarks.rectified import VINEYARD
from fieldgrid.core import MeasuredValue
from fieldgrid.geometry import Mount
from fieldgrid.pipeline import MountEstimate, estimate_mount
from fieldgrid.recordings import Recording, open_recording
from tests.pipeline.mounting.drives import MemoryFrames, rendered

LANES = ("lane_1", "lane_2")
"""Segments of the example; between them are the headlands."""

RENDERED: dict[str, tuple[Mount, dict[str, float]]] = {
    "open ground": (Mount(2.0, 18.0, 2.5, -3.0), {}),
    "open ground, low": (Mount(1.2, 10.0, -1.5, 4.0), {}),
    "open ground, a curve": (Mount(2.0, 18.0, 1.0, 2.0), {"curvature_per_m": 0.03}),
    "a lane": (Mount(1.8, 14.0, -2.0, 3.0), {"walls": True}),
    "a lane, rough": (Mount(2.4, 25.0, 0.0, -1.0), {"sway_deg": 0.6, "walls": True}),
    "a lane, longer": (Mount(2.65, 16.0, 0.0, 0.0), {"walls": True, "frames": 40}),
    "in reverse": (Mount(2.0, 18.0, 1.0, 3.0), {"step_m": -0.8}),
}
"""Drives of 15 m and more, each with a mount of its own."""

NOT_KNOWN = float("nan")

METRES, DEGREES = ("m", 3), ("°", 2)


class Value(NamedTuple):
    """One value of a mount beside its truth, NaN where that is not known; `asked` the largest
    error, NaN where the truth is not exact."""

    drive: str
    what: str
    unit: tuple[str, int]
    truth: float
    measured: MeasuredValue
    asked: float

    @property
    def error(self) -> float:
        """Measured less the truth."""
        return self.measured.value - self.truth

    def line(self) -> str:
        """A line of the table."""
        name, decimals = self.unit
        measured = f"{self.measured.value:.{decimals}f} ± {self.measured.sigma:.{decimals}f} {name}"
        known = np.isfinite(self.truth)
        truth = f"{self.truth:.{decimals}f}" if known else "-"
        error = f"{self.error:+.{decimals}f}" if known else "-"
        sigmas = f"{self.error / self.measured.sigma:+.1f}" if known else "-"
        asked = f"{self.asked:.{decimals}f}" if np.isfinite(self.asked) else "-"
        missed = "  missed" if abs(self.error) > self.asked else ""
        return (
            f"{self.drive:<32}{self.what:<12}{truth:>9}{measured:>20}{error:>10}{sigmas:>8}"
            f"{asked:>8}{missed}"
        )


def main() -> None:
    """Measure and print all drives."""
    print(
        f"{'drive':<32}{'':<12}{'truth':>9}{'measured':>20}{'error':>10}{'sigmas':>8}{'asked':>8}"
    )
    values = []
    for part in (vineyard(), road(), renderings()):
        for value in part:
            values.append(value)
            print(value.line(), flush=True)
    exact = [value for value in values if np.isfinite(value.asked)]
    sigmas = np.array([abs(value.error / value.measured.sigma) for value in exact])
    one, two, three = (100.0 * (sigmas < k).mean() for k in (1.0, 2.0, 3.0))
    print(f"\n{len(exact)} values beside an exact truth, within 1 / 2 / 3 sigma:", end=" ")
    print(f"{one:.0f} / {two:.0f} / {three:.0f} %")


def vineyard() -> Iterator[Value]:
    """The example, the same drive in colour, and each lane of the example alone."""
    for name, folder in (("example", EXAMPLE), ("example, in colour", VINEYARD)):
        if not folder.exists():
            print(f"{folder.name}: not at hand, left out")
            continue
        with open_recording(folder, "gnss_rtk.nmea") as drive:
            yield from _values(name, estimate_mount(drive), drive.rig.mount)
    for lane in LANES:
        drive = lane_of(EXAMPLE, lane)
        yield from _values(f"example, {lane}", estimate_mount(drive), drive.rig.mount)
        down_deg, right_deg = leaned_deg(EXAMPLE, lane)
        print(f"  the vehicle itself leaned by {down_deg:+.2f}° (tilt), {right_deg:+.2f}° (roll)")


def lane_of(folder: Path, lane: str) -> Recording:
    """The frames of one segment of the example, with all of its fixes."""
    wanted = [row["segment"] == lane for row in _truth(folder)]
    with open_recording(folder, "gnss_rtk.nmea") as drive:
        shots = [shot for shot, inside in zip(drive.frames(), wanted, strict=True) if inside]
        return replace(drive, name=lane, source=MemoryFrames(tuple(shots)))


def leaned_deg(folder: Path, lane: str) -> tuple[float, float]:
    """By how much the vehicle's front and right were lower than the ground that it stood on, in
    the mean of a lane's frames, by the truth; degrees."""
    with np.load(folder / "truth" / "ground_dtm_25cm.npz") as dtm:
        height_m, cell_m = dtm["ground_U"], float(dtm["cell"])
        east0_m, north0_m = float(dtm["east0"]), float(dtm["north0"])
    x, y = (a.ravel() for a in np.meshgrid(np.linspace(-1.0, 1.0, 9), np.linspace(-2.0, 1.0, 13)))
    columns = np.column_stack([np.ones_like(x), x, y])
    leans = []
    for row in _truth(folder):
        if row["segment"] != lane:
            continue
        phi = np.radians(float(row["heading_deg"]))
        east_m = float(row["cam_mid_E"]) + x * np.cos(phi) + y * np.sin(phi)
        north_m = float(row["cam_mid_N"]) - x * np.sin(phi) + y * np.cos(phi)
        cells = (
            ((north_m - north0_m) / cell_m).astype(int),
            ((east_m - east0_m) / cell_m).astype(int),
        )
        _, rises_right, rises_ahead = np.linalg.lstsq(columns, height_m[cells], rcond=None)[0]
        down = np.degrees(np.arctan(rises_ahead)) - float(row["pitch_deg"])
        leans.append((down, float(row["roll_deg"]) + np.degrees(np.arctan(rises_right))))
    down, right = np.mean(leans, axis=0)
    return float(down), float(right)


def _truth(folder: Path) -> list[dict[str, str]]:
    """The true poses of the frames."""
    with (folder / "truth" / "poses_frames.csv").open(newline="") as table:
        return list(csv.DictReader(table))


def road() -> Iterator[Value]:
    """KITTI's drive. Its rig is stated against the INS, and how the INS leans against the way is
    told by its own velocities: no exact truth, but one that knows nothing of the images. How the
    INS rolls against the road is not told."""
    if not ROAD.exists():
        print(f"{ROAD.name}: not at hand, left out")
        return
    with open_recording(ROAD) as drive:
        stated, estimate = drive.rig.mount, estimate_mount(drive)
    down_deg, right_deg = ins_off_the_way(ROAD)
    tilt_deg, yaw_deg = stated.tilt_deg + down_deg, stated.yaw_deg + right_deg
    truth = Mount(stated.height_m, tilt_deg, stated.roll_deg, yaw_deg)
    for value in _values("KITTI 0020, by its INS", estimate, truth):
        known = value.truth if value.what != "roll" else NOT_KNOWN
        yield value._replace(truth=known, asked=NOT_KNOWN)


def ins_off_the_way(folder: Path) -> tuple[float, float]:
    """By how much the INS looks below its way and to the right of it, on an almost straight road;
    degrees."""
    (data,) = folder.glob("**/oxts/data")
    rows = np.array([np.loadtxt(path) for path in sorted(data.iterdir())])[ROAD_FIRST:]
    pitch, forward, left, up = rows[:, [4, 8, 9, 10]].T  # pitch is positive, front down
    down, right = pitch + np.arctan2(up, forward), np.arctan2(left, forward)
    return float(np.degrees(down.mean())), float(np.degrees(right.mean()))


def renderings() -> Iterator[Value]:
    """The rendered drives."""
    for name, (mount, how) in RENDERED.items():
        drive = rendered(mount, **how)  # type: ignore[arg-type]
        yield from _values(f"rendered, {name}", estimate_mount(drive), mount)


def _values(name: str, found: MountEstimate, truth: Mount) -> Iterator[Value]:
    yield Value(name, "height", METRES, truth.height_m, found.height_m, 0.03)
    yield Value(name, "tilt", DEGREES, truth.tilt_deg, found.tilt_deg, 0.2)
    yield Value(name, "roll", DEGREES, truth.roll_deg, found.roll_deg, 0.2)
    if found.yaw_deg is None:
        print(f"{name}: no yaw")
    else:
        yield Value(name, "yaw", DEGREES, truth.yaw_deg, found.yaw_deg, 0.3)


if __name__ == "__main__":
    main()
