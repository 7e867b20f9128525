"""Calibrations of raw pairs: OpenCV's, ROS's and Kalibr's files of one rig say the same."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt
import pytest
import yaml

from fieldgrid.core import CalibrationError
from fieldgrid.recordings import open_recording
from fieldgrid.recordings.calibration.loading import Calibration, read_calibration

Float64 = npt.NDArray[np.float64]

SIZE = (320, 240)
K1 = np.array([[300.0, 0, 158], [0, 302, 121], [0, 0, 1]])
K2 = np.array([[305.0, 0, 161], [0, 304, 118], [0, 0, 1]])
D1, D2 = [-0.15, 0.06, 0.0006, -0.0004, 0.0], [-0.16, 0.07, -0.0005, 0.0007, 0.01]
FISH1, FISH2 = [0.02, -0.01, 0.003, -0.001], [0.01, -0.02, 0.004, 0.0]
R, _ = cv2.Rodrigues(np.array([0.01, -0.014, 0.007]))
T = np.array([-0.18, -0.0008, -0.0014])
IMAGE = np.random.default_rng(2).integers(0, 256, SIZE[::-1], dtype=np.uint8)


def numbers(values: Any) -> list[float]:
    return [float(v) for v in np.asarray(values, dtype=np.float64).ravel()]


def opencv(**changes: Any) -> str:
    entries = {"K1": K1, "D1": D1, "K2": K2, "D2": D2, "R": R, "T": T, **changes}
    lines = ["%YAML:1.0", "---", f"image_width: {SIZE[0]}", f"image_height: {SIZE[1]}"]
    for key, value in entries.items():
        if isinstance(value, str):
            lines.append(f"{key}: {value}")
        elif value is not None:
            lines += [f"{key}: !!opencv-matrix", f"   data: {numbers(value)}"]
    return "\n".join(lines)


def ros(K: Float64, D: list[float], turn: Float64, P: Float64, **changes: Any) -> str:
    matrices = {
        "camera_matrix": K,
        "distortion_coefficients": D,
        "rectification_matrix": turn,
        "projection_matrix": P,
    }
    document: dict[str, Any] = {k: {"data": numbers(v)} for k, v in matrices.items()}
    document |= {"image_width": SIZE[0], "image_height": SIZE[1], "distortion_model": "plumb_bob"}
    return yaml.safe_dump({**document, **changes})


def kalibr(left: dict[str, Any] | None = None, right: dict[str, Any] | None = None) -> str:
    cameras = []
    for K, D in ((K1, D1[:4]), (K2, D2[:4])):
        intrinsics = numbers([K[0, 0], K[1, 1], K[0, 2], K[1, 2]])
        cameras.append(
            {
                "camera_model": "pinhole",
                "distortion_coeffs": D,
                "distortion_model": "radtan",
                "intrinsics": intrinsics,
                "resolution": list(SIZE),
                "rostopic": "/cam/image_raw",
            }
        )
    T_cn_cnm1 = np.vstack([np.column_stack([R, T]), [0, 0, 0, 1]])
    cameras[1]["T_cn_cnm1"] = T_cn_cnm1.tolist()
    document = {"cam0": {**cameras[0], **(left or {})}, "cam1": {**cameras[1], **(right or {})}}
    # Of a list that stands twice PyYAML would write an alias.
    return yaml.safe_dump(json.loads(json.dumps(document)))


class Matrices(NamedTuple):
    """What prescribes how to rectify."""

    R1: Float64
    R2: Float64
    P1: Float64
    P2: Float64


def by_opencv(D_left: list[float], D_right: list[float]) -> Matrices:
    """The matrices as OpenCV itself finds them."""
    found = cv2.stereoRectify(
        *(K1, np.array(D_left), K2, np.array(D_right), SIZE, R, T[:, None]),
        flags=cv2.CALIB_ZERO_DISPARITY,
        alpha=0,
    )
    return Matrices(*found[:4])


def check(found: Calibration, D: tuple[list[float], ...], m: Matrices) -> None:
    """The camera and the images are those of OpenCV's own functions for these matrices."""
    camera = found.camera
    assert (camera.width_px, camera.height_px) == SIZE
    expected = (m.P1[0, 0], m.P1[0, 2], m.P1[1, 2], -m.P2[0, 3] / m.P2[0, 0])
    got = (camera.focal_px, camera.cx_px, camera.cy_px, camera.baseline_m)
    assert got == pytest.approx(expected, rel=1e-12)
    assert found.rectifier is not None
    images = found.rectifier(IMAGE, IMAGE)
    for image, K, lens, turn, P in zip(images, (K1, K2), D, m[:2], m[2:], strict=True):
        make = cv2.fisheye if len(lens) == 4 and lens in (FISH1, FISH2) else cv2
        maps = make.initUndistortRectifyMap(
            K, np.array(lens), turn, P[:, :3].copy(), SIZE, cv2.CV_32FC1
        )
        assert (image == cv2.remap(IMAGE, *maps, cv2.INTER_LINEAR)).all()


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    calibration = tmp_path / "calibration"
    calibration.mkdir()
    return calibration


