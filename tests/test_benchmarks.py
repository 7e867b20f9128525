"""The measurements of recordings run, each on little: their figures go into docs/accuracy.md."""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmarks import clock, faults, mounting, random_drives, reading
from benchmarks.variations import leap
from fieldgrid.core import MeasuredValue, Quality
from fieldgrid.geometry import Steps
from fieldgrid.poses import ClockOffset
from tests.conftest import TWO_LANES

ROOT = Path(mounting.__file__).parents[1]
PROGRAMS = [
    f"{folder.replace('/', '.')}.{path.stem}"
    for folder in ("benchmarks", "fuzz", "tests/crash")
    for path in sorted((ROOT / folder).glob("*.py"))
]


@pytest.mark.parametrize("name", PROGRAMS)
def test_every_measurement_can_be_loaded(name: str) -> None:
    """They follow the code that they measure, damage or feed."""
    found = None
    try:
        importlib.import_module(name)
    except ModuleNotFoundError as missing:
        found = str(missing.name)
    assert found is None or not found.startswith(("fieldgrid", "benchmarks", "fuzz", "tests"))
    if found is not None:
        pytest.skip(f"{found} is not installed")


def test_what_is_so_of_every_receiver_warns_of_no_fault() -> None:
    """A differential receiver that states a third of its error, and drifts unseen."""
    silent = random_drives.found(8111)
    assert silent.case.quality is Quality.DIFFERENTIAL
    assert silent.sigma_m > 0.2
    assert silent.notes == ()


@pytest.mark.parametrize(("drift_m", "outcomes"), [(1.0, {"covered", "unseen"}), (1.5, {"named"})])
@pytest.mark.parametrize("seed", [2, 3])
def test_no_gyro_is_blamed_where_fixes_drift_beside_a_camera(
    seed: int, drift_m: float, outcomes: set[str]
) -> None:
    change = faults.always(leap(2.0 * drift_m, 0.0, 2.0, grows=True))
    drift = faults.Fault("drift", (faults.CAMERA,), change, "drift:")
    assert faults.found(drift, faults.CAMERA, seed).outcome in outcomes


@pytest.mark.parametrize("sensors", faults.SETS)
def test_nothing_is_accused_without_a_fault(sensors: str) -> None:
    none = faults.FAULTS[0]
    for seed in range(len(faults.VEHICLES)):
        assert faults.found(none, sensors, seed).told == ()


