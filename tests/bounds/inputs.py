"""Small files that unfold to much, and long ones: what each reader must bear within its bounds.

A case writes its input into a folder and returns what reads it. Sizes are those that were found to
cost gigabytes or minutes, or the most that a reader admits where that is less.
"""

from __future__ import annotations

import gzip
import io
import os
import shutil
import sqlite3
import struct
import zipfile
import zlib
from collections.abc import Callable
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import laspy
import numpy as np
import zstandard

from fieldgrid.cli.commands.mark import _read
from fieldgrid.core import MapError, RecordingError, resolve
from fieldgrid.export.route_file import read_poses, read_route
from fieldgrid.field import read_survey, read_truth, read_vehicle
from fieldgrid.geometry import Datum, read_shapes
from fieldgrid.maps import marks_of_geojson, open_map
from fieldgrid.pipeline import Journal, read_journal
from fieldgrid.poses.gnss.nmea import unicore_crc
from fieldgrid.recordings import (
    CloudFile,
    ImageFile,
    fetch,
    open_growing,
    read_gear_spans,
    read_mounting,
)
from fieldgrid.recordings.calibration.kalibr import read_kalibr
from fieldgrid.recordings.calibration.opencv import read_opencv
from fieldgrid.recordings.frames.depth_files import decode_depth_image
from fieldgrid.recordings.frames.frame_table import read_frames
from fieldgrid.recordings.frames.npy import parse_npy
from fieldgrid.recordings.poses.pose_files import read_pose_file
from fieldgrid.recordings.readers.euroc import _images
from fieldgrid.recordings.readers.isoxml import read_time_log
from fieldgrid.recordings.readers.kitti import _read_stamps
from fieldgrid.recordings.readers.settings_file import read_settings
from fieldgrid.recordings.remote.copies import CACHE
from fieldgrid.recordings.ros.bag import open_bag
from fieldgrid.recordings.tables.logs import read_fix_log
from fieldgrid.recordings.tables.motion_files import read_motion
from tests.maps.file.maps import drive, write_map
from tests.poses.gnss.sentences import gga, rmc
from tests.poses.gnss.test_ubx import pvt
from tests.recordings.ros.samples import ROS2, samples, write_old_db3
from tests.recordings.ros.test_hostile import PACK, chunk, rosbag1

MILLION = 1_000_000
TWO_LANES = Path(__file__).parents[2] / "examples" / "two_lanes"
START_NS = 1_717_243_200_000_000_000
DATUM = Datum(41.65, -4.72, 787.0)
DOTS = b".".join([b"a"] * 40_000) + b" = 1\n"
DEEP = 200_000 * b"["

Read = Callable[[], Any]
Case = Callable[[Path], Read]
CASES: dict[str, Case] = {}


def case(made: Case) -> Case:
    """Every function below is a case of its name."""
    CASES[made.__name__] = made
    return made


def lines(form: str, count: int = MILLION, step: int = 100_000_000, start: int = START_NS) -> str:
    """So many lines, each with its time."""
    return "\n".join([form % (start + k * step) for k in range(count)]) + "\n"