@pytest.mark.parametrize("rectified", [None, False])
def test_opencv_by_the_places_of_the_cameras(rectified: bool | None, folder: Path) -> None:
    (folder / "stereo_opencv.yaml").write_text(opencv())
    found = read_calibration(folder, rectified=rectified)
    check(found, (D1, D2), by_opencv(D1, D2))
    assert found.notes == ("The images are raw, and rectified by stereo_opencv.yaml.",)


def test_opencv_as_the_file_prescribes(folder: Path) -> None:
    m = by_opencv(D1, D2)
    wider = [P.copy() for P in m[2:]]
    for P in wider:
        P[:2] *= 0.9
        P[:2, 2] += (3.0, -2.0)
    given = {"R1": m.R1, "R2": m.R2, "P1": wider[0], "P2": wider[1]}
    (folder / "stereo_opencv.yaml").write_text(opencv(**given))
    check(read_calibration(folder, rectified=False), (D1, D2), Matrices(m.R1, m.R2, *wider))
    for rectified in (None, True):
        found = read_calibration(folder, rectified=rectified)
        assert found.rectifier is None
        assert found.camera.focal_px == pytest.approx(0.9 * m.P1[0, 0])
        # A remark only where nobody has said it.
        assert ("if they are raw, say so" in "".join(found.notes)) == (rectified is None)


def test_the_two_files_of_opencvs_own_program(folder: Path) -> None:
    """They call the matrices of the lenses M1 and M2, and do not say the size of the images."""
    m = by_opencv(D1, D2)
    whole = opencv(R1=m.R1, R2=m.R2, P1=m.P1, P2=m.P2)
    (folder / "stereo_opencv.yaml").write_text(whole)
    expected = read_calibration(folder).camera
    (folder / "stereo_opencv.yaml").unlink()
    lenses = opencv(K1=None, K2=None, R=None, T=None, M1=K1, M2=K2).splitlines()
    lenses = [line for line in lenses if not line.startswith("image_")]
    (folder / "intrinsics.yml").write_text("\n".join(lenses))
    fails(folder, r"extrinsics\.yml cannot be read")
    places = opencv(K1=None, D1=None, K2=None, D2=None, R1=m.R1, R2=m.R2, P1=m.P1, P2=m.P2)
    places_lines = [line for line in places.splitlines() if not line.startswith("image_")]
    (folder / "extrinsics.yml").write_text("\n".join(places_lines))
    fails(folder, "the size of its images is .None, None.; give image_width")
    for named in (None, "intrinsics.yml"):
        check(read_calibration(folder, named, False, SIZE), (D1, D2), m)
        found = read_calibration(folder, named, None, SIZE)
        assert found.camera == expected
        assert found.notes[0].startswith("intrinsics.yml with extrinsics.yml describes how to")
        assert found.notes[1].endswith("that of the first one is taken, 320 x 240 px.")
    for other in ((640, 480), (160, 120)):
        with pytest.raises(CalibrationError, match="158, 121 px, is not that of images of"):
            read_calibration(folder, None, False, other)
    (folder / "intrinsics.yml").unlink()
    fails(folder, r"of extrinsics\.yml, name the one with both cameras")


