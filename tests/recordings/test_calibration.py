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
from fieldgrid.recordings import DriveOptions, open_drive
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


def by_fisheye() -> Matrices:
    """The same for the lenses of a fisheye."""
    found = cv2.fisheye.stereoRectify(
        *(K1, np.array(FISH1), K2, np.array(FISH2), SIZE, R, T[:, None]), cv2.CALIB_ZERO_DISPARITY
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


def put(folder: Path, files: dict[str, str]) -> Path:
    """The folder with these files and no others."""
    for path in folder.iterdir():
        path.unlink()
    for name, text in files.items():
        (folder / name).write_text(text)
    return folder


def fails(
    folder: Path,
    match: str,
    rectified: bool | None = None,
    *,
    named: str | None = None,
    size: tuple[int, int] | None = None,
) -> None:
    with pytest.raises(CalibrationError, match=match) as caught:
        read_calibration(folder, named, rectified, size)
    assert "\n" not in str(caught.value)
    assert re.search(r"[;:] .*\.$", str(caught.value))


def added(P: Float64, *changes: tuple[int, int, float]) -> Float64:
    """A matrix with numbers added at rows and columns."""
    changed = P.copy()
    for row, column, by in changes:
        changed[row, column] += by
    return changed


CV, ROS_LEFT, ROS_RIGHT = (
    *("stereo_opencv.yaml", "stereo_left_camera_info.yaml"),
    "stereo_right_camera_info.yaml",
)
M = by_opencv(D1, D2)
WIDER = Matrices(*M[:2], *(added(P * 0.9, (2, 2, 0.1), (0, 2, 3), (1, 2, -2)) for P in M[2:]))
RATIONAL = [0.1, -0.05, 0.001, 0.0005, 0.01, 0.2, -0.03, 0.005]
FISHEYE = [{"distortion_model": "equidistant", "distortion_coeffs": D} for D in (FISH1, FISH2)]


def ros_pair(left: str = ROS_LEFT, right: str = ROS_RIGHT, **changes: Any) -> dict[str, str]:
    return {left: ros(K1, D1, M.R1, M.P1, **changes), right: ros(K2, D2, M.R2, M.P2)}


RAW: dict[str, tuple[dict[str, str], tuple[list[float], ...], Matrices]] = {
    "opencv": ({CV: opencv()}, (D1, D2), M),
    "prescribed": ({CV: opencv(**WIDER._asdict())}, (D1, D2), WIDER),
    "rational": (
        {CV: opencv(D1=RATIONAL, D2=RATIONAL)},
        (RATIONAL, RATIONAL),
        by_opencv(RATIONAL, RATIONAL),
    ),
    "fisheye": (
        {CV: opencv(D1=FISH1, D2=FISH2, distortion_model="fisheye")},
        (FISH1, FISH2),
        by_fisheye(),
    ),
    "ros": (ros_pair(), (D1, D2), M),
    "calibrator": (ros_pair("left.yaml", "right.yaml"), (D1, D2), M),
    "kalibr": ({"june-camchain.yaml": kalibr()}, (D1[:4], D2[:4]), by_opencv(D1[:4], D2[:4])),
    "equidistant": ({"camchain.yaml": kalibr(*FISHEYE)}, (FISH1, FISH2), by_fisheye()),
}


@pytest.mark.parametrize("name", RAW)
def test_raw_images_are_rectified_as_opencv_does(name: str, folder: Path) -> None:
    files, lenses, matrices = RAW[name]
    put(folder, files)
    file = next(iter(files))
    found = read_calibration(folder, rectified=False)
    check(found, lenses, matrices)
    assert found.notes == (f"The images are raw, and rectified by {file}.",)
    if name in ("prescribed", "ros", "calibrator"):  # which tell how rectified ones look, too
        for rectified in (None, True):
            if rectified and name != "prescribed":
                continue  # their rotations say that they are not
            found = read_calibration(folder, rectified=rectified)
            assert found.rectifier is None
            assert found.camera.focal_px == pytest.approx(matrices.P1[0, 0])
            # A remark only where nobody has said it.
            assert ("if they are raw, say so" in "".join(found.notes)) == (rectified is None)
    else:
        check(read_calibration(folder), lenses, matrices)


def test_the_two_files_of_opencvs_own_program(folder: Path) -> None:
    """They call the matrices of the lenses M1 and M2, and do not say the size of the images."""
    expected = read_calibration(put(folder, {CV: opencv(**M._asdict())})).camera

    def sizeless(text: str) -> str:
        return "\n".join(line for line in text.splitlines() if not line.startswith("image_"))

    lenses = sizeless(opencv(K1=None, K2=None, R=None, T=None, M1=K1, M2=K2))
    places = sizeless(opencv(K1=None, D1=None, K2=None, D2=None, **M._asdict()))
    fails(put(folder, {"intrinsics.yml": lenses}), r"extrinsics\.yml cannot be read")
    fails(put(folder, {"extrinsics.yml": places}), r"of extrinsics\.yml, name the one with both")
    put(folder, {"intrinsics.yml": lenses, "extrinsics.yml": places})
    fails(folder, "the size of its images is .None, None.; give image_width")
    for named in (None, "intrinsics.yml"):
        check(read_calibration(folder, named, False, SIZE), (D1, D2), M)
        found = read_calibration(folder, named, None, SIZE)
        assert found.camera == expected
        assert found.notes[0].startswith("intrinsics.yml with extrinsics.yml describes how to")
        assert found.notes[1].endswith("that of the first one is taken, 320 x 240 px.")
    for other in ((640, 480), (160, 120)):
        fails(folder, "158, 121 px, is not that of images of", False, size=other)


@pytest.mark.parametrize(
    "left_out", [("R", "T"), ("K1", "D1", "K2", "D2", "R", "T", "R1", "R2")], ids=["lenses", "P"]
)
def test_a_whole_file_called_intrinsics(left_out: tuple[str, ...], folder: Path) -> None:
    """With P1 and P2 it needs no second file."""
    put(folder, {"stereo_intrinsics.yaml": opencv(**M._asdict() | dict.fromkeys(left_out))})
    found = read_calibration(folder, "stereo_intrinsics.yaml", True)
    assert found.camera.focal_px == pytest.approx(M.P1[0, 0])


STRAIGHT_K = np.array([[300.0, 0, 160], [0, 300, 120], [0, 0, 1]])
STRAIGHT_P = np.hstack([STRAIGHT_K, np.zeros((3, 1))])
ASIDE_P = added(STRAIGHT_P, (0, 2, -2), (0, 3, -60))
STRAIGHT = {"K1": STRAIGHT_K, "K2": STRAIGHT_K, "D1": [0.0] * 5, "D2": [0.0] * 5}
STRAIGHT |= {"R": np.eye(3), "T": [-0.2, 0, 0]}
NO_LENS = {"distortion_model": "none", "distortion_coeffs": [], "intrinsics": [300, 300, 160, 120]}
PLACED = np.vstack([np.column_stack([np.eye(3), [-0.2, 0, 0]]), [0, 0, 0, 1]]).tolist()


@pytest.mark.parametrize(
    ("files", "offset_px"),
    [
        ({CV: opencv(**STRAIGHT)}, 0.0),
        ({CV: opencv(**STRAIGHT, P1=STRAIGHT_P, P2=ASIDE_P)}, 2.0),
        (
            {
                ROS_LEFT: ros(STRAIGHT_K, [0.0] * 5, np.eye(3), STRAIGHT_P),
                ROS_RIGHT: ros(STRAIGHT_K, [0.0] * 5, np.eye(3), ASIDE_P),
            },
            2.0,
        ),
        ({"camchain.yaml": kalibr(NO_LENS, {**NO_LENS, "T_cn_cnm1": PLACED})}, 0.0),
    ],
)
def test_a_pair_that_is_rectified(files: dict[str, str], offset_px: float, folder: Path) -> None:
    put(folder, files)
    for rectified in (None, True):
        found = read_calibration(folder, rectified=rectified)
        assert (found.rectifier, found.notes) == (None, ())
        assert found.camera.baseline_m == pytest.approx(0.2)
        assert found.camera.disparity_offset_px == offset_px


def test_which_file_is_read(folder: Path) -> None:
    """OpenCV's and ROS's before all others, of which one is named or there is only one."""
    put(folder, {CV: opencv(), "camchain.yaml": "nothing", "left.yaml": "", "right.yaml": ""})
    assert read_calibration(folder).notes[0].endswith(f"by {CV}.")
    names = "camchain-1.yaml", "2-camchain.yaml"  # Kalibr puts the name of the bag before its own
    put(folder, dict.fromkeys(names, kalibr()))
    fails(folder, r"kind: 2-camchain\.yaml, camchain-1\.yaml; name one in recording\.toml")
    for name in names:
        assert read_calibration(folder, name).notes[0].endswith(f"by {name}.")
    (folder.parent / "raw.yml").write_text(opencv())
    check(read_calibration(folder, "raw.yml"), (D1, D2), M)
    put(folder, ros_pair("raw_left.yaml", "raw_right.yaml"))
    check(read_calibration(folder, "raw_left.yaml", False), (D1, D2), M)
    fails(folder, "name that of the left one", False, named="raw_right.yaml")
    fails(folder, r"none\.yaml cannot be read", named="none.yaml")
    put(folder, {"left.yaml": ros_pair()[ROS_LEFT]})
    fails(folder, r'of left\.yaml, name .*: calibration = "\.\.\."')
    put(folder, {ROS_LEFT: ros_pair()[ROS_LEFT]})
    fails(folder, "stereo_right_camera_info.yaml cannot be read: No such file")
    (folder / ROS_RIGHT).write_text(ros(K2, D2, M.R2, M.P2 * [1, 1, 1, 1.01]))
    (folder / CV).write_text(opencv(**M._asdict()))
    fails(folder, r"disagree in f·b, [\d.]+ and [\d.]+ px·m; remove the one")


TURNED = {**M._asdict(), "P1": None, "P2": None}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"D2": None}, "lacks D2 as numbers"),
        ({"T": [0.1, 0.2]}, "lacks T as 3 x 1 numbers"),
        ({"T": "\n   data: [a, 0, 0]"}, "lacks T as 3 x 1 numbers"),
        ({"T": [float("nan"), 0, 0]}, "lacks T as 3 x 1 numbers"),
        ({"T": [0.18, 0, 0]}, "swap left and right"),
        ({"T": [-180, 0, 0]}, "m apart, which is outside"),
        ({"T": T / 0.01}, "give the translation in metres"),
        ({"D1": FISH1}, "has 4 distortion coefficients and does not name"),
        ({"D1": [0.1] * 6}, "has 6 distortion coefficients and does not name their model"),
        ({"D1": [0.1] * 5, "distortion_model": "rational"}, "rational has 8 or 12 or 14"),
        ({"distortion_model": "fov"}, "distortion model 'fov' is not known"),
        ({"R1": np.eye(3)}, "lacks R2 as 3 x 3 numbers"),
        ({"K1": np.diag([1e8, 1e8, 1.0])}, "does not fit images of 320 x 240 px"),
        (TURNED, "lacks P1 as 3 x 4 numbers"),
        ({"P1": M.P1}, "lacks R1 as 3 x 3 numbers"),
    ],
)
def test_an_opencv_file_of_a_raw_pair_that_cannot_be(
    changes: dict[str, Any], message: str, folder: Path
) -> None:
    text = opencv(**changes)
    fails(put(folder, {CV: text}), rf"stereo_opencv\.yaml.*{message}", False)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"P2": None}, "lacks P2 as 3 x 4 numbers"),
        ({"P1": [1, 2, 3]}, "lacks P1 as 3 x 4 numbers"),
        ({"P1": np.zeros(12)}, "not calibrated"),
        ({"P1": added(STRAIGHT_P, (1, 1, 3))}, r"fx = 300\.0 and fy = 303\.0 px differ"),
        ({"P2": added(STRAIGHT_P, (0, 3, -60), (1, 2, 2))}, "do not share focal length and rows"),
        ({"P2": added(STRAIGHT_P, (0, 0, 6), (1, 1, 6))}, "do not share focal length and rows"),
        ({"P2": added(STRAIGHT_P, (1, 3, -60))}, "do not share focal length and rows"),
        ({"P2": added(STRAIGHT_P, (0, 3, 60))}, r"baseline of -0\.2 m"),
        ({"P2": added(STRAIGHT_P, (0, 3, -6e4))}, r"baseline of 200\.0 m"),
    ],
)
def test_projections_that_cannot_be(changes: dict[str, Any], message: str, folder: Path) -> None:
    text = opencv(**{**STRAIGHT, "P1": STRAIGHT_P, "P2": ASIDE_P, **changes})
    fails(put(folder, {CV: text}), rf"stereo_opencv\.yaml.*{message}")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no calibration"),
        ("a: [1, 2", "is not YAML"),
        ("a: !!python/object/apply:os.system ['true']", "is not YAML"),
        ("a: !!opencv-matrix 5", "is not YAML"),
        ("[" * 5000, "is not YAML"),
        ("image_width: wide\nimage_height: 480", "images is .'wide', 480.; give image_width"),
        (opencv(**STRAIGHT).replace("320", "0", 1), "images of 0 x 240 px"),
    ],
)
def test_a_calibration_file_that_is_none(text: str, message: str, folder: Path) -> None:
    fails(put(folder, {CV: text}), rf"stereo_opencv\.yaml.*{message}")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rectification_matrix": None}, "lacks rectification_matrix as 3 x 3 numbers"),
        ({"rectification_matrix": {"data": [0.0] * 9}}, "left camera is no rotation"),
        ({"distortion_coefficients": {"data": [float("nan")] * 5}}, "lacks distortion_coeff"),
        ({"image_width": 10**9}, r"is for images of \(1000000000, 240\) px"),
        ({"camera_matrix": {"data": [0.0] * 9}}, r"K\[0\] = 0 means that the camera was never"),
        ({"projection_matrix": {"data": [0.0] * 12}}, "not calibrated"),
    ],
)
def test_a_ros_file_that_cannot_be(changes: dict[str, Any], message: str, folder: Path) -> None:
    fails(put(folder, ros_pair(**changes)), rf"camera_info\.yaml.*{message}", rectified=False)


