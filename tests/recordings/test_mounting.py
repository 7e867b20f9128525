"""Mountings that are written and read again."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from fieldgrid.core import CalibrationError, MapWriteError
from fieldgrid.geometry import LeverArm, Mount
from fieldgrid.recordings import Mounting, read_mounting, write_mounting

PLAIN = Mounting(Mount(2.5, 15.0), LeverArm(0.1, -0.4, 2.9))
lengths = st.floats(-5.0, 5.0).map(lambda v: round(v, 3) + 0.0)


@given(
    st.floats(0.2, 5.0).map(lambda v: round(v, 3)),
    st.floats(-5.0, 70.0),
    st.floats(-15.0, 15.0),
    st.floats(-40.0, 40.0),
    st.tuples(lengths, lengths, lengths),
    st.none() | lengths,
    st.none() | st.floats(-180.0, 180.0),
    st.sampled_from(["cw_north", "ccw_east"]),
    st.sampled_from(["flu", "frd", "luf"]),
    st.none() | st.floats(0.05, 1.0),
)
def test_what_is_written_is_read_again(
    tmp_path_factory: pytest.TempPathFactory,
    height,
    tilt,
    roll,
    yaw,
    arm,
    axle,
    offset,
    convention,
    axes,
    baseline,  # type: ignore[no-untyped-def]
) -> None:
    path = tmp_path_factory.mktemp("mounting") / "mounting.json"
    right, forward, above = arm
    mounting = Mounting(
        Mount(height, tilt, roll, yaw),
        LeverArm(right, forward, height + above),
        axle,
        offset,
        convention,
        axes,
        baseline,
        str(path),
    )
    write_mounting(path, mounting)
    read = read_mounting(path)
    assert read.antenna.up_m == pytest.approx(mounting.antenna.up_m, abs=2e-6)
    assert replace(read, antenna=mounting.antenna) == mounting
    assert (read.antenna.right_m, read.antenna.forward_m) == (right, forward)


def test_remarks_stay_and_what_is_no_longer_said_goes(tmp_path: Path) -> None:
    path = tmp_path / "mounting.json"
    write_mounting(path, replace(PLAIN, rear_axle_forward_m=-1.5, heading_offset_deg=90.0))
    document = json.loads(path.read_text())
    assert document["camera_mid_from_rear_axle_ground_flu_m"] == [1.5, 0.0, 2.5]
    path.write_text(json.dumps({**document, "note": "by hand", "heading_convention": "ccw_east"}))
    write_mounting(path, PLAIN)
    assert json.loads(path.read_text()) == {
        "camera_height_above_ground_m": 2.5,
        "camera_tilt_down_deg": 15.0,
        "camera_roll_deg": 0.0,
        "camera_yaw_deg": 0.0,
        "gnss_antenna_from_camera_mid_flu_m": [-0.4, -0.1, 0.4],
        "note": "by hand",
        "heading_convention": "cw_north",
    }


def test_what_a_mounting_may_leave_out(tmp_path: Path) -> None:
    path = tmp_path / "mounting.json"
    path.write_text(json.dumps(LEAST))
    assert read_mounting(path) == Mounting(
        Mount(2.5, 15.0, 0.0, 0.0), LeverArm(-0.125, -0.5, 2.75), source=str(path)
    )


POINT, OFFSET = "gnss_antenna_from_camera_mid_flu_m", "heading_offset_deg"
LEAST = {
    "camera_height_above_ground_m": 2.5,
    "camera_tilt_down_deg": 15.0,
    POINT: [-0.5, 0.125, 0.25],
}


@pytest.mark.parametrize(
    ("said", "message"),
    [
        ("", "is not JSON"),
        ("[" * 100_000, "is not JSON"),
        ('{"a": 1e}', "is not JSON"),
        ("[1]", r"holds \[1\]; give a table with camera_height"),
        ({"camera_height_above_ground_m": None}, "lacks camera_height_above_ground_m; measure"),
        ({"camera_tilt_down_deg": None}, "lacks camera_tilt_down_deg"),
        ({POINT: None}, "a forgotten lever arm misplaces"),
        ({POINT: [1, 2]}, r"is \[1, 2\]; measure it and give"),
        ({POINT: [1, 2, "3"]}, "is '3', which is no number"),
        ({POINT: [450, 0, 0]}, "beyond 30 m"),
        ({"camera_height_above_ground_m": 265}, "camera height of 265"),
        ({"camera_height_above_ground_m": float("nan")}, "is nan, which is no number; measure"),
        ({"camera_tilt_down_deg": True}, "is True, which is no number"),
        ({"camera_roll_deg": 90}, "camera roll of 90"),
        ({"camera_hight": 2.0}, "'camera_hight' is not .* known are camera_h.*; for remarks"),
        ({OFFSET: 700}, "heading offset of 700.0° is beyond 360°"),
        ({"heading_convention": "ccw"}, "heading_convention is 'ccw'; give one of"),
        ({"imu_axes": "fru"}, "imu_axes is 'fru', which .* give where x, y and z of the IMU point"),
        ({"imu_axes": 3}, "imu_axes is 3, which"),
    ],
)
def test_what_is_no_mounting_is_refused(
    said: str | dict[str, object], message: str, tmp_path: Path
) -> None:
    path = tmp_path / "mounting.json"
    if isinstance(said, dict):
        said = json.dumps({k: v for k, v in {**LEAST, **said}.items() if v is not None})
    path.write_text(said)
    with pytest.raises(CalibrationError, match=rf"mounting\.json.*{message}"):
        read_mounting(path)


def test_what_is_no_mounting_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "mounting.json"
    path.write_text('{"camera_hight": 2.0}')
    with pytest.raises(CalibrationError, match="camera_hight"):
        write_mounting(path, PLAIN)
    assert path.read_text() == '{"camera_hight": 2.0}'


def test_a_failure_leaves_the_old_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "calibration" / "mounting.json"
    write_mounting(path, PLAIN)
    before = path.read_text()

    def full(*_: object, **__: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    with pytest.raises(MapWriteError, match="No space left"):
        write_mounting(path, replace(PLAIN, mount=Mount(1.0, 2.0)))
    assert path.read_text() == before
    assert list(path.parent.iterdir()) == [path]