@pytest.mark.parametrize(
    "left_out", [("R", "T"), ("K1", "D1", "K2", "D2", "R", "T", "R1", "R2")], ids=["lenses", "P"]
)
def test_a_whole_file_called_intrinsics(left_out: tuple[str, ...], folder: Path) -> None:
    """With P1 and P2 it needs no second file."""
    given = by_opencv(D1, D2)._asdict() | dict.fromkeys(left_out)
    (folder / "stereo_intrinsics.yaml").write_text(opencv(**given))
    found = read_calibration(folder, "stereo_intrinsics.yaml", True)
    assert found.camera.focal_px == pytest.approx(by_opencv(D1, D2).P1[0, 0])


def test_a_calibration_in_squares_of_the_board_is_refused(folder: Path) -> None:
    (folder / "stereo_opencv.yaml").write_text(opencv(T=T / 0.01))
    fails(folder, "give the translation in metres", rectified=False)


def test_a_fisheye_of_opencv_must_be_named(folder: Path) -> None:
    path = folder / "stereo_opencv.yaml"
    path.write_text(opencv(D1=FISH1, D2=FISH2))
    with pytest.raises(CalibrationError, match="has 4 distortion coefficients and does not name"):
        read_calibration(folder)
    path.write_text(opencv(D1=FISH1, D2=FISH2, distortion_model="fisheye"))
    matrices = cv2.fisheye.stereoRectify(
        *(K1, np.array(FISH1), K2, np.array(FISH2), SIZE, R, T[:, None]), cv2.CALIB_ZERO_DISPARITY
    )[:4]
    check(read_calibration(folder), (FISH1, FISH2), Matrices(*matrices))


def test_rational_coefficients_of_opencv(folder: Path) -> None:
    D = [0.1, -0.05, 0.001, 0.0005, 0.01, 0.2, -0.03, 0.005]
    (folder / "stereo_opencv.yaml").write_text(opencv(D1=D, D2=D))
    check(read_calibration(folder), (D, D), by_opencv(D, D))


def test_ros_files_of_raw_images(folder: Path) -> None:
    m = by_opencv(D1, D2)
    (folder / "stereo_left_camera_info.yaml").write_text(ros(K1, D1, m.R1, m.P1))
    (folder / "stereo_right_camera_info.yaml").write_text(ros(K2, D2, m.R2, m.P2))
    check(read_calibration(folder, rectified=False), (D1, D2), m)
    as_rectified = read_calibration(folder)
    assert as_rectified.rectifier is None
    assert "taken as rectified" in as_rectified.notes[0]


def test_ros_files_as_its_calibrator_calls_them(folder: Path) -> None:
    m = by_opencv(D1, D2)
    (folder / "left.yaml").write_text(ros(K1, D1, m.R1, m.P1))
    with pytest.raises(CalibrationError, match=r'of left\.yaml, name .*: calibration = "\.\.\."'):
        read_calibration(folder)
    (folder / "right.yaml").write_text(ros(K2, D2, m.R2, m.P2))
    check(read_calibration(folder, rectified=False), (D1, D2), m)
    (folder / "stereo_opencv.yaml").write_text(opencv())
    other = read_calibration(folder, rectified=False).notes
    assert other == ("The images are raw, and rectified by stereo_opencv.yaml.",)


def test_kalibr(folder: Path) -> None:
    # Kalibr puts the name of the bag before its own.
    (folder / "camchain-june.yaml").write_text(kalibr())
    (folder / "june-camchain.yaml").write_text(kalibr())
    with pytest.raises(CalibrationError, match=r"camchain-june\.yaml, june-camchain\.yaml; name"):
        read_calibration(folder)
    (folder / "camchain-june.yaml").unlink()
    found = read_calibration(folder)
    check(found, (D1[:4], D2[:4]), by_opencv(D1[:4], D2[:4]))
    assert found.notes == ("The images are raw, and rectified by june-camchain.yaml.",)


def test_kalibr_equidistant(folder: Path) -> None:
    lens = [{"distortion_model": "equidistant", "distortion_coeffs": D} for D in (FISH1, FISH2)]
    (folder / "camchain.yaml").write_text(kalibr(*lens))
    matrices = cv2.fisheye.stereoRectify(
        *(K1, np.array(FISH1), K2, np.array(FISH2), SIZE, R, T[:, None]), cv2.CALIB_ZERO_DISPARITY
    )[:4]
    check(read_calibration(folder), (FISH1, FISH2), Matrices(*matrices))