def test_rectified_pairs_have_no_rotation_to_rectify_them(folder: Path) -> None:
    put(folder, ros_pair(rectification_matrix={"data": numbers(np.eye(3))}))
    turn_deg = np.degrees(np.linalg.norm(cv2.Rodrigues(M.R2)[0]))
    said = rf"right_camera_info.*by {turn_deg:.2f} degrees.*leave `rectified` out"
    fails(folder, said, rectified=True)
    (folder / ROS_RIGHT).write_text(ros(K2, D2, np.eye(3), M.P2))
    assert read_calibration(folder, rectified=True).notes == ()


@pytest.mark.parametrize(
    ("left", "right", "message"),
    [
        ({"camera_model": "omni"}, {}, "camera_model of cam0 is 'omni', and only pinhole"),
        ({"distortion_coeffs": [0.1]}, {}, "plumb_bob has 4 or 5 coefficients"),
        ({"distortion_coeffs": "none"}, {}, "lacks distortion_coeffs"),
        ({"intrinsics": [300, 300, 160]}, {}, "lacks intrinsics as 4 numbers"),
        ({"resolution": [320]}, {}, r"size of its images is \[320\]; give"),
        ({"resolution": [320, True]}, {}, "the size of its images is"),
        ({"resolution": [640, 480]}, {}, "both must be of one size"),
        ({}, FISHEYE[0], "one lens is plumb_bob, the other equidistant"),
        ({}, {"T_cn_cnm1": [[1, 0, 0]] * 4}, "lacks T_cn_cnm1 as 4 x 4 numbers"),
        ({}, {"T_cn_cnm1": np.ones((2, 8)).tolist()}, "lacks T_cn_cnm1 as 4 x 4 numbers"),
        ({}, {"T_cn_cnm1": np.zeros((4, 4)).tolist()}, "between the cameras is no rotation"),
    ],
)
def test_a_kalibr_file_that_cannot_be(
    left: dict[str, Any], right: dict[str, Any], message: str, folder: Path
) -> None:
    fails(put(folder, {"camchain.yaml": kalibr(left, right)}), rf"camchain\.yaml.*{message}")