def put(path: Path, make: Callable[[], bytes | str]) -> Path:
    """A file with what is made, unless it is there: the process that reads it has not made it."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        data = make()
        path.write_bytes(data.encode() if isinstance(data, str) else data)
    return path


def png(width: int, height: int, depth: int = 8) -> bytes:
    """A black picture, whatever its size."""
    body = struct.pack(">IIBBBBB", width, height, depth, 0, 0, 0, 0)
    packer, parts = zlib.compressobj(9), []
    row = bytes(1 + width * depth // 8)
    for _ in range(height):
        parts.append(packer.compress(row))
    data = b"".join([*parts, packer.flush()])
    chunks = ((b"IHDR", body), (b"IDAT", data), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(part)) + kind + part + struct.pack(">I", zlib.crc32(kind + part))
        for kind, part in chunks
    )


# --- frames


@case
def frames_csv(folder: Path) -> Read:
    head = "time_ns,frame_id,left,right\n"
    put(folder / "frames.csv", lambda: head + lines("%d,f,left/0.png,right/0.png"))
    return lambda: read_frames(folder)


@case
def frames_of_euroc(folder: Path) -> Read:
    put(folder / "cam0" / "data.csv", lambda: lines("%d,0.png"))
    return lambda: _images(folder / "cam0")


@case
def frames_of_one_line(folder: Path) -> Read:
    put(folder / "frames.csv", lambda: "time_ns,frame_id,left,right\n" + 100 * MILLION * "1,")
    return lambda: read_frames(folder)


@case
def stamps_of_kitti(folder: Path) -> Read:
    put(folder / "timestamps.txt", lambda: MILLION * "2011-09-26 13:02:25.964389445\n")
    return lambda: _read_stamps(folder, MILLION, "images")


# --- fixes


@case
def table_of_fixes(folder: Path) -> Read:
    head = "time_ns,lat_deg,lon_deg,height_m,quality\n"
    path = put(folder / "fixes.csv", lambda: head + lines("%d,41.65,-4.72,787.4,4"))
    return lambda: read_fix_log(path)


@case
def table_of_one_line(folder: Path) -> Read:
    head = "time_ns,lat_deg,lon_deg,height_m,quality\n"
    path = put(
        folder / "fixes.csv.gz", lambda: gzip.compress((head + 150 * MILLION * "1").encode())
    )
    return lambda: read_fix_log(path)


@case
def wide_table(folder: Path) -> Read:
    names = ",".join(f"c{k}" for k in range(4000))
    row = "10000," * 4000 + "\n"
    path = put(
        folder / "fixes.csv.gz", lambda: gzip.compress((names + "\n" + 2600 * row).encode(), 1)
    )
    return lambda: read_fix_log(path)


@case
def packed_table(folder: Path) -> Read:
    def make() -> bytes:
        head = b"time_ns,lat_deg,lon_deg,height_m,quality\n"
        return gzip.compress(head + 100 * MILLION * b"\n", 1)

    path = put(folder / "fixes.csv.gz", make)
    return lambda: read_fix_log(path)


@case
def packed_log(folder: Path) -> Read:
    path = put(
        folder / "log.nmea.gz", lambda: gzip.compress(gga("120000.00") + 300 * MILLION * b"\0", 1)
    )
    return lambda: read_fix_log(path)


@case
def packed_sentences(folder: Path) -> Read:
    path = put(folder / "log.nmea.gz", lambda: gzip.compress(5 * MILLION * gga("120000.00"), 1))
    return lambda: read_fix_log(path)


@case
def sentences(folder: Path) -> Read:
    def make() -> bytes:
        bodies = [
            f"GPGGA,{k // 36000:02d}{k // 600 % 60:02d}{k / 10 % 60:05.2f},4139.0227370,N,"
            "00443.2141860,W,4,12,0.7,737.921,M,52.4,M,1.5,0138"
            for k in range(600_000)
        ]
        every = np.array(bodies, dtype="S").view(np.uint8).reshape(len(bodies), -1)
        sums = np.bitwise_xor.reduce(every, axis=1).tolist()
        said = [b"$%b*%02X\r\n" % (b.encode(), s) for b, s in zip(bodies, sums, strict=True)]
        return rmc("000000.00") + b"".join(said)

    path = put(folder / "log.nmea", make)
    return lambda: read_fix_log(path)


@case
def solution_of_rtklib(folder: Path) -> Read:
    head = "%  GPST latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)\n"
    row = "2316 %d.%03d   41.650378950   -4.720236430   737.9211   1  12   0.0100   0.0100   0.0200"
    path = put(
        folder / "drive.pos",
        lambda: head + "\n".join(row % (100_000 + k // 5, 200 * (k % 5)) for k in range(MILLION)),
    )
    return lambda: read_fix_log(path)


@case
def logs_of_novatel(folder: Path) -> Read:
    def make() -> bytes:
        form = (
            "BESTPOSA,COM1,0,60.5,FINESTEERING,2166,%d.%03d,02000000,b1f6,16248;SOL_COMPUTED,"
            "NARROW_INT,51.15043724,-114.03067851,1064.9554,-17.0,WGS84,0.0105,0.0100,0.0197,"
            '"",1.0,0.0,25,25,25,25,00,06,39,33'
        )
        bodies = [(form % (100_000 + k // 5, 200 * (k % 5))).encode() for k in range(300_000)]
        return b"".join(b"#%b*%08x\r\n" % (body, unicore_crc(body)) for body in bodies)

    path = put(folder / "log.nmea", make)
    return lambda: read_fix_log(path)


@case
def ubx_messages(folder: Path) -> Read:
    path = put(
        folder / "log.ubx",
        lambda: b"".join(pvt(k % 60, 561_618_000 + k) for k in range(2000)) * 200,
    )
    return lambda: read_fix_log(path)


@case
def ubx_heads(folder: Path) -> Read:
    path = put(folder / "log.ubx", lambda: pvt() + 2 * MILLION * b"\xb5\x62\x01\x07\xff\x1f")
    return lambda: read_fix_log(path)


@case
def time_log_of_entities(folder: Path) -> Read:
    bomb = b'<!DOCTYPE a [<!ENTITY a "aaaaaaaaaa">' + b"".join(
        b'<!ENTITY a%d "%b">' % (k, 10 * (b"&a%d;" % (k - 1) if k else b"&a;")) for k in range(12)
    )
    put(folder / "TLG00001.xml", lambda: bomb + b"]><TIM>&a11;</TIM>")
    path = put(folder / "TLG00001.bin", lambda: bytes(1000))
    return lambda: read_time_log(path)


@case
def taskdata(folder: Path) -> Read:
    header = (
        b'<TIM A="" D="4"><PTN A="" B="" C="" D="" E="" F="" G="" H="" I=""/>'
        b'<DLV A="008D" B="" C="DET-1"/></TIM>'
    )
    record = struct.pack(
        "<IHiiiBHHBIHBBi", 43_200_000, 16_223, 416500000, -47200000, 787400, 4, 13, 7, 17,
        43_200_000, 16_223, 1, 0, 1500,
    )  # fmt: skip
    put(folder / "TLG00001.xml", lambda: header)
    put(
        folder / "TASKDATA.XML",
        lambda: (
            b"<ISO11783_TaskData>"
            + 300_000 * b'<DVC A="1"><DET A="1"/></DVC>'
            + b"</ISO11783_TaskData>"
        ),
    )
    path = put(folder / "TLG00001.bin", lambda: 300_000 * record)
    return lambda: read_time_log(path)


# --- motion, poses and gears


@case
def gyro_and_wheels(folder: Path) -> Read:
    head = "time_ns,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s,accel_x,accel_y,accel_z\n"
    put(folder / "imu" / "imu.csv", lambda: head + lines("%d,0,0,0.1,0,0,9.8", step=5_000_000))
    put(folder / "odometry" / "wheels.csv", lambda: "time_ns,speed_mps\n" + lines("%d,1.5"))
    return lambda: read_motion(folder)


@case
def poses_with_times(folder: Path) -> Read:
    path = put(folder / "poses.tum", lambda: lines("%d 1 2 3 0 0 0 1"))
    return lambda: read_pose_file(path)


@case
def poses_without_times(folder: Path) -> Read:
    path = put(folder / "poses.txt", lambda: MILLION * "1 0 0 1 0 1 0 2 0 0 1 3\n")
    return lambda: read_pose_file(path)


@case
def gears(folder: Path) -> Read:
    path = put(folder / "gears.csv", lambda: "from,to,gear\n" + lines(f"%d,{1 << 61},reverse"))
    return lambda: read_gear_spans(path)


# --- settings and calibrations


@case
def keys_of_dots(folder: Path) -> Read:
    path = put(folder / "a.toml", lambda: DOTS)

    return lambda: read_settings(path)


@case
def keys_of_dots_of_a_vehicle(folder: Path) -> Read:
    path = put(folder / "a.toml", lambda: DOTS)
    return lambda: read_vehicle(path)


@case
def keys_of_dots_of_a_build(folder: Path) -> Read:
    path = put(folder / "a.toml", lambda: DOTS)
    return lambda: resolve(path, {})


@case
def deep_documents(folder: Path) -> Read:
    path = put(folder / "a.json", lambda: DEEP)
    return lambda: read_mounting(path)


@case
def yaml_of_aliases(folder: Path) -> Read:
    text = "a0: &a0 [0,0,0,0,0,0,0,0,0,0]\n" + "".join(
        f"a{k}: &a{k} [{','.join(10 * [f'*a{k - 1}'])}]\n" for k in range(1, 10)
    )
    one = "  camera_model: pinhole\n  intrinsics: *a9\n  resolution: [640, 480]\n"
    one += "  distortion_model: radtan\n  distortion_coeffs: *a9\n  T_cn_cnm1: *a9\n"
    path = put(folder / "camchain.yaml", lambda: text + "cam0:\n" + one + "cam1:\n" + one)
    return lambda: read_kalibr(path).calibration(None)


@case
def opencv_of_aliases(folder: Path) -> Read:
    """In two files."""
    text = "%YAML:1.0\n---\na0: &a0 [0,0,0,0,0,0,0,0,0,0]\n" + "".join(
        f"a{k}: &a{k} [{','.join(10 * [f'*a{k - 1}'])}]\n" for k in range(1, 10)
    )
    lenses = put(folder / "intrinsics.yml", lambda: text + "M1: *a9\nD1: *a9\nM2: *a9\nD2: *a9\n")
    put(folder / "extrinsics.yml", lambda: text + "R: *a9\nT: *a9\nR1: *a9\nP1: *a9\n")
    return lambda: read_opencv(lenses).calibration(None)


@case
def deep_yaml(folder: Path) -> Read:
    path = put(folder / "camchain.yaml", lambda: 50_000 * "[")
    return lambda: read_kalibr(path).calibration(None)


# --- pictures and clouds


@case
def picture(folder: Path) -> Read:
    path = put(folder / "a.png", lambda: png(16_000, 16_000))
    return lambda: ImageFile(path).read()


@case
def picture_headers_without_end(folder: Path) -> Read:
    """Blanks, padding, empty chunks, and one long tag again and again."""
    offsets = struct.pack("<HHII", 273, 4, 100_000, 800_000)
    starts = (
        b"P5" + (64 << 20) * b"\n",
        b"\xff\xd8" + (64 << 20) * b"\xff",
        b"\x89PNG\r\n\x1a\n" + bytes(64 << 20),
        b"II*\0\x08\0\0\0\xff\xff" + 0xFFFF * offsets + bytes(400_000),
    )
    paths = [put(folder / f"{k}.png", lambda data=data: data) for k, data in enumerate(starts)]

    def read() -> None:
        for path in paths[1:]:
            with suppress(RecordingError):
                ImageFile(path).read()
        ImageFile(paths[0]).read()

    return read


@case
def depth_picture(folder: Path) -> Read:
    path = put(folder / "a.png", lambda: png(16_000, 16_000, 16))
    return lambda: decode_depth_image(path.read_bytes(), "a.png")


@case
def array(folder: Path) -> Read:
    stream = io.BytesIO()
    np.save(stream, np.zeros(3, dtype=np.float32))
    data = stream.getvalue().replace(b"(3,)", b"(9999999999,)")
    return lambda: parse_npy(data, "a.npy")


@case
def ply(folder: Path) -> Read:
    head = "ply\nformat ascii 1.0\nelement vertex 3000000\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    path = put(folder / "a.ply", lambda: head + 3 * MILLION * "1 2 3\n")
    return lambda: CloudFile(path).read()


@case
def pcd(folder: Path) -> Read:
    head = (
        b"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 300000000\n"
        b"HEIGHT 1\nPOINTS 300000000\nDATA binary_compressed\n"
    )
    path = put(
        folder / "a.pcd",
        lambda: head + struct.pack("<II", 1000, 3_600_000_000 % (1 << 32)) + bytes(1000),
    )
    return lambda: CloudFile(path).read()


@case
def pcd_as_text(folder: Path) -> Read:
    head = (
        b"VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1000000\n"
        b"HEIGHT 1\nPOINTS 1000000\nDATA ascii\n"
    )
    path = put(folder / "a.pcd", lambda: head + MILLION * b"1 2 3\n")
    return lambda: CloudFile(path).read()


@case
def las(folder: Path) -> Read:
    def make() -> bytes:
        made = laspy.LasData(laspy.LasHeader(point_format=1, version="1.2"))
        made.x = made.y = made.z = np.zeros(10)
        whole = io.BytesIO()
        made.write(whole, do_compress=True)
        data = bytearray(whole.getvalue())
        data[107:111] = struct.pack("<I", 19_000_000)
        return bytes(data)

    path = put(folder / "a.laz", make)
    return lambda: CloudFile(path).read()


@case
def las_of_records(folder: Path) -> Read:
    def make() -> bytes:
        made = laspy.LasData(laspy.LasHeader(point_format=1, version="1.2"))
        made.x = made.y = made.z = np.zeros(1)
        whole = io.BytesIO()
        made.write(whole)
        data, count = bytearray(whole.getvalue()), 2 * MILLION
        data[96:104] = struct.pack("<II", 227 + 54 * count, count)
        return bytes(data[:227]) + bytes(54 * count) + bytes(data[227:])

    path = put(folder / "a.las", make)
    return lambda: CloudFile(path).read()


# --- bags


def _chunks(folder: Path, kind: str) -> Path:
    size = 120 << 20

    def make() -> bytes:
        packed = chunk(PACK[kind](bytes(size)), kind.encode(), size)
        return rosbag1(*30 * [packed])

    return put(folder / "a.bag", make)


@case
def bag_of_lz4(folder: Path) -> Read:
    path = _chunks(folder, "lz4")
    return lambda: open_bag(path)


@case
def bag_of_bz2(folder: Path) -> Read:
    path = _chunks(folder, "bz2")
    return lambda: open_bag(path)


@case
def bag_of_zstd(folder: Path) -> Read:
    path = put(folder / "a.mcap.zstd", lambda: zstandard.compress(bytes(1 << 30)))
    return lambda: open_bag(path)


@case
def chunk_of_zstd(folder: Path) -> Read:
    def make() -> bytes:
        size = 1 << 30
        packed = zstandard.compress(bytes(size))
        head = struct.pack("<QQQII", 0, 0, size, 0, 4) + b"zstd" + struct.pack("<Q", len(packed))
        size = len(head) + len(packed)
        return b"\x89MCAP0\r\n\x06" + struct.pack("<Q", size) + head + packed

    path = put(folder / "a.mcap", make)
    return lambda: open_bag(path)


@case
def database_of_zeros(folder: Path) -> Read:
    path = folder / "a.db3"
    if not path.exists():
        database = write_old_db3(path, samples(ROS2))
        database.execute("UPDATE messages SET data = zeroblob(130000000) WHERE id = 3")
        database.close()

    def read() -> None:
        with open_bag(path) as bag:
            for _ in bag.messages():
                pass

    return read


@case
def archive_at_a_url(folder: Path) -> Read:
    """Of 100 MiB of zeros: what is fetched is a limit of its own."""
    if not (folder / "a.zip").exists():
        with zipfile.ZipFile(folder / "a.zip", "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("drive/0.png", bytes(100 << 20))
    os.environ[CACHE] = str(folder / "cache")
    return lambda: fetch(f"zip://drive::{folder / 'a.zip'}")


# --- truth, surveys, marks and routes


@case
def truth_rasters(folder: Path) -> Read:
    head = b"\x93NUMPY\x01\x00v\x00" + (
        b"{'descr': '|b1', 'fortran_order': False, 'shape': (60000, 60000), }".ljust(117) + b"\n"
    )
    for name, names in (
        ("obstacle_raster_5cm.npz", ("occupied", "east0", "north0", "cell")),
        ("observable_raster_5cm.npz", ("obstacle_pixels",)),
    ):
        if (folder / name).exists():
            continue
        with zipfile.ZipFile(folder / name, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
            for one in names:
                with archive.open(f"{one}.npy", "w", force_zip64=True) as member:
                    member.write(head)
                    for _ in range(1200 if len(one) > 6 else 1):
                        member.write(bytes(1 << 20))
    put(folder / "poses_frames.csv", lambda: "a\n")
    return lambda: read_truth(folder)


def _rasters(folder: Path) -> None:
    place = folder / "obstacle_raster_5cm.npz"
    if not place.exists():
        occupied = np.zeros((9, 9), dtype=np.bool_)
        np.savez(place, occupied=occupied, east0=0.0, north0=0.0, cell=0.05)
        np.savez(folder / "observable_raster_5cm.npz", obstacle_pixels=occupied.astype(np.int32))


@case
def truth_poses(folder: Path) -> Read:
    _rasters(folder)
    head = "timestamp_utc_s,cam_mid_E,cam_mid_N,heading_deg,direction,segment\n"
    form = "%d,1,2,3,forward,lane1"
    put(folder / "poses_frames.csv", lambda: head + lines(form, step=1, start=1))
    return lambda: read_truth(folder)


@case
def truth_origin(folder: Path) -> Read:
    _rasters(folder)
    put(folder / "poses_frames.csv", lambda: "timestamp_utc_s\n")
    put(folder / "session.json", lambda: DEEP)
    return lambda: read_truth(folder)


@case
def survey_table(folder: Path) -> Read:
    path = put(folder / "s.csv", lambda: "kind,id,east_m,north_m\n" + MILLION * "post,a,1.0,2.0\n")
    return lambda: read_survey(path, DATUM)


@case
def survey_of_degrees(folder: Path) -> Read:
    path = put(folder / "s.csv", lambda: "kind,lat_deg,lon_deg\n" + MILLION * "post,41.65,-4.72\n")
    return lambda: read_survey(path, DATUM)


def geojson(feature: str, count: int) -> str:
    return '{"type":"FeatureCollection","features":[' + ",".join(count * [feature]) + "]}"


def corners() -> str:
    """As many as a document may have of them, packed densely."""
    return "[" + ",".join((15 * MILLION // 6) * ["[1,2]"]) + "]"


POINT = '{"type":"Feature","properties":{},"geometry":{"type":"Point","coordinates":[-4.72,41.65]}}'


@case
def survey_features(folder: Path) -> Read:
    path = put(folder / "s.geojson", lambda: geojson(POINT, 150_000))
    return lambda: read_survey(path, DATUM)


@case
def survey_of_lists(folder: Path) -> Read:
    path = put(folder / "s.geojson", lambda: "[" + 5 * MILLION * "[],")
    return lambda: read_survey(path, DATUM)


@case
def survey_beyond_a_document(folder: Path) -> Read:
    path = put(folder / "s.geojson", lambda: geojson(POINT, 200_000))
    return lambda: read_survey(path, DATUM)


@case
def survey_of_a_line(folder: Path) -> Read:
    line = '{"type":"Feature","properties":{"kind":"row"},"geometry":{"type":"LineString",'
    path = put(folder / "s.geojson", lambda: geojson(line + f'"coordinates":{corners()}}}}}', 1))
    return lambda: read_survey(path, DATUM)


@case
def marks(folder: Path) -> Read:
    path = put(folder / "m.geojson", lambda: geojson(POINT, 170_000))
    return lambda: marks_of_geojson(_read(path), DATUM, {"kind": "keepout"})


@case
def shapes(folder: Path) -> Read:
    path = put(folder / "s.geojson", lambda: geojson(POINT, 300_000))
    return lambda: read_shapes(path, DATUM)


@case
def route_poses(folder: Path) -> Read:
    path = put(
        folder / "r.csv", lambda: "east_m,north_m,curvature_1pm\n" + MILLION * "1.0,2.0,9.0\n"
    )
    return lambda: read_poses(path, "east_m", "north_m", "curvature_1pm")


@case
def route_figure(folder: Path) -> Read:
    path = put(folder / "r.geojson", lambda: f'{{"type":"LineString","coordinates":{corners()}}}')
    return lambda: read_route(path, DATUM)


# --- maps


@case
def live_journal(folder: Path) -> Read:
    path = folder / "a.journal"
    with Journal(path) as journal:
        journal.append("rows", 1)
    whole = path.read_bytes()
    (record,) = read_journal(path)
    mark = whole[record.start : record.start + 4]
    head = mark + (100_000).to_bytes(4, "little") + bytes(8)
    path.write_bytes(whole[: record.start] + 100_000 * head)
    return lambda: sum(1 for _ in read_journal(path))


@case
def journal_of_a_map(folder: Path) -> Read:
    """A long one of nothing but the map's last page, again and again under other numbers."""
    path = folder / "field.gpkg"
    if not path.exists():
        write_map(path, [drive(1)])
        head = struct.pack(
            ">8sIIIII", bytes.fromhex("d9d505f920a163d7"), 50_000, 0, 60_000, 512, 4096
        )
        data = path.read_bytes()[-4096:]
        total = sum(data[4096 - 200 : 0 : -200])
        page = b"%b" + data + struct.pack(">I", total)
        pages = (page.replace(b"%b", struct.pack(">I", k + 2), 1) for k in range(50_000))
        Path(f"{path}-journal").write_bytes(head.ljust(512, b"\0") + b"".join(pages))
    return lambda: open_map(path)