def test_kalibr_of_a_pair_that_is_rectified(folder: Path) -> None:
    straight = {
        "distortion_model": "none",
        "distortion_coeffs": [],
        "intrinsics": [300, 300, 160, 120],
    }
    T_cn_cnm1 = np.eye(4)
    T_cn_cnm1[0, 3] = -0.2
    (folder / "camchain.yaml").write_text(
        kalibr(straight, {**straight, "T_cn_cnm1": T_cn_cnm1.tolist()})
    )
    for rectified in (None, True, False):
        found = read_calibration(folder, rectified=rectified)
        assert found.rectifier is None
        assert found.notes == ()
        assert found.camera.baseline_m == pytest.approx(0.2)


def test_a_file_can_be_named_of_several(folder: Path) -> None:
    for name in ("camchain-1.yaml", "camchain-2.yaml"):
        (folder / name).write_text(kalibr())
    with pytest.raises(CalibrationError, match=r"camchain-1\.yaml, camchain-2\.yaml; name one in"):
        read_calibration(folder)
    by_kalibr = read_calibration(folder, "camchain-2.yaml")
    assert by_kalibr.notes[0].endswith("by camchain-2.yaml.")
    (folder.parent / "raw.yml").write_text(opencv(D1=[*D1[:4], 0.0], D2=[*D2[:4], 0.0]))
    by_cv = read_calibration(folder, "raw.yml")
    assert by_cv.camera.focal_px == pytest.approx(by_kalibr.camera.focal_px)
    m = by_opencv(D1, D2)
    (folder / "raw_left.yaml").write_text(ros(K1, D1, m.R1, m.P1))
    (folder / "raw_right.yaml").write_text(ros(K2, D2, m.R2, m.P2))
    check(read_calibration(folder, "raw_left.yaml", False), (D1, D2), m)
    with pytest.raises(CalibrationError, match="name that of the left one"):
        read_calibration(folder, "raw_right.yaml", False)
    with pytest.raises(CalibrationError, match=r"none\.yaml cannot be read"):
        read_calibration(folder, "none.yaml")


def test_kalibr_says_nothing_beside_the_others(folder: Path) -> None:
    (folder / "camchain.yaml").write_text("nothing")
    (folder / "stereo_opencv.yaml").write_text(opencv())
    assert read_calibration(folder).camera.baseline_m == pytest.approx(float(np.linalg.norm(T)))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"D2": None}, "lacks D2 as numbers"),
        ({"K1": None}, "lacks K1 as 3 x 3 numbers"),
        ({"R": None}, "lacks R as 3 x 3 numbers"),
        ({"T": [0.1, 0.2]}, "lacks T as 3 x 1 numbers"),
        ({"T": [0.18, 0, 0]}, "swap left and right"),
        ({"T": [-180, 0, 0]}, "m apart, which is outside"),
        ({"D1": [0.1] * 6}, "has 6 distortion coefficients and does not name their model"),
        ({"D1": [0.1] * 5, "distortion_model": "rational"}, "rational has 8 or 12 or 14"),
        ({"distortion_model": "fov"}, "distortion model 'fov' is not known"),
        ({"R1": np.eye(3)}, "lacks R2 as 3 x 3 numbers"),
        ({"K1": np.diag([1e8, 1e8, 1.0])}, "does not fit images of 320 x 240 px"),
    ],
)
def test_an_opencv_file_that_cannot_be(changes: dict[str, Any], message: str, folder: Path) -> None:
    (folder / "stereo_opencv.yaml").write_text(opencv(**changes))
    fails(folder, rf"stereo_opencv\.yaml.*{message}")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"distortion_model": "fov"}, "distortion model 'fov' is not known"),
        ({"distortion_model": "equidistant"}, "equidistant has 4 coefficients, not 5"),
        ({"rectification_matrix": None}, "lacks rectification_matrix as 3 x 3 numbers"),
        ({"rectification_matrix": {"data": [0.0] * 9}}, "left camera is no rotation"),
        ({"distortion_coefficients": {"data": [float("nan")] * 5}}, "lacks distortion_coeff"),
        ({"image_width": 10**9}, r"is for images of \(1000000000, 240\) px"),
        ({"projection_matrix": {"data": [0.0] * 12}}, "not calibrated"),
    ],
)
def test_a_ros_file_that_cannot_be(changes: dict[str, Any], message: str, folder: Path) -> None:
    m = by_opencv(D1, D2)
    (folder / "stereo_left_camera_info.yaml").write_text(ros(K1, D1, m.R1, m.P1, **changes))
    (folder / "stereo_right_camera_info.yaml").write_text(ros(K2, D2, m.R2, m.P2))
    fails(folder, rf"camera_info\.yaml.*{message}", rectified=False)