def test_kalibr_describes_both_cameras_and_raw_images(folder: Path) -> None:
    put(folder, {"camchain.yaml": "cam0: {camera_model: pinhole}\ncam1: 7\n"})
    fails(folder, r"camchain\.yaml has no cam1; calibrate both")
    put(folder, {"camchain.yaml": kalibr()})
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


def as_opencv(D_left: list[float] = D1, D_right: list[float] = D2) -> str:
    """The same rig."""
    aside = np.array([[0, 0, 170], [0, 0, 70], [0, 0, 0]])
    text = opencv(K1=K1 + aside, K2=K2 + aside, D1=D_left, D2=D_right)
    return text.replace(f"{SIZE[0]}", f"{VGA[0]}", 1).replace(f"{SIZE[1]}", f"{VGA[1]}", 1)


_KEYS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
# Newer ZEDs have sections of their own for the lenses.
DISTO = [f"{key} = {v}" for key, v in zip(_KEYS, RATIONAL, strict=True)]
NEWER_ZED = "\n".join([zed(), "[LEFT_DISTO]", *DISTO, "[RIGHT_DISTO]", *DISTO])
MAKERS_FILES = {
    "SN10028.conf": (zed(), as_opencv()),
    "SN1.conf": (NEWER_ZED, as_opencv(RATIONAL, RATIONAL)),
    "oak.json": (json.dumps(depthai()), as_opencv()),
    "oak-d.json": (json.dumps(depthai(turned=True, stereoRectificationData={})), as_opencv()),
}