def test_a_mount_beside_its_truth(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    name = "a lane"
    monkeypatch.setattr(mounting, "RENDERED", {name: mounting.RENDERED[name]})
    monkeypatch.setattr(mounting, "vineyard", lambda: iter(()))
    monkeypatch.setattr(mounting, "ROAD", Path("nowhere"))
    mounting.main()
    told = capsys.readouterr().out.splitlines()
    assert told[1] == "nowhere: not at hand, left out"
    assert [line.split()[3] for line in told[2:6]] == ["height", "tilt", "roll", "yaw"]
    assert told[-1].startswith("4 values beside an exact truth")


def test_an_error_is_what_was_measured_less_the_truth() -> None:
    tilt = mounting.Value("drive", "tilt", mounting.DEGREES, 16.0, MeasuredValue(15.5, 0.25), 0.2)
    assert tilt.error == -0.5
    assert tilt.line().split()[2:] == [
        "16.00",
        "15.50",
        "±",
        "0.25",
        "°",
        "-0.50",
        "-2.0",
        "0.20",
        "missed",
    ]
    unknown = tilt._replace(truth=math.nan, asked=math.nan).line()
    assert unknown.split()[2:] == ["-", "15.50", "±", "0.25", "°", "-", "-", "-"]


def test_a_lane_has_its_own_frames() -> None:
    lanes = [mounting.lane_of(TWO_LANES, lane) for lane in mounting.LANES]
    assert [lane.frame_count for lane in lanes] == [17, 15]
    assert lanes[0].frame_times_ns().max() < lanes[1].frame_times_ns().min()


def test_how_the_vehicle_leaned_in_a_lane() -> None:
    """Each lane leans to its own side, by less than the vehicle sways."""
    (down, right), (_, other) = (mounting.leaned_deg(TWO_LANES, lane) for lane in mounting.LANES)
    assert down == pytest.approx(-0.11, abs=0.05)
    assert right == pytest.approx(-0.18, abs=0.05)
    assert other == pytest.approx(0.27, abs=0.05)


def test_how_an_ins_leans_against_its_way(shared_data: Callable[[str], Path]) -> None:
    road = shared_data("kitti_2011_09_30_drive_0020")
    down, right = mounting.ins_off_the_way(road)
    assert down == pytest.approx(0.78, abs=0.02)
    assert right == pytest.approx(0.03, abs=0.02)


def test_a_late_clock_has_late_steps() -> None:
    columns = [np.arange(3, dtype=np.int64) * 10**9, np.arange(1, 4, dtype=np.int64) * 10**9]
    steps = Steps(*columns, *(np.zeros(3) for _ in range(len(Steps._fields) - 2)))
    assert clock.late(steps, 0.03).start_ns.tolist() == [30_000_000, 1_030_000_000, 2_030_000_000]
    assert len(clock.within(steps, columns[0]).start_ns) == 2


def test_the_error_of_a_clock() -> None:
    told = (ClockOffset(-0.02, 0.01, 20, 1.0),) * 2 + (None,) * (len(clock.LATE_S) - 2)
    line = clock.Line("drive", "rtk", "no", 20, told)
    assert line.errors_s() == pytest.approx([-0.02, 0.01])
    assert "-20 ± 10 ms?" in line.text()
    assert "100 % within 1 / 2 / 3 sigma" in clock.summary([line])
    assert "2 of 7 told; error median 15 ms, largest 20 ms" in clock.summary([line])


def test_the_clock_of_the_example(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clock, "LATE_S", (0.03,))
    monkeypatch.setattr(clock, "PARTS", {"whole drive": ("",)})
    monkeypatch.setattr(clock, "VINEYARD", Path("nowhere"))
    for line in clock.measure():
        assert line.steps == 49
        # Fixes of decimetres with a hole do not tell 0.03 s without a gyro.
        assert line.told[0] is not None or (line.log, line.gyro) == ("sf1", "no")
        for error_s, told in zip(line.errors_s(), filter(None, line.told), strict=True):
            assert abs(error_s) < 3.0 * told.sigma_s


@pytest.mark.parametrize("compressed", [False, True])
def test_the_cost_of_reading(
    compressed: bool,
    make_drive: Callable[..., Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(reading, "RUNS", 1)
    bag = reading.write(tmp_path / "bag" / "drive", make_drive(), "mcap", compressed=compressed)
    found = reading.cost(bag)
    assert found.frames == 3
    assert min(found) > 0.0
    assert found.line("mcap").split()[-1] == "%"
    assert 20.0 < reading.peak_of_reading_mb(bag) < 10_000.0


def test_no_clock_is_told_by_a_gyro_that_does_not_go_with_the_images(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A part that is too even for its offset: the estimate that fuses the images bends to them."""
    monkeypatch.setattr(clock, "LATE_S", (18.0, -18.0))
    monkeypatch.setattr(clock, "LOGS", ("sf1",))
    parts = {name: clock.PARTS[name] for name in ("lane 2", "entry, lane 1")}
    monkeypatch.setattr(clock, "PARTS", parts)
    monkeypatch.setattr(clock, "VINEYARD", Path("nowhere"))
    lines = list(clock.measure())
    assert [(line.steps, line.gyro) for line in lines] == [
        *((14, "yes"), (14, "no")),
        *((20, "yes"), (20, "no")),
    ]
    assert [told for line in lines for told in line.told] == [None] * 8