def test_rectified_pairs_have_no_rotation_to_rectify_them(folder: Path) -> None:
    m = by_opencv(D1, D2)
    left, right = (folder / f"stereo_{side}_camera_info.yaml" for side in ("left", "right"))
    left.write_text(ros(K1, D1, np.eye(3), m.P1))
    right.write_text(ros(K2, D2, m.R2, m.P2))
    turn_deg = np.degrees(np.linalg.norm(cv2.Rodrigues(m.R2)[0]))
    said = rf"right_camera_info.*by {turn_deg:.2f} degrees.*leave `rectified` out"
    fails(folder, said, rectified=True)
    assert "taken as rectified" in read_calibration(folder).notes[0]
    right.write_text(ros(K2, D2, np.eye(3), m.P2))
    assert read_calibration(folder, rectified=True).notes == ()


FISHEYE = {"distortion_model": "equidistant", "distortion_coeffs": FISH1}


@pytest.mark.parametrize(
    ("left", "right", "message"),
    [
        ({"camera_model": "omni"}, {}, "camera_model of cam0 is 'omni', and only pinhole"),
        ({"camera_model": None}, {}, "camera_model of cam0 is 'None', and only pinhole"),
        ({"distortion_model": "fov"}, {}, "cam0: the distortion model 'fov' is not known"),
        ({"distortion_coeffs": [0.1]}, {}, "plumb_bob has 4 or 5 coefficients, not 1"),
        ({"distortion_coeffs": "none"}, {}, "lacks distortion_coeffs"),
        ({"intrinsics": [300, 300, 160]}, {}, "lacks intrinsics as 4 numbers"),
        ({"intrinsics": [300, "x", 160, 2]}, {}, "lacks intrinsics"),
        ({"resolution": [320]}, {}, r"size of its images is \[320\]; give"),
        ({"resolution": [320, True]}, {}, "the size of its images is"),
        ({"resolution": [0, 0]}, {}, "both must be of one size"),
        ({"resolution": [640, 480]}, {}, "both must be of one size"),
        ({}, FISHEYE, "one lens is plumb_bob, the other equidistant"),
        ({}, {"T_cn_cnm1": None}, "lacks T_cn_cnm1 as 4 x 4 numbers"),
        ({}, {"T_cn_cnm1": [[1, 0, 0]] * 4}, "lacks T_cn_cnm1 as 4 x 4 numbers"),
        ({}, {"T_cn_cnm1": np.zeros((4, 4)).tolist()}, "between the cameras is no rotation"),
        ({}, {"T_cn_cnm1": np.eye(4).tolist()}, "m apart, which is outside"),
    ],
)
def test_a_kalibr_file_that_cannot_be(
    left: dict[str, Any], right: dict[str, Any], message: str, folder: Path
) -> None:
    (folder / "camchain.yaml").write_text(kalibr(left, right))
    fails(folder, rf"camchain\.yaml.*{message}")


def test_kalibr_describes_both_cameras_and_raw_images(folder: Path) -> None:
    (folder / "camchain.yaml").write_text("cam0: {camera_model: pinhole}\ncam1: 7\n")
    fails(folder, r"camchain\.yaml has no cam1; calibrate both")
    (folder / "camchain.yaml").write_text(kalibr())
    fails(folder, r"describes raw images, and recording\.toml says rectified = true", True)


# --- what cameras hold themselves

VGA = (672, 376)