@pytest.mark.parametrize("name", MAKERS_FILES)
def test_the_calibration_that_a_camera_holds(name: str, folder: Path) -> None:
    """It is that of the same rig as OpenCV's file says it."""
    text, same = MAKERS_FILES[name]
    expected = read_calibration(put(folder, {CV: same}))
    found = read_calibration(put(folder, {name: text}), None, False, VGA)
    assert found.notes == (f"The images are raw, and rectified by {name}.",)
    for key in ("focal_px", "cx_px", "cy_px", "baseline_m"):
        assert getattr(found.camera, key) == pytest.approx(getattr(expected.camera, key), rel=1e-9)
    assert np.abs(found.R_rect_left - expected.R_rect_left).max() < 1e-9
    image = np.random.default_rng(2).integers(0, 256, VGA[::-1], dtype=np.uint8)
    assert found.rectifier is not None
    assert expected.rectifier is not None
    images = found.rectifier(image, image), expected.rectifier(image, image)
    for one, other in zip(*images, strict=True):
        assert np.abs(one.astype(int) - other).max() <= 1
    fails(folder, r"add \[images\] rectified = false to recording.toml if these are raw", size=VGA)
    fails(folder, "recording.toml says rectified = true; give P1 and P2", True, size=VGA)


def test_images_of_an_oak_may_be_smaller_than_calibrated(folder: Path) -> None:
    """Scaled to the width, and cut above and below, as CalibrationHandler does it."""
    put(folder, {"oak.json": json.dumps(depthai(size=(1344, 800)))})
    found, whole = (read_calibration(folder, None, False, size).camera for size in (VGA, None))
    assert (found.width_px, found.height_px) == VGA
    assert (whole.width_px, whole.height_px) == (1344, 800)
    assert found.baseline_m == pytest.approx(whole.baseline_m)