@case
def map_of_many_sessions(folder: Path) -> Read:
    path = folder / "field.gpkg"
    if not path.exists():
        write_map(path, [drive(1)])
        with closing(sqlite3.connect(path, isolation_level=None)) as database:
            names = [row[1] for row in database.execute("PRAGMA table_info(fieldgrid_session)")]
            others = ", ".join(name for name in names if name not in ("id", "name"))
            database.execute(
                "WITH RECURSIVE n(k) AS (SELECT 2 UNION ALL SELECT k + 1 FROM n LIMIT 20000) "
                f"INSERT INTO fieldgrid_session (id, name, {others}) "
                f"SELECT k, 's' || k, {others} FROM n, fieldgrid_session WHERE id = 1"
            )

    def read() -> None:
        with open_map(path) as universal:
            assert len(universal.sessions()) == 20_001
            problems = universal.verify().problems
        assert 0 < len(problems) < 200, len(problems)
        raise MapError(problems[0])

    return read


@case
def growing_table(folder: Path) -> Read:
    shutil.copytree(TWO_LANES / "calibration", folder / "calibration", dirs_exist_ok=True)
    head = "time_ns,frame_id,left,right\n"
    put(folder / "frames.csv", lambda: head + lines("%d,f,l,r", 300_000) + MILLION * "a\n")

    def read() -> None:
        shots, problems = open_growing(folder).new_shots()
        assert len(shots) == 300_000
        assert len(problems) == 1001
        assert "999000 more new rows" in str(problems[-1])

    return read