def zed(resolution: str = "VGA", **stereo: Any) -> str:
    """As calib.stereolabs.com gives it, for images of 672 x 376 px and of another size."""
    turn = np.array([0.01, -0.014, 0.007])
    entries = {
        "Baseline": 1000 * -T[0],
        "TY": 1000 * T[1],
        "TZ": 1000 * T[2],
        **{f"RX_{resolution}": turn[0], f"CV_{resolution}": turn[1], f"RZ_{resolution}": turn[2]},
        **stereo,
    }
    lines = ["[STEREO]", *(f"{k}={v}" for k, v in entries.items() if v is not None)]
    for side, K, D in (("LEFT", K1, D1), ("RIGHT", K2, D2)):
        for name, factor in ((resolution, 1.0), ("HD", 2.0)):
            lines += ["", f"[{side}_CAM_{name}]"]
            values = (K[0, 0], K[1, 1], K[0, 2] + 170, K[1, 2] + 70)
            lines += [
                f"{k}={factor * v}" for k, v in zip(("fx", "fy", "cx", "cy"), values, strict=True)
            ]
            lines += [f"{k}={v}" for k, v in zip(("k1", "k2", "p1", "p2", "k3"), D, strict=True)]
    return "\r\n".join(lines) + "\r\n"


def depthai(*, size: tuple[int, int] = VGA, turned: bool = False, **changes: Any) -> dict[str, Any]:
    """As CalibrationHandler.eepromToJsonFile writes it, with a colour camera beside the pair."""

    def camera(K: Float64, D: list[float], to: int, R: Float64, T: Float64) -> dict[str, Any]:
        return {
            "cameraType": 0,
            "distortionCoeff": [*D, *[0.0] * (14 - len(D))],
            "extrinsics": {
                "rotationMatrix": R.tolist(),
                "specTranslation": {"x": 0.0, "y": 0.0, "z": 0.0},
                "toCameraSocket": to,
                "translation": dict(zip("xyz", (100 * T).tolist(), strict=True)),
            },
            "height": size[1],
            "width": size[0],
            "intrinsicMatrix": (K + np.array([[0, 0, 170], [0, 0, 70], [0, 0, 0]])).tolist(),
            "lensPosition": 0,
            "specHfovDeg": 71.86,
        }

    left = camera(K1, D1, 2, R, T)
    right = camera(K2, D2, 0, np.eye(3), np.zeros(3))
    if turned:
        left, right = camera(K1, D1, 0, np.eye(3), T), camera(K2, D2, 1, R.T, -R.T @ T)
    colour = camera(K1, D1, -1, np.zeros((0, 0)), np.zeros(3))
    return {
        "batchName": "",
        "boardName": "DM9098",
        "cameraData": [[0, colour], [1, left], [2, right]],
        "stereoRectificationData": {"leftCameraSocket": 1, "rightCameraSocket": 2},
        "version": 7,
        **changes,
    }


def as_opencv() -> str:
    """The same rig."""
    aside = np.array([[0, 0, 170], [0, 0, 70], [0, 0, 0]])
    text = opencv(K1=K1 + aside, K2=K2 + aside)
    return text.replace(f"{SIZE[0]}", f"{VGA[0]}", 1).replace(f"{SIZE[1]}", f"{VGA[1]}", 1)


MAKERS_FILES = {
    "SN10028.conf": zed(),
    "oak.json": json.dumps(depthai()),
    "oak-d.json": json.dumps(depthai(turned=True, stereoRectificationData={})),
}


@pytest.mark.parametrize("name", MAKERS_FILES)
def test_the_calibration_that_a_camera_holds(name: str, folder: Path) -> None:
    """It is that of the same rig as OpenCV's file says it."""
    (folder / "stereo_opencv.yaml").write_text(as_opencv())
    expected = read_calibration(folder)
    (folder / "stereo_opencv.yaml").unlink()
    (folder / name).write_text(MAKERS_FILES[name])
    found = read_calibration(folder, None, False, VGA)
    assert found.notes == (f"The images are raw, and rectified by {name}.",)
    for key in ("focal_px", "cx_px", "cy_px", "baseline_m"):
        assert getattr(found.camera, key) == pytest.approx(getattr(expected.camera, key), rel=1e-9)
    image = np.random.default_rng(2).integers(0, 256, VGA[::-1], dtype=np.uint8)
    assert found.rectifier is not None
    assert expected.rectifier is not None
    for one, other in zip(
        found.rectifier(image, image), expected.rectifier(image, image), strict=True
    ):
        assert np.abs(one.astype(int) - other).max() <= 1
    fails(folder, r"add \[images\] rectified = false to recording.toml if these are raw", size=VGA)
    fails(folder, "recording.toml says rectified = true; give P1 and P2", True, size=VGA)