def broken(**changes: Any) -> str:
    document = depthai()
    camera = document["cameraData"][1][1]
    camera |= {k: v for k, v in changes.items() if k in camera}
    camera["extrinsics"] |= {k: v for k, v in changes.items() if k in camera["extrinsics"]}
    return json.dumps(document)


NO_OAK = "is no calibration of an OAK camera"


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("SN1.conf", zed("HD"), r"lacks \[LEFT_CAM_VGA\] with the numbers FX FY"),
        ("SN1.conf", zed(Baseline="twelve"), r"lacks \[STEREO\] with the numbers BASELINE"),
        ("SN1.conf", zed(Baseline=-120.0), ".*swap left and right"),
        ("oak.json", '["cameraData"]', NO_OAK),
        ("oak.json", '{"cameraData"', "is not JSON"),
        ("oak.json", '{"cameraData": [[1]]}', NO_OAK),
        ("oak.json", broken(intrinsicMatrix=[]), "lacks intrinsicMatrix as 3 x 3 numbers"),
        ("oak.json", broken(width=0), NO_OAK),
        ("oak.json", broken(distortionCoeff=[0.1] * 6), "has 6 distortion coefficients"),
        ("oak.json", broken(toCameraSocket=0), "does not say how its left and right camera stand"),
        ("oak.json", broken(translation={"x": -18.0}), NO_OAK),
    ],
)
def test_a_calibration_of_a_camera_that_cannot_be(
    name: str, text: str, message: str, folder: Path
) -> None:
    fails(put(folder, {name: text}), rf"^\S*/{re.escape(name)}:? {message}", False, size=VGA)


