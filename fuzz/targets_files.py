"""Files of sensors, settings and surveys: each is read, or refused in a sentence."""

from __future__ import annotations

import json
import struct
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import laspy
import numpy as np

from fieldgrid.core import FieldgridError, parse_json, parse_toml, resolve
from fieldgrid.field import read_survey, read_vehicle
from fieldgrid.geometry import Datum, read_shapes
from fieldgrid.maps import marks_of_geojson
from fieldgrid.recordings import CloudFile, read_gear_spans, read_mounting
from fieldgrid.recordings.calibration.depthai import read_depthai
from fieldgrid.recordings.calibration.kalibr import read_kalibr
from fieldgrid.recordings.calibration.opencv import read_opencv
from fieldgrid.recordings.calibration.ros import read_ros_camera
from fieldgrid.recordings.calibration.zed import read_zed
from fieldgrid.recordings.frames.depth_files import decode_depth_image
from fieldgrid.recordings.frames.image_header import read_header
from fieldgrid.recordings.frames.images import decode_image
from fieldgrid.recordings.frames.npy import parse_npy
from fieldgrid.recordings.poses.pose_files import read_pose_file
from fieldgrid.recordings.readers.settings_file import read_settings
from fuzz.target import Target, check_sentence, written

_DATUM = Datum(41.65, -4.72, 787.4)
_PIXELS = np.arange(64, dtype=np.uint8).reshape(8, 8)
_POINTS = np.arange(30, dtype=np.float32).reshape(10, 3)
_KALIBR = (
    b"cam0:\n  camera_model: pinhole\n  intrinsics: [400.0, 401.0, 320.0, 240.0]\n"
    b"  distortion_model: radtan\n  distortion_coeffs: [0.1, -0.02, 0.001, 0.0]\n"
    b"  resolution: [640, 480]\ncam1:\n  camera_model: pinhole\n"
    b"  intrinsics: [400.0, 401.0, 320.0, 240.0]\n  distortion_model: radtan\n"
    b"  distortion_coeffs: [0.1, -0.02, 0.001, 0.0]\n  resolution: [640, 480]\n"
    b"  T_cn_cnm1: [[1, 0, 0, -0.12], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n"
)
_CAMERA_VGA = b"fx=340\nfy=340\ncx=336\ncy=188\nk1=-0.17\nk2=0.02\np1=0\np2=0\nk3=0\n"
_ZED = (
    b"[LEFT_CAM_VGA]\n" + _CAMERA_VGA + b"[RIGHT_CAM_VGA]\n" + _CAMERA_VGA
    + b"[STEREO]\nBaseline=120\nTY=0.1\nTZ=-0.2\nRX_VGA=0.001\nCV_VGA=0.002\nRZ_VGA=0\n"
)  # fmt: skip
_DEPTHAI = json.dumps(
    {
        "cameraData": [
            [
                socket,
                {
                    "cameraType": 0,
                    "distortionCoeff": [0.1, -0.2, *[0.0] * 12],
                    "extrinsics": {
                        "rotationMatrix": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
                        "toCameraSocket": 2 if socket == 1 else -1,
                        "translation": {"x": -7.5, "y": 0.0, "z": 0.0},
                    },
                    "height": 800,
                    "width": 1280,
                    "intrinsicMatrix": [[800.0, 0.0, 640.0], [0.0, 800.0, 400.0], [0.0, 0.0, 1.0]],
                },
            ]
            for socket in (1, 2)
        ]
    }
).encode()
_EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "two_lanes" / "calibration"
_OPENCV = (_EXAMPLE / "stereo_opencv.yaml").read_bytes()
_CAMERA = (
    b"image_width: 640\nimage_height: 480\ncamera_name: left\ndistortion_model: plumb_bob\n"
    b"camera_matrix:\n  rows: 3\n  cols: 3\n  data: [400, 0, 320, 0, 400, 240, 0, 0, 1]\n"
    b"distortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [0, 0, 0, 0, 0]\n"
    b"rectification_matrix:\n  rows: 3\n  cols: 3\n  data: [1, 0, 0, 0, 1, 0, 0, 0, 1]\n"
    b"projection_matrix:\n  rows: 3\n  cols: 4\n"
    b"  data: [400, 0, 320, 0, 0, 400, 240, 0, 0, 0, 1, 0]\n"
)
_SURVEY = (
    b"kind,id,east_m,north_m,radius_m\npost,a,1.0,2.0,0.1\nrow,r,0,0,\nrow,r,5,5,\n",
    b"kind,id,lat_deg,lon_deg\npost,a,41.65,-4.72\nobstacle,b,41.6501,-4.7201\n",
)
_GEOJSON = json.dumps(
    {
        "type": "FeatureCollection",
        "features": [
            {
                "type": "Feature",
                "properties": {"kind": "keepout", "name": "pond", "id": "a"},
                "geometry": {
                    "type": "Polygon",
                    "coordinates": [
                        [[-4.72, 41.65], [-4.719, 41.65], [-4.72, 41.651], [-4.72, 41.65]]
                    ],
                },
            },
            {
                "type": "Feature",
                "properties": {"kind": "obstacle", "note": "x"},
                "geometry": {"type": "Point", "coordinates": [-4.72, 41.65]},
            },
        ],
    }
).encode()