def test_the_lenses_of_a_newer_zed_have_sections_of_their_own(folder: Path) -> None:
    lens = {"k1": 0.1, "k2": -0.05, "p1": 0.001, "p2": 0.0005, "k3": 0.01, "k4": 0.2, "k5": -0.03}
    lines = [f"{key} = {value}" for key, value in {**lens, "k6": 0.005}.items()]
    sections = ["", "[LEFT_DISTO]", *lines, "[RIGHT_DISTO]", *lines]
    (folder / "SN1.conf").write_text(zed() + "\n".join(sections))
    found = read_calibration(folder, None, False, VGA)
    (folder / "SN1.conf").unlink()
    D = [*lens.values(), 0.005]
    aside = np.array([[0, 0, 170], [0, 0, 70], [0, 0, 0]])
    text = opencv(K1=K1 + aside, K2=K2 + aside, D1=D, D2=D)
    text = text.replace(f"{SIZE[0]}", f"{VGA[0]}", 1).replace(f"{SIZE[1]}", f"{VGA[1]}", 1)
    (folder / "stereo_opencv.yaml").write_text(text)
    expected = read_calibration(folder)
    assert found.camera.focal_px == pytest.approx(expected.camera.focal_px)
    assert np.abs(found.R_rect_left - expected.R_rect_left).max() < 1e-9


def test_images_of_an_oak_may_be_smaller_than_calibrated(folder: Path) -> None:
    """Scaled to the width, and cut above and below, as CalibrationHandler does it."""
    (folder / "oak.json").write_text(json.dumps(depthai(size=(1344, 800))))
    found = read_calibration(folder, None, False, VGA).camera
    assert (found.width_px, found.height_px) == VGA
    whole = read_calibration(folder, None, False).camera
    assert (whole.width_px, whole.height_px) == (1344, 800)
    assert found.baseline_m == pytest.approx(whole.baseline_m)


def broken(**changes: Any) -> str:
    document = depthai()
    camera = document["cameraData"][1][1]
    camera |= {k: v for k, v in changes.items() if k in camera}
    camera["extrinsics"] |= {k: v for k, v in changes.items() if k in camera["extrinsics"]}
    return json.dumps(document)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("SN1.conf", zed("HD"), r"lacks \[LEFT_CAM_VGA\] with the numbers FX FY"),
        ("SN1.conf", zed(RX_VGA=None), r"lacks \[STEREO\] with the numbers RX_VGA"),
        ("SN1.conf", zed(Baseline=None), r"lacks \[STEREO\] with the numbers BASELINE"),
        ("SN1.conf", zed(Baseline="twelve"), r"lacks \[STEREO\] with the numbers BASELINE"),
        ("SN1.conf", zed(Baseline=-120.0), ".*swap left and right"),
        ("SN1.conf", "", r"lacks \[LEFT_CAM_VGA\] with the numbers FX FY CX CY"),
        ("oak.json", '["cameraData"]', "is no calibration of an OAK camera"),
        ("oak.json", '{"cameraData"', "is not JSON"),
        ("oak.json", '{"cameraData": [[1]]}', "is no calibration of an OAK camera"),
        ("oak.json", broken(intrinsicMatrix=[]), "lacks intrinsicMatrix as 3 x 3 numbers"),
        ("oak.json", broken(width=0), "is no calibration of an OAK camera"),
        ("oak.json", broken(distortionCoeff=[0.1] * 6), "has 6 distortion coefficients"),
        ("oak.json", broken(toCameraSocket=0), "does not say how its left and right camera stand"),
        ("oak.json", broken(translation={"x": -18.0}), "is no calibration of an OAK camera"),
    ],
)
def test_a_calibration_of_a_camera_that_cannot_be(
    name: str, text: str, message: str, folder: Path
) -> None:
    (folder / name).write_text(text)
    fails(folder, rf"^\S*/{re.escape(name)}:? {message}", False, size=VGA)


