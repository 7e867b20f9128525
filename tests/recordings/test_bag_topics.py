"""Which topic is what: by type, name, and what is given."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from fieldgrid.core import RecordingError
from fieldgrid.recordings.bag.topics import Choice, choose, static_transforms
from fieldgrid.recordings.ros.model import Topic

TYPES = {
    "image": "sensor_msgs/msg/Image",
    "packed": "sensor_msgs/msg/CompressedImage",
    "info": "sensor_msgs/msg/CameraInfo",
    "disparity": "stereo_msgs/msg/DisparityImage",
    "cloud": "sensor_msgs/msg/PointCloud2",
    "fix": "sensor_msgs/msg/NavSatFix",
    "nmea": "nmea_msgs/msg/Sentence",
    "imu": "sensor_msgs/msg/Imu",
    "odometry": "nav_msgs/msg/Odometry",
    "other": "std_msgs/msg/String",
}


def chosen(
    text: str, given: Mapping[str, str] | None = None, count: int = 9, **more: Any
) -> Choice:
    """The choice among topics written like `image /left/image_raw`, comma after comma."""
    pairs = [one.split() for one in text.split(",") if one.strip()]
    topics = {name: Topic(name, TYPES[kind], count) for kind, name in pairs}
    return choose(topics, given or {}, Path("drive.mcap"), **more)


def stereo(left: str, right: str, *infos: str, kind: str = "image") -> str:
    """A pair, and calibrations beside it."""
    found = [f"{kind} {left}", f"{kind} {right}", *(f"info {info}" for info in infos)]
    return ",".join([*found, ""])


def pair(place: str, image: str = "image_rect", kind: str = "image") -> str:
    """A stereo pair with its calibration."""
    sides = [f"{place}/{side}" for side in ("left", "right")]
    return stereo(*(f"{s}/{image}" for s in sides), *(f"{s}/camera_info" for s in sides), kind=kind)


S, DEPTH = pair("/s"), "image /d/depth/image_rect_raw,info /d/depth/camera_info,"
DISPARITY, CLOUD = "disparity /s/disparity,info /s/left/camera_info,", "cloud /lidar/points,"
ALL = S + DEPTH + DISPARITY + CLOUD
OAK = "image /oak/stereo/image_raw,info /oak/stereo/camera_info,image /oak/rgb/image_raw,"
RECT = "/d/depth/image_rect"
WHOLE, LOSSY = f"packed {RECT}/compressedDepth,", f"packed {RECT}/compressed,"
NEUTRAL = "".join(f"packed /f/{n}/compressed,info /f/{n}/camera_info," for n in ("one", "two"))
PARTNERS = {"partners": {"/f/one/camera_info": "/f/two/camera_info"}}
OF_NEUTRAL = {"left": "/f/one/compressed", "right": "/f/two/compressed"}
INFOS_OF_NEUTRAL = {"left_info": "/f/one/camera_info", "right_info": "/f/two/camera_info"}


@pytest.mark.parametrize(
    ("left", "right", "left_info", "right_info"),
    [
        ("/left/image_raw", "/right/image_raw", "/left/camera_info", "/right/camera_info"),
        ("/cam0/image_raw", "/cam1/image_raw", "/cam0/camera_info", "/cam1/camera_info"),
        (
            *("/camera/infra1/image_rect_raw", "/camera/infra2/image_rect_raw"),
            *("/camera/infra1/camera_info", "/camera/infra2/camera_info"),
        ),
        (
            *("/kitti/camera_gray_left/image_raw", "/kitti/camera_gray_right/image_raw"),
            *("/kitti/camera_gray_left/camera_info", "/kitti/camera_gray_right/camera_info"),
        ),
        (
            *("/zed/node/left/color/rect/image", "/zed/node/right/color/rect/image"),
            *("/zed/node/left/color/rect/camera_info", "/zed/node/right/color/rect/camera_info"),
        ),
        ("/left_image", "/right_image", "/left_camera_info", "/right_camera_info"),
        (
            *("/oak/left/image_rect/compressed", "/oak/right/image_rect/compressed"),
            *("/oak/left/camera_info", "/oak/right/camera_info"),
        ),
    ],
)
def test_a_pair_is_told_by_its_names(
    left: str, right: str, left_info: str, right_info: str
) -> None:
    kind = "packed" if left.endswith("compressed") else "image"
    text = stereo(left, right, left_info, right_info, kind=kind)
    found = chosen(f"{text}image /rear/image_raw,info /rear/camera_info")
    assert (found.kind, found.problem) == ("stereo", None)
    roles = {"left": left, "right": right, "left_info": left_info, "right_info": right_info}
    assert found.roles == roles


@pytest.mark.parametrize(
    ("text", "more", "kind", "roles"),
    [
        # Rectified before raw, grey before colour, plain before compressed.
        *(
            (pair("/s", *worse) + pair("/s", *better), {}, "stereo",
             {"left": f"/s/left/{better[0]}"})
            for better, worse in (
                (("image_rect",), ("image_raw",)),
                (("image_rect",), ("image_rect_color",)),
                (("image_rect",), ("image_rect/compressed", "packed")),
                (("image_rect/compressed", "packed"), ("image_raw",)),
                (("image_mono",), ("image_color",)),
                (("image_rect_color",), ("image_color",)),
                (("color/rect/image",), ("color/raw/image",)),
                (("image_rect_color/compressed", "packed"), ("direct/image",)),
            )
        ),
        (pair("/f") + pair("/r"), {"given": {"left": "/r/left/image_rect"}}, "stereo",
         {"right": "/r/right/image_rect", "right_info": "/r/right/camera_info"}),
        # Stereo, disparity, depth, cloud, or what is asked for.
        (ALL, {}, "stereo", {"left": "/s/left/image_rect"}),
        (DEPTH + DISPARITY + CLOUD, {}, "disparity", {"left_info": "/s/left/camera_info"}),
        (DEPTH + CLOUD, {}, "depth", {"depth_info": "/d/depth/camera_info"}),
        (CLOUD, {}, "cloud", {"cloud": "/lidar/points"}),
        (ALL, {"given": {"cloud": "/lidar/points"}}, "cloud", {"cloud": "/lidar/points"}),
        (ALL, {"sensor": "depth"}, "depth", {"depth": "/d/depth/image_rect_raw"}),
        (CLOUD, {"sensor": "depth"}, "", {}),
        # Of depths plain ones, then those packed without loss; a camera may call them stereo.
        (f"image {RECT},{WHOLE}{LOSSY}info /d/camera_info", {}, "depth", {"depth": RECT}),
        (f"{WHOLE}{LOSSY}info /d/depth/camera_info", {}, "depth",
         {"depth": f"{RECT}/compressedDepth", "depth_info": "/d/depth/camera_info"}),
        (OAK, {}, "depth",
         {"depth": "/oak/stereo/image_raw", "depth_info": "/oak/stereo/camera_info"}),
        (OAK + pair("/oak"), {}, "stereo", {}),
        ("image /stereo/label/image_raw,image /mystereo/image_raw", {}, "", {}),
        ("image /left/mask,image /right/mask,image /left/theora,image /right/theora", {}, "", {}),
        # Of several sensors the vehicle's own, that is no result of others.
        ("imu /zed/imu/data,imu /imu/data,imu /imu/data_raw", {}, "", {"imu": "/imu/data"}),
        ("imu /c/accel/sample,imu /c/gyro/sample", {}, "",
         {"imu": "/c/gyro/sample", "acceleration": "/c/accel/sample"}),
        ("imu /c/accel/sample,imu /imu/data", {}, "", {"imu": "/imu/data"}),
        ("odometry /odom/gps,odometry /odom/filtered", {}, "", {"odometry": "/odom/filtered"}),
        ("odometry /f/global,odometry /f/local", {}, "", {"odometry": "/f/local"}),
        ("odometry /odom/filtered,odometry /wheel/odom", {}, "", {"odometry": "/wheel/odom"}),
        ("fix /gps/filtered,fix /gps/fix", {}, "", {"fix": "/gps/fix"}),
        ("fix /fix,other /chatter,image /front/image_raw", {}, "", {"fix": "/fix"}),
        # A calibration may lie below its image; the names of a pair may say nothing.
        (NEUTRAL, PARTNERS, "stereo", {**OF_NEUTRAL, **INFOS_OF_NEUTRAL}),
        (NEUTRAL, {"given": OF_NEUTRAL}, "stereo", {**OF_NEUTRAL, **INFOS_OF_NEUTRAL}),
        (S, {"count": 0}, "", {}),
    ],
)  # fmt: skip
def test_topics_have_roles(
    text: str, more: dict[str, Any], kind: str, roles: dict[str, str]
) -> None:
    found = chosen(text, **more)
    assert (found.kind, found.problem) == (kind, None)
    assert roles.items() <= found.roles.items()
    if not kind:
        assert found.roles == roles
    if "chatter" in text:
        (note,) = (note for note in found.notes if note.startswith("Not used"))
        assert "/front/image_raw" in note
        assert "/chatter" not in note


def test_what_is_given_outranks_names() -> None:
    given = {"left": "/a", "right": "/b", "left_info": "/c", "right_info": "/d"}
    assert chosen(S + stereo("/a", "/b", "/c", "/d"), given).roles == given


@pytest.mark.parametrize(
    ("text", "given", "match"),
    [
        (pair("/f") + pair("/r"), {}, "/f/left/image_rect .*/r/right/image_rect.*--topic left="),
        (S + stereo("/a", "/b"), {"left": "/a"}, "add --topic right="),
        (ALL, {"cloud": "/lidar/points", "left": "/s/left/image_rect"}, "give those of one"),
    ],
)
def test_what_is_open_about_the_frames_is_kept(
    text: str, given: dict[str, str], match: str
) -> None:
    problem = chosen(text, given).problem
    assert problem is not None
    with pytest.raises(RecordingError, match=match):
        raise problem


@pytest.mark.parametrize("role", ["fix", "nmea", "imu", "odometry"])
def test_several_alike_are_an_error_that_names_them_and_the_flag(role: str) -> None:
    with pytest.raises(RecordingError, match=rf"for {role}: /a, /b; .*--topic {role}=/a"):
        chosen(f"{role} /b,{role} /a")
    assert chosen(f"{role} /b,{role} /a", {role: "/b"}).roles[role] == "/b"


@pytest.mark.parametrize(
    ("given", "count", "match"),
    [
        ({"left": "/s/left/image_rect"}, 0, "has no message"),
        ({"left": "/s/left/image_rect", "right": "/s/left/image_rect"}, 9, "give two topics"),
    ],
)
def test_what_is_given_has_to_be_there(given: dict[str, str], count: int, match: str) -> None:
    with pytest.raises(RecordingError, match=match):
        chosen(S, given, count)


@pytest.mark.parametrize(
    ("fix", "expected"),
    [
        ("/fix", ["/tf_static"]),
        ("fix", ["/tf_static"]),
        ("/a/fix", ["/a/tf_static", "/tf_static"]),
        ("/ab/fix", ["/tf_static"]),
    ],
)
def test_static_transforms_are_those_of_the_namespaces_in_use(
    fix: str, expected: list[str]
) -> None:
    names = ("/tf_static", "/a/tf_static", "/b/tf_static", "/a/tf")
    topics = {name: Topic(name, "tf2_msgs/msg/TFMessage", 1) for name in names}
    topics["/b/x/tf_static"] = Topic("/b/x/tf_static", "std_msgs/msg/String", 1)
    assert static_transforms(topics, {"fix": fix}) == expected