def _refused(read: Callable[[], Any]) -> Any:
    """What is read; None where it is refused, as it should be, in a sentence."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            return read()
    except FieldgridError as error:
        check_sentence(str(error))
        return None


def _of_file(name: str, read: Callable[[Path], Any]) -> Callable[[bytes], None]:
    def check(data: bytes) -> None:
        _refused(lambda: read(written(data, name)))

    return check


def _cloud(name: str) -> Callable[[bytes], None]:
    def check(data: bytes) -> None:
        found = _refused(lambda: CloudFile(written(data, name)).read())
        assert found is None or (found.shape[1] == 3 and np.isfinite(found).all())

    return check


def _image(data: bytes) -> None:
    found = _refused(lambda: decode_image(data, "a.png", 1 << 20))
    assert found is None or (found.dtype == np.uint8 and found.ndim == 2)


def _header(data: bytes) -> None:
    found = read_header(data)
    assert found is None or (found.width_px >= 0 and found.height_px >= 0)


def _depth(data: bytes) -> None:
    _refused(lambda: decode_depth_image(data, "a.png"))


def _npy(data: bytes) -> None:
    _refused(lambda: parse_npy(data, "a.npy"))


def _toml(data: bytes) -> None:
    _parsed(lambda: parse_toml(data.decode("utf-8", "replace")))


def _json(data: bytes) -> None:
    _parsed(lambda: parse_json(data))


def _parsed(parse: Callable[[], Any]) -> None:
    try:
        parse()
    except (ValueError, FieldgridError):
        return


def _marks(data: bytes) -> None:
    try:
        document = parse_json(data)
    except ValueError:
        return
    found = _refused(lambda: marks_of_geojson(document, _DATUM, {"kind": "keepout"}))
    assert found is None or all(np.isfinite(mark.corners).all() for mark in found)


def image_seeds() -> list[bytes]:
    """A small image in every format that is read, of 8 and of 16 bit."""
    seeds = [
        cv2.imencode(end, pixels)[1].tobytes()
        for end in (".png", ".jpg", ".bmp", ".pgm", ".tif")
        for pixels in (_PIXELS, np.dstack([_PIXELS] * 3))
        if not (end == ".pgm" and pixels.ndim == 3)
    ]
    return [*seeds, cv2.imencode(".png", _PIXELS.astype(np.uint16) * 900)[1].tobytes()]


def depth_seeds() -> list[bytes]:
    """Depths as 16-bit PNG and as float32 TIFF, and a PFM."""
    deep = _PIXELS.astype(np.uint16) * 900
    pfm = b"Pf\n8 8\n-1.0\n" + _PIXELS.astype("<f4").tobytes()
    plain = [cv2.IMWRITE_TIFF_COMPRESSION, 1]
    return [
        cv2.imencode(".png", deep)[1].tobytes(),
        cv2.imencode(".tif", _PIXELS.astype(np.float32), plain)[1].tobytes(),
        pfm,
    ]


def npy_seeds() -> list[bytes]:
    """An array of each kind that is stored."""
    seeds = []
    for kind in ("<f4", "<u2", "|u1", ">f8"):
        path = written(b"", "seed.npy")
        np.save(path, _POINTS.astype(kind))
        seeds.append(path.read_bytes())
    return seeds


def ply_seeds() -> list[bytes]:
    """Points as text and as bytes."""
    head = b"ply\nformat %b 1.0\nelement vertex 10\n" + b"".join(
        b"property float %b\n" % axis for axis in (b"x", b"y", b"z")
    )
    text = b"\n".join(b"%d %d %d" % tuple(point) for point in _POINTS.astype(int))
    binary = head % b"binary_little_endian" + b"end_header\n" + _POINTS.tobytes()
    return [binary, head % b"ascii" + b"end_header\n" + text + b"\n"]


def pcd_seeds() -> list[bytes]:
    """Points as text and as bytes, packed ones too."""
    head = (
        b"# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 10\n"
        b"HEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 10\nDATA %b\n"
    )
    planes = _POINTS.T.tobytes()
    literal = b"".join(b"\x1f" + planes[k : k + 32] for k in range(0, 96, 32))
    literal += bytes([len(planes) - 97]) + planes[96:]
    text = b"\n".join(b"%d %d %d" % tuple(point) for point in _POINTS.astype(int))
    return [
        head % b"binary" + _POINTS.tobytes(),
        head % b"ascii" + text + b"\n",
        head % b"binary_compressed" + struct.pack("<II", len(literal), len(planes)) + literal,
    ]


def las_seeds() -> list[bytes]:
    """Points of two layouts, packed and not."""
    seeds = []
    for layout, version in ((1, "1.2"), (6, "1.4")):
        for end in ("las", "laz"):
            header = laspy.LasHeader(point_format=layout, version=version)
            header.scales = np.full(3, 1e-3)
            made = laspy.LasData(header)
            made.x, made.y, made.z = _POINTS.T.astype(float)
            path = written(b"", f"seed.{end}")
            made.write(path)
            seeds.append(path.read_bytes())
    return seeds


_POSES = (
    b"1700000000.5 1 2 3 0 0 0 1\n1700000001.5 1.5 2 3 0 0 0.7071068 0.7071068\n",
    b"1 0 0 1 0 1 0 2 0 0 1 3\n1 0 0 2 0 1 0 2 0 0 1 3\n",
)
_GEARS = (
    b"from,to,gear\n2011-06-15T10:30:15Z,2011-06-15T10:31:00Z,reverse\n",
    b"from,to,gear\n1700000000000000000,1700000001000000000,forward\n",
)
_MOUNTING = json.dumps(
    {
        "camera_height_above_ground_m": 2.65,
        "camera_tilt_down_deg": 16.0,
        "camera_roll_deg": 0.0,
        "camera_yaw_deg": 0.0,
        "stereo_baseline_m": 0.18,
        "gnss_antenna_from_camera_mid_flu_m": [-0.45, 0.12, 0.35],
    }
).encode()
_VEHICLE = b"width_m = 1.5\nfront_m = 2.0\nturning_radius_m = 4.0\nreverse = false\n"
_SETTINGS = (
    b"name = 'june'\n[datum]\nlat_deg = 41.65\nlon_deg = -4.72\nheight_m = 787.4\n"
    b"[images]\nbayer = 'grbg'\nbits = 12\n"
)
_BUILD = b"[stereo]\nmin_range_m = 2.0\n[map]\ncell_m = 0.05\n[pose]\nheading = 'motion'\n"


def _seeded(*seeds: bytes) -> Callable[[], list[bytes]]:
    return lambda: list(seeds)


TARGETS = [
    Target("npy", _npy, npy_seeds),
    Target("ply", _cloud("a.ply"), ply_seeds),
    Target("pcd", _cloud("a.pcd"), pcd_seeds),
    Target("las", _cloud("a.las"), las_seeds),
    Target("image header", _header, image_seeds),
    Target("image", _image, image_seeds),
    Target("depth image", _depth, depth_seeds),
    Target("poses", _of_file("poses.txt", read_pose_file), _seeded(*_POSES)),
    Target("gears", _of_file("gears.csv", read_gear_spans), _seeded(*_GEARS)),
    Target("mounting", _of_file("mounting.toml", read_mounting), _seeded(_MOUNTING)),
    Target("settings", _of_file("recording.toml", read_settings), _seeded(_SETTINGS)),
    Target("build settings", _of_file("b.toml", lambda path: resolve(path, {})), _seeded(_BUILD)),
    Target("vehicle", _of_file("vehicle.toml", read_vehicle), _seeded(_VEHICLE)),
    Target("kalibr", _of_file("a.yaml", lambda path: read_kalibr(path).calibration(None)),
           _seeded(_KALIBR)),
    Target("opencv", _of_file("a.yaml", lambda path: read_opencv(path).calibration(None)),
           _seeded(_OPENCV)),
    Target("zed", _of_file("SN1.conf", lambda path: read_zed(path, (672, 376)).calibration(False)),
           _seeded(_ZED)),
    Target("depthai", _of_file("a.json", lambda path: read_depthai(path, None).calibration(False)),
           _seeded(_DEPTHAI)),
    Target("camera info", _of_file("a.yaml", read_ros_camera), _seeded(_CAMERA)),
    Target("survey", _of_file("s.csv", lambda p: read_survey(p, _DATUM)), _seeded(*_SURVEY)),
    Target("survey as GeoJSON", _of_file("s.geojson", lambda p: read_survey(p, _DATUM)),
           _seeded(_GEOJSON)),
    Target("shapes", _of_file("s.geojson", lambda p: read_shapes(p, _DATUM)), _seeded(_GEOJSON)),
    Target("marks", _marks, _seeded(_GEOJSON)),
    Target("toml", _toml, _seeded(_BUILD, _SETTINGS, _VEHICLE)),
    Target("json", _json, _seeded(_GEOJSON, b'{"a": [1, 2.5e3, null, "x\\u00e9"]}')),
]  # fmt: skip