def test_other_files_beside_are_no_calibration(folder: Path) -> None:
    (folder / "notes.json").write_text("{}")
    fails(folder, "neither stereo_opencv.yaml nor .*; put the calibration of the pair there")
    for name in ("a.json", "b.json"):
        (folder / name).write_text(json.dumps(depthai()))
    fails(folder, r"several calibrations of one kind: a\.json, b\.json; name one", False)
    found = read_calibration(folder, "b.json", False)
    assert found.notes == ("The images are raw, and rectified by b.json.",)


def test_a_zed_must_be_of_a_known_size(folder: Path) -> None:
    (folder / "SN1.conf").write_text(zed())
    fails(folder, "and these have an unknown size; write the calibration", False)
    fails(folder, r"and these have \(320, 240\); write", False, size=SIZE)


@pytest.mark.parametrize("name", MAKERS_FILES)
def test_a_whole_recording_with_the_calibration_of_its_camera(name: str, folder: Path) -> None:
    """ZED's images in a folder of their own, as its SDK exports them, with a table of times."""
    drive = folder.parent
    rows = ["frame_id,time_ns,left,right"]
    for k in range(2):
        names = [f"{side}{k:06d}.png" for side in ("left", "right")]
        for file in names:
            image = np.random.default_rng(k).integers(0, 256, VGA[::-1], dtype=np.uint8)
            assert cv2.imwrite(str(drive / file), image)
        rows.append(f"{k},{(1_308_133_815 + k) * 10**9},{names[0]},{names[1]}")
    (drive / "frames.csv").write_text("\n".join(rows))
    (drive / "recording.toml").write_text("[images]\nrectified = false\n")
    mounting = {
        "camera_height_above_ground_m": 2.0,
        "camera_tilt_down_deg": 15.0,
        "gnss_antenna_from_camera_mid_flu_m": [0, 0, 1],
    }
    (folder / "mounting.json").write_text(json.dumps(mounting))
    (folder / "stereo_opencv.yaml").write_text(as_opencv())
    with open_recording(drive) as recording:
        expected = [frame.images() for frame in recording.frames()]
    (folder / "stereo_opencv.yaml").unlink()
    (folder / name).write_text(MAKERS_FILES[name])
    with open_recording(drive) as recording:
        found = [frame.images() for frame in recording.frames()]
        assert recording.rig.camera.baseline_m == pytest.approx(float(np.linalg.norm(T)))
    for pair, same in zip(found, expected, strict=True):
        for one, other in zip(pair, same, strict=True):
            assert np.abs(one.astype(int) - other).max() <= 1


def fails(
    folder: Path,
    match: str,
    rectified: bool | None = None,
    *,
    size: tuple[int, int] | None = None,
) -> None:
    with pytest.raises(CalibrationError, match=match) as caught:
        read_calibration(folder, None, rectified, size)
    assert "\n" not in str(caught.value)
    assert re.search(r"[;:] .*\.$", str(caught.value))


def test_the_vineyards_own_files_agree(shared_data: Callable[[str], Path]) -> None:
    folder = shared_data("vineyard_two_lanes") / "calibration"
    by_cv = read_calibration(folder, "stereo_raw_opencv.yaml", False)
    by_ros = read_calibration(folder, "stereo_raw_left_camera_info.yaml", False)
    as_rectified = read_calibration(folder)
    assert by_cv.camera == by_ros.camera
    assert by_cv.camera.focal_baseline_px_m == as_rectified.camera.focal_baseline_px_m
    assert as_rectified.rectifier is None
    image = np.random.default_rng(1).integers(0, 256, (480, 640), dtype=np.uint8)
    assert by_cv.rectifier is not None
    assert by_ros.rectifier is not None
    for ours, theirs in zip(
        by_cv.rectifier(image, image), by_ros.rectifier(image, image), strict=True
    ):
        assert np.abs(ours.astype(int) - theirs).max() <= 1