def test_which_file_of_a_camera_is_read(folder: Path) -> None:
    put(folder, {"notes.json": "{}"})
    fails(folder, "neither stereo_opencv.yaml nor .*; put the calibration of the pair there")
    put(folder, {"notes.json": "{}", **dict.fromkeys(("a.json", "b.json"), json.dumps(depthai()))})
    fails(folder, r"several calibrations of one kind: a\.json, b\.json; name one", False)
    found = read_calibration(folder, "b.json", False)
    assert found.notes == ("The images are raw, and rectified by b.json.",)
    put(folder, {"SN1.conf": zed()})
    fails(folder, "and these have an unknown size; write the calibration", False)
    fails(folder, r"and these have \(320, 240\); write", False, size=SIZE)


def test_a_recording_has_the_size_of_its_images(folder: Path) -> None:
    """Of which a ZED's calibration is one; they may lie in one folder, as its SDK exports them."""
    drive = folder.parent
    for side in ("left", "right"):
        assert cv2.imwrite(str(drive / f"{side}0.png"), np.zeros(VGA[::-1], dtype=np.uint8))
    row = "frame_id,time_ns,left,right\n0,1308133815000000000,left0.png,right0.png\n"
    (drive / "frames.csv").write_text(row)
    (drive / "recording.toml").write_text("[images]\nrectified = false\n")
    put(folder, {"SN1.conf": zed()})
    with open_drive(drive, DriveOptions(unmounted=True)) as found:
        recording = found.recording()
        assert recording.rig.camera.baseline_m == pytest.approx(float(np.linalg.norm(T)))
        assert next(recording.frames()).images()[0].shape == VGA[::-1]


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
    images = by_cv.rectifier(image, image), by_ros.rectifier(image, image)
    for ours, theirs in zip(*images, strict=True):
        assert np.abs(ours.astype(int) - theirs).max() <= 1
