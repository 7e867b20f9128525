"""`python -m benchmarks.clock`: clocks of camera and receiver set apart, and found by the drive.

The stamps of the images are moved, and what the search says of them stands beside that. The
vineyard in colour is beside the repository in ../shared/data; it is left out where it is absent.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from benchmarks import EXAMPLE
from benchmarks.rectified import VINEYARD
from fieldgrid.core import PoseSettings
from fieldgrid.geometry import Motion, Rig, Steps
from fieldgrid.pipeline import visual_odometry
from fieldgrid.poses import ClockOffset
from fieldgrid.poses.accepted import AcceptedFixes
from fieldgrid.poses.axle import Axle
from fieldgrid.poses.drive import DriveEstimate, smooth_drive
from fieldgrid.poses.faults.clock.offset import check_clock
from fieldgrid.poses.fused import conditioned
from fieldgrid.recordings import open_recording

LATE_S = (0.0, 0.03, -0.5, 2.0, -6.0, 18.0, -18.0)
"""By how much images are stamped late; 18 s is what GPS time is off UTC, 2 s is just near by."""

LOGS = ("rtk", "sf1")
PARTS = {
    "whole drive": ("",),
    "lane 1": ("lane_1",),
    "lane 2": ("lane_2",),
    "turn": ("turn",),
    "entry, lane 1": ("headland_entry", "lane_1"),
    "lane 1, turn": ("lane_1", "turn"),
    "turn, lane 2": ("turn", "lane_2"),
    "lane 2, exit": ("lane_2", "headland_exit"),
}
"""Parts of the example, by the beginnings of their segments' names."""


class Line(NamedTuple):
    """What one part of a drive tells of each clock of `LATE_S`; None for nothing."""

    name: str
    log: str
    gyro: str
    steps: int
    told: tuple[ClockOffset | None, ...]

    def errors_s(self) -> list[float]:
        """What was told less what was true, where anything was told."""
        pairs = zip(self.told, LATE_S, strict=True)
        return [told.offset_s + late_s for told, late_s in pairs if told is not None]

    def text(self) -> str:
        """A line of the table."""
        cells = "".join(f"{_cell(*pair):>18}" for pair in zip(self.told, LATE_S, strict=True))
        return f"{self.name:<26}{self.log:<5}{self.gyro:<5}{self.steps:>5}{cells}"


def _cell(told: ClockOffset | None, late_s: float) -> str:
    if told is None:
        return "none"
    mark = "" if told.is_certain else "?"
    return f"{1e3 * (told.offset_s + late_s):+.0f} ± {1e3 * told.sigma_s:.0f} ms{mark}"


def main() -> None:
    """Measure and print all."""
    print("errors of the offset that is told, with its sigma, when images are stamped late by so")
    print("much; `?` is an offset below 3 sigma or 20 ms, of which a user is not told; `none` is")
    print("told where a part of a drive is too short or too even")
    late = "".join(f"{f'{late_s:+.2f} s':>18}" for late_s in LATE_S)
    print(f"\n{'drive':<26}{'log':<5}{'gyro':<5}{'steps':>5}{late}")
    lines = []
    for line in measure():
        lines.append(line)
        print(line.text(), flush=True)
    print(f"\n{summary(lines)}")


def measure() -> Iterator[Line]:
    """The parts of the example, then the same drive in colour."""
    yield from _drive("example", EXAMPLE, PARTS)
    if VINEYARD.exists():
        yield from _drive("colour", VINEYARD, {"whole drive": PARTS["whole drive"]})
    else:
        print(f"{VINEYARD.name}: not at hand, left out")


def _drive(name: str, folder: Path, parts: dict[str, tuple[str, ...]]) -> Iterator[Line]:
    with open_recording(folder, "gnss_rtk.nmea") as drive:
        steps = visual_odometry(drive)
        times_ns = drive.frame_times_ns() + drive.rig.image_time_offset_ns
    with (folder / "truth" / "poses_frames.csv").open(newline="") as table:
        segments = [row["segment"] for row in csv.DictReader(table)]
    for log in LOGS:
        with open_recording(folder, f"gnss_{log}.nmea") as drive:
            gyro, rig = drive.motion().gyro, drive.rig
            fixes = drive.fixes().in_order()
        accepted = conditioned(fixes, PoseSettings()).accepted
        alone = {
            turns: smooth_drive(accepted, fixes.time_ns, Motion(gyro if turns else None), Axle(rig))
            for turns in (True, False)
        }
        for part, beginnings in parts.items():
            inside = times_ns[[segment.startswith(beginnings) for segment in segments]]
            some = within(steps, inside)
            for turns, without_camera in alone.items():
                known = Motion(gyro if turns else None, steps=some)
                told = tell(without_camera, accepted, known, rig)
                yield Line(
                    f"{name}, {part}", log, "yes" if turns else "no", len(some.start_ns), told
                )


def within(steps: Steps, times_ns: npt.NDArray[np.int64]) -> Steps:
    """The steps between frames of the given times."""
    keep = np.isin(steps.start_ns, times_ns) & np.isin(steps.stop_ns, times_ns)
    return Steps(*(column[keep] for column in steps))


def tell(
    drive: DriveEstimate, fixes: AcceptedFixes, motion: Motion, rig: Rig
) -> tuple[ClockOffset | None, ...]:
    """What is told of each of the clocks; the gyro goes with the fixes."""
    steps = motion.steps
    assert steps is not None
    return tuple(
        check_clock(drive, fixes, motion._replace(steps=late(steps, late_s)), Axle(rig)).offset
        for late_s in LATE_S
    )


def late(steps: Steps, late_s: float) -> Steps:
    """The steps of a camera whose clock is late."""
    late_ns = round(late_s * 1e9)
    return steps._replace(start_ns=steps.start_ns + late_ns, stop_ns=steps.stop_ns + late_ns)


def summary(lines: Sequence[Line]) -> str:
    """How many were told, and how surely."""
    errors_s = np.abs([error for line in lines for error in line.errors_s()])
    told = [one for line in lines for one in line.told if one is not None]
    sigmas = errors_s / [one.sigma_s for one in told]
    return (
        f"{len(told)} of {len(lines) * len(LATE_S)} told; error median "
        f"{1e3 * np.median(errors_s):.0f} ms, largest {1e3 * errors_s.max():.0f} ms; "
        f"{100 * (sigmas < 1.0).mean():.0f} / {100 * (sigmas < 2.0).mean():.0f} / "
        f"{100 * (sigmas < 3.0).mean():.0f} % within 1 / 2 / 3 sigma"
    )


if __name__ == "__main__":
    main()
