"""Each fault that is put into a sound drive is found, and nothing else is."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from fieldgrid.core import BuildSettings, FieldgridError, Severity
from fieldgrid.maps import open_map
from fieldgrid.pipeline import (
    Inspection,
    SessionReport,
    build_map,
    estimate_mount,
    inspect_recording,
    repose_map,
)
from fieldgrid.recordings import DriveOptions
from tests.conftest import TWO_LANES
from tests.pipeline.inspection.broken import (
    FEW,
    RTK,
    SF1,
    Image,
    change_calibration,
    change_mounting,
    exchange,
    fixes_as_table,
    rewrite_images,
    scaled_baseline,
    turned_about_x,
)
from tests.pipeline.inspection.conftest import Make, codes, serious


def finding(found: Inspection, code: str) -> tuple[str, str]:
    """The message and the remedy of the one finding with a code."""
    (one,) = (one for one in found.findings if one.code == code)
    assert one.message.endswith(".")
    assert one.remedy.endswith(".")
    return one.message, one.remedy


# --- sound drives


def test_a_sound_drive_has_nothing_to_complain_of() -> None:
    found = inspect_recording(TWO_LANES, options=DriveOptions(RTK))
    assert found.builds
    assert serious(found) == set()
    assert found.reasons.total() == 0
    assert found.followed == found.frames == 50
    assert found.clock is not None
    assert abs(found.clock.offset_s) < 2.0 * found.clock.sigma_s < 0.02
    assert found.scale is not None
    assert found.scale.ratio == pytest.approx(1.0, abs=0.01)
    assert found.mount is not None
    assert found.mount.height_m.value == pytest.approx(2.65, abs=0.03)
    assert found.misalignment is not None
    assert abs(found.misalignment.residual_px) < 0.1
    assert found.coverage is not None
    assert 600.0 < found.coverage.area_m2 < 1300.0
    assert found.coverage.cell_m == 0.25


def test_a_poorer_log_is_told_and_no_more() -> None:
    found = inspect_recording(TWO_LANES, options=DriveOptions(SF1))
    assert found.builds
    assert serious(found) == {"fix-gaps"}
    assert found.clock is not None
    assert abs(found.clock.offset_s) < 3.0 * found.clock.sigma_s


@pytest.mark.parametrize("pose", [{"visual_odometry": False}, {"heading": "course"}])
def test_a_build_that_does_not_follow_the_camera(drive: Make, pose: dict[str, Any]) -> None:
    settings = BuildSettings.model_validate({"pose": pose})
    found = inspect_recording(drive(frames=FEW), settings)
    assert found.builds
    assert codes(found, Severity.ERROR) == set()
    assert (found.looked, found.followed, found.camera_pairs) == (len(FEW), 0, 0)
    assert found.mount is not None


def test_a_drive_none_of_whose_poses_is_good_enough(drive: Make) -> None:
    settings = BuildSettings.model_validate({"pose": {"max_heading_sigma_deg": 0.001}})
    found = inspect_recording(drive(frames=FEW), settings)
    assert not found.builds
    message, _ = finding(found, "no-pose")
    assert "poses of the drive can be used, mostly because: heading sigma" in message
    assert found.sync is None
    assert "images-without-fix" not in codes(found)


@pytest.mark.long
def test_kitti_is_sound_but_for_its_first_fixes(shared_data: Callable[[str], Path]) -> None:
    found = inspect_recording(shared_data("kitti_2011_09_30_drive_0020"))
    assert found.builds
    assert found.kind == "KITTI raw"
    assert codes(found, Severity.ERROR) == set()
    assert serious(found) == {"fixes-rejected"}
    # KITTI's rectification leaves up to a pixel at the right edge.
    assert found.misalignment is not None
    assert 0.2 < found.misalignment.residual_px < 0.5
    assert "axle-unknown" in codes(found, Severity.INFO)


@pytest.mark.long
def test_a_hillside_accuses_no_mounting(shared_data: Callable[[str], Path]) -> None:
    """The ground ahead is not the plane that the vehicle stands on; `mount` says the same."""
    folder, log = shared_data("vineyard_slope"), DriveOptions("gnss_rtk.nmea")
    found = inspect_recording(folder, options=log)
    assert not {"mounting-height", "mounting-tilt", "mounting-roll"} & serious(found)
    assert found.mount is not None
    assert found.mount.measured() == estimate_mount(folder, log).measured()


# --- clocks


@pytest.mark.parametrize(
    ("moved_s", "log"), [(-0.03, RTK), pytest.param(0.03, SF1, marks=pytest.mark.long)]
)
def test_thirty_milliseconds(drive: Make, moved_s: float, log: str) -> None:
    found = inspect_recording(drive(moved_s=moved_s, log=log))
    assert found.builds
    assert codes(found, Severity.ERROR) == set()
    assert "clock-offset" in codes(found, Severity.WARNING)
    assert found.clock is not None
    assert found.clock.offset_s == pytest.approx(-moved_s, abs=0.005)
    assert found.clock.sigma_s < 0.01
    _, remedy = finding(found, "clock-offset")
    assert f"Add {found.clock.offset_s:.3f} to --time-offset, or to image_time" in remedy


def test_two_seconds_are_an_error_without_a_gyro_too(drive: Make) -> None:
    found = inspect_recording(drive(frames=range(50), moved_s=2.0, imu=False))
    assert not found.builds
    assert serious(found) == {"clock-offset"}
    assert codes(found, Severity.ERROR) == {"clock-offset"}
    assert found.clock is not None
    assert found.clock.offset_s == pytest.approx(-2.0, abs=2.0 * found.clock.sigma_s)


def test_the_remedy_mends_it(drive: Make) -> None:
    found = inspect_recording(
        drive(moved_s=2.0), options=DriveOptions(image_time_offset_ns=-2_000_000_000)
    )
    assert serious(found) == set()
    assert found.declared_offset_s == -2.0


@pytest.mark.parametrize(
    ("moved_s", "gps"), [(-15.0, "fixes"), pytest.param(18.0, "images", marks=pytest.mark.long)]
)
def test_gps_time_for_utc(drive: Make, moved_s: float, gps: str) -> None:
    found = inspect_recording(drive(frames=range(50), moved_s=moved_s))
    assert not found.builds
    assert serious(found) == {"clock-offset"}
    message, remedy = finding(found, "clock-offset")
    assert re.search(r"; at 1\.\d m/s that is \d+\.\d\d m\.$", message)
    assert f"GPS time is {abs(moved_s):.0f} s ahead of UTC, so the {gps} carry GPS time" in message
    assert f"Add {-moved_s:.3f} to --time-offset" in remedy


def test_fixes_alone_in_gps_time(drive: Make) -> None:
    """The gyro shows that it is the fixes: moving the images would not mend it, moving them
    does."""
    folder = drive()
    fixes_as_table(folder, 18.0)
    found = inspect_recording(folder)
    assert not found.builds
    assert codes(found, Severity.ERROR) == {"clock-offset"}
    message, remedy = finding(found, "clock-offset")
    assert "the fixes carry GPS time" in message
    told = re.match(
        r"The gyro goes with the images: add (\S+) to --gnss-offset, or to gnss_time", remedy
    )
    assert told is not None
    assert abs(float(told[1]) + 18.0) < 0.05
    moved_ns = round(float(told[1]) * 1e9)
    mended = inspect_recording(folder, options=DriveOptions(gnss_offset_ns=moved_ns))
    assert mended.builds
    assert serious(mended) == set()


@pytest.mark.parametrize(
    ("moved_s", "why"),
    [
        pytest.param(7200.0, "2 h is that of a time zone", marks=pytest.mark.long),
        (-19800.0, "5.5 h is that of a time zone"),
        (86400.0, "1 day: one of the two has a wrong date"),
    ],
)
def test_other_hours(drive: Make, moved_s: float, why: str) -> None:
    found = inspect_recording(drive(frames=FEW, moved_s=moved_s))
    assert not found.builds
    assert serious(found) == {"no-overlap"}
    message, remedy = finding(found, "no-overlap")
    assert "do not overlap in time" in message
    assert why in remedy
    assert f"give --time-offset {-moved_s:g} or image_time_offset_s = {-moved_s:g}" in remedy
    assert found.as_dict()["frames_usable"] == 0
    assert "clock-unknown" not in codes(found)


def test_another_drive_s_log(drive: Make) -> None:
    found = inspect_recording(drive(frames=FEW, moved_s=1000.0))
    assert serious(found) == {"no-overlap"}
    assert "--gnss" in finding(found, "no-overlap")[1]


def test_backward_stamps(drive: Make) -> None:
    folder = drive(frames=FEW)
    fixes_as_table(folder, 0.0, backward=True)
    found = inspect_recording(folder)
    assert serious(found) == {"backward-stamps"}
    assert "5 stamps of gnss/fixes.csv are earlier" in finding(found, "backward-stamps")[0]


# --- cameras


def test_swapped_cameras(drive: Make) -> None:
    folder = drive(frames=FEW)
    exchange(folder)
    found = inspect_recording(folder)
    assert not found.builds
    assert codes(found, Severity.ERROR) == {"cameras-swapped"}
    assert "swap the two folders" in finding(found, "cameras-swapped")[1].lower()


@pytest.mark.parametrize("baseline_m", [0.20, pytest.param(0.17, marks=pytest.mark.long)])
def test_a_wrong_baseline(drive: Make, baseline_m: float) -> None:
    folder = drive()
    change_calibration(folder, scaled_baseline(baseline_m / 0.18))
    change_mounting(folder, stereo_baseline_m=baseline_m)
    found = inspect_recording(folder)
    assert codes(found, Severity.ERROR) == {"scale"}
    assert found.scale is not None
    assert found.scale.ratio == pytest.approx(baseline_m / 0.18, abs=0.01)
    assert "A baseline of 0.18" in finding(found, "scale")[1]
    # The height is wrong by the same, which is no fault of the mounting.
    assert "mounting-height" not in serious(found)


@pytest.mark.parametrize(("degrees", "severity"), [(0.05, Severity.WARNING), (1.0, Severity.ERROR)])
def test_a_camera_that_has_turned(drive: Make, degrees: float, severity: Severity) -> None:
    folder = drive(frames=FEW)
    rewrite_images(folder, turned_about_x(degrees), "right")
    found = inspect_recording(folder)
    assert "vertical-misalignment" in codes(found, severity)
    assert found.misalignment is not None
    expected_px = -905.4 * np.tan(np.radians(degrees))
    assert found.misalignment.median_px == pytest.approx(expected_px, abs=0.3)


def test_a_calibration_of_turned_images(drive: Make) -> None:
    folder = drive(frames=FEW)

    def turned(text: str) -> str:
        text = text.replace("image_width: 640", "image_width: 480")
        return text.replace("image_height: 480", "image_height: 640")

    change_calibration(folder, turned)
    found = inspect_recording(folder)
    assert not found.builds
    assert codes(found, Severity.ERROR) == {"image-size"}
    assert finding(found, "image-size")[0].endswith("the calibration is for 480 x 640 px.")


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda image: (image * 0.05).astype(np.uint8), "images-dark"),
        (lambda image: np.minimum(image * 3.0, 255.0).astype(np.uint8), "images-saturated"),
        (lambda image: cv2.GaussianBlur(image, (0, 0), 2.5), "images-blurred"),
        pytest.param(
            lambda image: cv2.blur(image, (15, 1)), "images-blurred", marks=pytest.mark.long
        ),
        (lambda image: np.full_like(image, 128), "images-plain"),
    ],
)
def test_images_that_show_little(drive: Make, change: Callable[[Image], Image], code: str) -> None:
    folder = drive(frames=FEW)
    rewrite_images(folder, change, "left", "right")
    found = inspect_recording(folder)
    exposure = {"images-dark", "images-saturated", "images-blurred", "images-plain"}
    assert serious(found) & exposure == {code}


def test_one_camera_that_is_darker(drive: Make) -> None:
    folder = drive(frames=FEW)
    rewrite_images(folder, lambda image: (image * 0.6).astype(np.uint8), "right")
    assert serious(inspect_recording(folder)) == {"exposure-differs"}


# --- files


def test_a_truncated_image(drive: Make) -> None:
    folder = drive(frames=FEW)
    path = folder / "left" / "000009.jpg"
    data = path.read_bytes()
    path.unlink()
    path.write_bytes(data[: len(data) // 2])
    found = inspect_recording(folder)
    assert not found.builds
    assert codes(found, Severity.ERROR) == {"images-unreadable"}
    message, _ = finding(found, "images-unreadable")
    assert message.startswith("1 of 8 examined frames")
    assert "000009.jpg is truncated" in message


def test_an_image_of_absurd_size(drive: Make) -> None:
    folder = drive(frames=FEW)
    path = folder / "right" / "000003.jpg"
    path.unlink()
    path.write_bytes(b"P5\n999999 999999\n255\n")
    found = inspect_recording(folder)
    assert codes(found, Severity.ERROR) == {"images-unreadable"}
    assert not found.builds


def test_images_that_are_missing(drive: Make) -> None:
    folder = drive(frames=FEW)
    shutil.rmtree(folder / "left")
    found = inspect_recording(folder)
    assert not found.builds
    assert serious(found) == {"recording"}


@pytest.mark.parametrize("how", ["missing", "empty"])
def test_a_log_that_says_nothing(drive: Make, how: str) -> None:
    folder = drive(frames=FEW, imu=False)
    (folder / "gnss" / RTK).unlink()
    if how == "empty":
        (folder / "gnss" / RTK).touch()
    found = inspect_recording(folder)
    assert not found.builds
    assert "fixes" in codes(found, Severity.ERROR)


def test_nothing_there(tmp_path: Path) -> None:
    found = inspect_recording(tmp_path / "nowhere")
    assert [one.code for one in found.findings] == ["recording"]
    assert not found.builds
    assert found.as_dict()["findings"][0]["severity"] == "error"


def test_one_and_two_frames(drive: Make) -> None:
    for name, frames in (("one", [5]), ("two", [5, 6])):
        found = inspect_recording(drive(name, frames=frames))
        assert found.builds
        assert serious(found) <= {"frames-unusable"}
        assert found.frames == len(frames)


# --- rigs


def test_a_drive_that_does_not_say_how_its_camera_is_mounted(drive: Make) -> None:
    """Everything else of it is shown."""
    folder = drive(frames=FEW)
    (folder / "calibration" / "mounting.json").unlink()
    found = inspect_recording(folder)
    assert not found.builds
    assert serious(found) == {"calibration"}
    assert "fieldgrid mount" in finding(found, "calibration")[1]
    assert {stream.role for stream in found.streams} >= {"left", "right", "fix"}
    assert found.rig is None
    assert (found.frames, found.frames_usable) == (None, None)


def test_all_that_a_drive_lacks_is_found_at_once(drive: Make) -> None:
    folder = drive(frames=FEW)
    shutil.rmtree(folder / "calibration")
    shutil.rmtree(folder / "gnss")
    found = inspect_recording(folder)
    assert not found.builds
    lacking = [one for one in found.findings if one.code in ("calibration", "recording", "fixes")]
    said = [f"{one.message} {one.remedy}" for one in lacking]
    for sentence, wanted in zip(said, ("stereo_opencv", "mounting.json", "--gnss"), strict=True):
        assert wanted in sentence


def test_a_forgotten_lever_arm(drive: Make) -> None:
    folder = drive(frames=FEW)
    change_mounting(folder, gnss_antenna_from_camera_mid_flu_m=[0, 0, 0])
    # The gyro of the turn, where these frames are, contradicts it: poses are refused there.
    found = inspect_recording(folder)
    assert serious(found) == {"lever-arm-zero", "antenna-place"}
    change_mounting(folder, gnss_antenna_from_camera_mid_flu_m=None)
    found = inspect_recording(folder)
    assert not found.builds
    assert serious(found) == {"calibration"}
    assert "gnss_antenna_from_camera_mid_flu_m" in finding(found, "calibration")[0]


@pytest.mark.parametrize(
    ("key", "value", "code", "told"),
    [
        ("camera_height_above_ground_m", 3.2, "mounting-height", "2.6"),
        ("camera_tilt_down_deg", 20.0, "mounting-tilt", "16."),
        ("camera_roll_deg", 4.0, "mounting-roll", ""),
    ],
)
def test_a_mounting_that_is_not_this_one(
    drive: Make, key: str, value: float, code: str, told: str
) -> None:
    folder = drive(frames=FEW)
    change_mounting(folder, **{key: value})
    found = inspect_recording(folder)
    assert serious(found) == {code}
    message, remedy = finding(found, code)
    assert told in message
    assert key in remedy
    assert "fieldgrid mount" in remedy


def test_an_absurd_height(drive: Make) -> None:
    folder = drive(frames=FEW)
    change_mounting(folder, camera_height_above_ground_m=8.0)
    found = inspect_recording(folder)
    assert not found.builds
    assert {"camera-height", "no-ground", "nothing-in-view"} <= serious(found)


# --- beside a build


FAULTS = [
    "none",
    "swapped",
    "zone",
    "truncated",
    "height",
    pytest.param("gps", marks=pytest.mark.long),
    pytest.param("clock", marks=pytest.mark.long),
    "rows",
]
ACCEPTED = {
    "clock": "clock-offset",
    "gps": "clock-offset",
    "rows": "vertical-misalignment",
    "swapped": "cameras-swapped",
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_build_fails_where_the_inspection_says_so(
    drive: Make, tmp_path: Path, fault: str
) -> None:
    moved_s = {"zone": 3600.0, "gps": 15.0, "clock": 2.0}.get(fault, 0.0)
    # Neighbours: their steps tell the clock.
    folder = drive(frames=range(24) if fault in ("gps", "clock") else FEW, moved_s=moved_s)
    if fault == "swapped":
        exchange(folder)
    if fault == "truncated":
        path = folder / "left" / "000012.jpg"
        path.unlink()
        path.write_bytes(b"\xff\xd8")
    if fault == "height":
        change_mounting(folder, camera_height_above_ground_m=8.0)
    if fault == "rows":
        rewrite_images(folder, lambda image: np.roll(image, 3, axis=0), "right")
    found = inspect_recording(folder)
    assert found.builds == (fault == "none")

    def build(*accept: str) -> SessionReport:
        settings = BuildSettings.model_validate({"checks": {"accept": accept}})
        (report,) = build_map([folder], tmp_path / "map.gpkg", settings, overwrite=True)
        return report

    if fault == "none":
        assert not [note for note in build().notes if "Accepted" in note]
        return
    code = ACCEPTED.get(fault)
    hint = rf" To build nevertheless, give --accept {code}\.$" if code else None
    with pytest.raises(FieldgridError, match=hint):
        build()
    assert not (tmp_path / "map.gpkg").exists()
    if fault in ("clock", "rows"):  # of the others no frame is of use
        assert [note for note in build(str(code)).notes if f"Accepted {code}: " in note]
        with open_map(tmp_path / "map.gpkg") as universal:
            (session,) = universal.sessions()
            kept = session.config["settings"]["checks"]
        assert kept == {"accept": [code]}
    if fault == "clock":  # poses that are estimated again stop at nothing that was accepted
        (again,) = repose_map(tmp_path / "map.gpkg")
        told = [one.severity for one in again.findings if one.code == code]
        assert told == [Severity.WARNING]


# --- the camera beside the drive


def test_a_longitude_without_its_minus_stops_a_build(drive: Make) -> None:
    """A smooth drive, but mirrored: gyro and camera are all that tell."""
    folder = drive()
    fixes_as_table(folder, 0.0)
    table = folder / "gnss" / "fixes.csv"
    table.write_text(table.read_text().replace(",-4.7", ",4.7"))
    found = inspect_recording(folder)
    assert not found.builds
    assert codes(found, Severity.ERROR) == {"mirrored"}
    message, remedy = finding(found, "mirrored")
    assert "with left and right exchanged, and the gyro turns as the camera does" in message
    assert "longitude 4.72" in remedy or "longitude 4.72" in message


def test_a_camera_that_looks_aside_stops_a_build(drive: Make) -> None:
    folder = drive()
    change_mounting(folder, camera_yaw_deg=3.0)
    found = inspect_recording(folder)
    assert not found.builds
    assert serious(found) == {"camera-yaw"}
    message, remedy = finding(found, "camera-yaw")
    assert "3.0° ± 0.1° farther left than declared" in message
    assert "`fieldgrid mount --write`" in remedy


def test_an_imu_that_is_mounted_sideways_is_left_out(drive: Make) -> None:
    """Its turns are right, and it takes rolling for pitching; the axes that are told mend it."""
    folder = drive()
    change_mounting(folder, imu_axes="lbu")
    found = inspect_recording(folder)
    assert found.builds
    assert serious(found) == {"accelerometer-unused"}
    message = " ".join(finding(found, "accelerometer-unused"))
    assert "turned by about 90° to the right" in message
    assert "from flu to rfu" in message


def test_what_a_build_notes_of_the_poses_is_told(drive: Make) -> None:
    """An antenna that sits 0.9 m beside where it is declared."""
    folder = drive()
    change_mounting(folder, gnss_antenna_from_camera_mid_flu_m=[-0.45, -0.78, 0.35])
    found = inspect_recording(folder)
    assert serious(found) == {"antenna-place"}
    message, remedy = finding(found, "antenna-place")
    assert re.search(
        r"the antenna sits 0\.\d\d m ± 0\.\d\d m farther left than mounting\.json", message
    )
    assert remedy.startswith("Measure its place and correct it.")


def test_images_that_are_stamped_in_whole_seconds_stop_a_build(drive: Make) -> None:
    folder = drive()
    table = folder / "frames.csv"
    head, *rows = (line.split(",") for line in table.read_text().splitlines())
    for row in rows:
        row[1] = row[1].partition(".")[0]
    table.write_text("\n".join(",".join(row) for row in [head, *rows]) + "\n")
    found = inspect_recording(folder)
    assert not found.builds
    _, remedy = finding(found, "frames-misplaced")
    assert "stamped in whole seconds" in remedy


def test_images_in_another_order_than_their_stamps_stop_a_build(drive: Make) -> None:
    """As a program leaves them that sorts 10 before 2."""
    folder = drive()
    table = folder / "frames.csv"
    head, *rows = table.read_text().splitlines()
    as_text = sorted(range(len(rows)), key=str)
    mixed = [
        ",".join(row.split(",")[:3] + rows[k].split(",")[3:])
        for row, k in zip(rows, as_text, strict=True)
    ]
    table.write_text("\n".join([head, *mixed]) + "\n")
    found = inspect_recording(folder)
    assert not found.builds
    assert "frames-misplaced" in codes(found, Severity.ERROR)
    _, remedy = finding(found, "frames-misplaced")
    assert "frames.csv" in remedy
