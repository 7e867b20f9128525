"""Single messages: images of every encoding, depths, disparities, clouds; sane and absurd."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from fieldgrid.core import RecordingError
from fieldgrid.recordings.bag.sensors.clouds import MessageCloud
from fieldgrid.recordings.bag.sensors.images import (
    CompressedImage,
    DepthImage,
    DisparityImage,
    MessageSource,
    RawImage,
)
from fieldgrid.recordings.bag.transforms import R_OPTICAL_FLU
from fieldgrid.recordings.ros.bag import open_bag
from tests.recordings import bags
from tests.recordings.bags import Container, Maker, Said

UTC = 1_700_000_000_000_000_000
RNG = np.random.default_rng(5)
GREY = RNG.integers(0, 256, (6, 8), dtype=np.uint8)
Make = Callable[..., Any]


@pytest.fixture
def read(tmp_path: Path) -> Make:
    """Writes a message to a bag and gives what a kind of source reads of it."""

    def do(kind: type[MessageSource], make: Make, *more: Any, container: Container = "mcap") -> Any:
        maker = Maker(container)
        said = [Said(UTC, "/t", make(maker))]
        path = bags.write_bag(tmp_path / container / "m", container, maker, said)
        with open_bag(path) as bag:
            (message,) = bag.messages()
            return kind(message, UTC, *more).read()  # type: ignore[attr-defined]

    return do


@pytest.mark.parametrize("container", ["bag", "mcap"])
def test_grey_is_what_was_recorded(container: Container, read: Make) -> None:
    image = read(RawImage, lambda m: m.image(UTC, GREY, "mono8"), container=container)
    assert np.array_equal(image, GREY)


@pytest.mark.parametrize("encoding", ["bgr8", "rgb8", "bgra8", "rgba8"])
def test_colour_becomes_the_luma_of_opencv(encoding: str, read: Make) -> None:
    pixels = RNG.integers(0, 256, (6, 8, 3 if len(encoding) == 4 else 4), dtype=np.uint8)
    code = getattr(cv2, f"COLOR_{encoding[:-1].upper()}2GRAY")
    image = read(RawImage, lambda m: m.image(UTC, pixels, encoding))
    assert np.array_equal(image, cv2.cvtColor(pixels, code))


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("encoding", ["mono16", "16UC1"])
def test_sixteen_bits_of_either_byte_order(order: str, encoding: str, read: Make) -> None:
    deep = RNG.integers(0, 1 << 16, (6, 8)).astype(f"{order}u2")
    image = read(RawImage, lambda m: m.image(UTC, deep, encoding))
    assert np.array_equal(image, (deep.astype(np.uint16) >> 8).astype(np.uint8))
    image = read(RawImage, lambda m: m.image(UTC, deep & 0xFFF, encoding), 12)
    assert np.array_equal(image, ((deep.astype(np.uint16) & 0xFFF) >> 4).astype(np.uint8))


def test_rows_may_be_padded(read: Make) -> None:
    padded = np.hstack([GREY, np.full((6, 3), 77, np.uint8)])
    data = np.frombuffer(padded.tobytes()[:-3], dtype=np.uint8)  # not after the last row
    image = read(RawImage, lambda m: m.image(UTC, GREY, "mono8", step=11, data=data))
    assert np.array_equal(image, GREY)


@pytest.mark.parametrize(
    ("fields", "match"),
    [
        ({"width": 0}, "none or more than"),
        ({"width": 1 << 31, "height": 1 << 31}, "none or more than"),
        ({"width": 9}, "too few"),
        ({"height": 7}, "too few"),
        ({"step": 4}, "too few"),
        ({"step": (1 << 32) - 1}, "too few"),
        ({"data": GREY.ravel()[:-1]}, "too few"),
        ({"encoding": "jpeg"}, "encoded as 'jpeg'"),
        ({"encoding": "bgr8"}, "too few"),
    ],
)
def test_absurd_images_are_told(fields: dict[str, Any], match: str, read: Make) -> None:
    with pytest.raises(RecordingError, match=rf"^/t @ {UTC}.*{match}"):
        read(RawImage, lambda m: m.image(UTC, GREY, **({"encoding": "mono8"} | fields)))


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_compressed_images_are_decoded_like_files(suffix: str, read: Make, tmp_path: Path) -> None:
    from fieldgrid.recordings import ImageFile

    colour = RNG.integers(0, 256, (32, 48, 3), dtype=np.uint8)
    path = tmp_path / f"image{suffix}"
    cv2.imwrite(str(path), colour)
    image = read(CompressedImage, lambda m: m.compressed(UTC, path.read_bytes(), "bgr8; x"))
    assert np.array_equal(image, ImageFile(path).read())
    with pytest.raises(RecordingError, match=r"^/t @ .* is truncated or damaged"):
        read(CompressedImage, lambda m: m.compressed(UTC, path.read_bytes()[:300], "jpeg"))
    with pytest.raises(RecordingError, match=r"^/t @ .* is empty"):
        read(CompressedImage, lambda m: m.compressed(UTC, b"", "jpeg"))


def test_a_compressed_bomb_is_refused(read: Make) -> None:
    bomb = bytearray(cv2.imencode(".png", GREY)[1].tobytes())
    bomb[16:24] = (60_000).to_bytes(4, "big") * 2
    with pytest.raises(RecordingError, match="claims 60000 x 60000 px"):
        read(CompressedImage, lambda m: m.compressed(UTC, bytes(bomb), "png"))


def test_bytes_that_are_no_message_are_told(tmp_path: Path) -> None:
    maker = Maker("mcap")
    said = [Said(UTC, "/t", maker.image(UTC, GREY, "mono8"))]
    path = bags.write_bag(tmp_path / "m", "mcap", maker, said)
    with open_bag(path) as bag:
        (message,) = bag.messages()
        source = RawImage(message._replace(data=message.data[:30]), UTC)
        with pytest.raises(RecordingError, match="does not fit its type"):
            source.read()


@pytest.mark.parametrize(
    "definition",
    [
        "std_msgs/Header header\nuint32 height\n",
        "std_msgs/Header header\nuint32 height\nuint32 width\nfloat64 encoding\n"
        "uint8 is_bigendian\nuint32 step\nuint8[] data\n",
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\n"
        "uint8 is_bigendian\nuint32 step\nstring data\n",
    ],
)
def test_an_image_that_is_defined_as_something_else_is_told(
    definition: str, tmp_path: Path
) -> None:
    from mcap.writer import Writer

    maker = Maker("mcap")
    image = maker.image(UTC, GREY, "mono8")
    data = bytes(maker.store.serialize_cdr(image, image.__msgtype__)) + bytes(64)
    with (tmp_path / "m.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        schema = writer.register_schema("sensor_msgs/msg/Image", "ros2msg", definition.encode())
        channel = writer.register_channel("/t", "cdr", schema)
        writer.add_message(channel, UTC, data, UTC)
        writer.finish()
    with open_bag(tmp_path / "m.mcap") as bag:
        (message,) = bag.messages()
        with pytest.raises(RecordingError, match=r"no definition that can be used|does not fit"):
            RawImage(message, UTC).read()


@pytest.mark.parametrize("order", ["<", ">"])
def test_depths_of_millimetres_and_metres(order: str, read: Make) -> None:
    millimetres = np.array([[0, 1500], [65_535, 250]]).astype(f"{order}u2")
    depth = read(DepthImage, lambda m: m.image(UTC, millimetres, "16UC1"))
    np.testing.assert_allclose(depth, [[np.nan, 1.5], [65.535, 0.25]], rtol=1e-6)
    assert depth.dtype == np.float32
    metres = np.array([[np.nan, 1.5], [np.inf, -1.0]]).astype(f"{order}f4")
    depth = read(DepthImage, lambda m: m.image(UTC, metres, "32FC1"))
    np.testing.assert_array_equal(depth, np.array([[np.nan, 1.5], [np.nan, np.nan]], np.float32))
    with pytest.raises(RecordingError, match="16UC1"):
        read(DepthImage, lambda m: m.image(UTC, GREY, "mono8"))


@pytest.mark.parametrize("container", ["bag", "mcap"])
def test_disparities_are_depths(container: Container, read: Make) -> None:
    disparities = np.array([[-1.0, 4.0], [50.0, 100.0], [1.0, np.nan]], dtype=np.float32)

    def make(maker: Maker) -> Any:
        image = maker.image(UTC, disparities, "32FC1")
        return maker.disparity(UTC, image, 500.0, 0.12, nearest=64.0, farthest=2.0)

    depth = read(DisparityImage, make, container=container)
    expected = [[np.nan, 15.0], [1.2, np.nan], [np.nan, np.nan]]
    np.testing.assert_allclose(depth, expected, rtol=1e-6)


POINTS = RNG.uniform(-20, 20, (50, 3))


@pytest.mark.parametrize("container", ["bag", "mcap"])
@pytest.mark.parametrize("dtype", ["<f4", ">f4", "<f8", ">f8"])
def test_clouds_of_any_layout(dtype: str, container: Container, read: Make) -> None:
    points = POINTS.astype(dtype)
    size = points.itemsize
    layout = {"step": 5 * size, "offsets": (2 * size, 4 * size, size)}
    cloud = read(MessageCloud, lambda m: m.cloud(UTC, points, **layout), container=container)
    assert np.array_equal(cloud, points.astype(np.float32))
    assert cloud.dtype == np.float32


def test_the_rows_of_an_organised_cloud_may_be_padded(read: Make) -> None:
    points = POINTS.astype("<f4")
    rows = np.zeros((5, 10 * 12 + 7), dtype=np.uint8)
    rows[:, :120] = points.view(np.uint8).reshape(5, 120)
    organised = {"height": 5, "width": 10, "row_step": 127, "data": rows.ravel()}
    cloud = read(MessageCloud, lambda m: m.cloud(UTC, points, **organised))
    assert np.array_equal(cloud, points)


def test_points_are_turned_and_those_that_are_none_dropped(read: Make) -> None:
    points = POINTS.astype("<f4")
    points[3, 1], points[4, 2], points[5, 0] = np.nan, np.inf, 1e9
    flu = tuple(R_OPTICAL_FLU.ravel().tolist())
    cloud = read(MessageCloud, lambda m: m.cloud(UTC, points), flu)
    kept = np.delete(points, [3, 4, 5], axis=0)
    assert np.array_equal(cloud, np.column_stack([-kept[:, 1], -kept[:, 2], kept[:, 0]]))
    half = cv2.Rodrigues(np.array([0.1, 0.2, 0.3]))[0]
    cloud = read(MessageCloud, lambda m: m.cloud(UTC, points), tuple(half.ravel().tolist()))
    np.testing.assert_allclose(cloud, kept @ half.T, rtol=1e-4, atol=1e-4)


TIMED = RNG.uniform(-20, 20, (200, 3))
AFTER_S = np.linspace(0.0, 0.0995, len(TIMED))


@pytest.mark.parametrize(
    ("name", "datatype", "dtype", "values"),
    [
        ("t", 6, "<u4", AFTER_S * 1e9),  # Ouster
        ("time", 7, "<f4", AFTER_S - 0.0995),  # Velodyne
        ("timestamp", 8, "<f8", UTC / 1e9 + AFTER_S),  # Hesai
        ("timestamp", 8, "<f8", UTC + AFTER_S * 1e9),  # Livox
        ("offset_time", 6, "<u4", AFTER_S * 1e9),
    ],
)
@pytest.mark.parametrize("container", ["bag", "mcap"])
def test_the_times_of_points(
    name: str, datatype: int, dtype: str, values: Any, container: Container, tmp_path: Path
) -> None:
    points = TIMED.astype("<f4")
    points[5, 0] = np.nan
    layout = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), (name, dtype)]
    cells = np.zeros(len(points), dtype=layout)
    for axis, column in zip("xyz", points.T, strict=True):
        cells[axis] = column
    cells[name] = np.rint(values) if dtype == "<u4" else values
    maker = Maker(container)
    kinds = {"x": 7, "y": 7, "z": 7, "intensity": 7, name: datatype}
    assert cells.dtype.fields is not None
    fields = [
        maker.of("sensor_msgs/msg/PointField", name=k, offset=o, datatype=kinds[k], count=1)
        for k, (_, o) in cells.dtype.fields.items()
    ]
    size = cells.dtype.itemsize
    more = {"fields": fields, "point_step": size, "row_step": size * len(points)}
    message = maker.cloud(UTC, points, **more, data=cells.view(np.uint8))
    path = bags.write_bag(tmp_path / "m", container, maker, [Said(UTC, "/t", message)])
    with open_bag(path) as bag:
        (found,) = bag.messages()
        # The frame's own time may be the recorder's: points go by the header's stamp.
        sweep = MessageCloud(found, UTC + 30_000_000).sweep()
    expected = np.delete(AFTER_S, 5) - (0.0995 if name == "time" else 0.0)
    assert np.array_equal(sweep.points_m, np.delete(points, 5, axis=0))
    assert sweep.after_s == pytest.approx(expected, abs=2e-6)


@pytest.mark.parametrize(
    ("fields", "match"),
    [
        ({"width": 51}, "too few"),
        ({"height": 2}, "too few"),
        ({"row_step": 10}, "too few"),
        ({"point_step": 0}, "too few"),
        ({"point_step": 8}, "no field z"),
        ({"width": 1 << 31, "height": 1 << 31}, "more than"),
        ({"fields": []}, "no field x"),
    ],
)
def test_absurd_clouds_are_told(fields: dict[str, Any], match: str, read: Make) -> None:
    points = POINTS.astype("<f4")
    with pytest.raises(RecordingError, match=rf"^/t @ {UTC}.*{match}"):
        read(MessageCloud, lambda m: m.cloud(UTC, points, **fields))


def test_an_empty_cloud_has_no_points(read: Make) -> None:
    cloud = read(MessageCloud, lambda m: m.cloud(UTC, POINTS[:0].astype("<f4")))
    assert cloud.shape == (0, 3)
