"""Which topic is what: by type, name, and what is given."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from fieldgrid.core import RecordingError
from fieldgrid.recordings.bag.topic_names import is_rectified
from fieldgrid.recordings.bag.topics import Choice, choose, static_transforms
from fieldgrid.recordings.ros.model import Topic

BAG = Path("drive.mcap")
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
    text: str,
    given: Mapping[str, str] | None = None,
    count: int = 9,
    sensor: str | None = None,
    partners: Mapping[str, str] | None = None,
) -> Choice:
    """The choice among topics written like `image /left/image_raw`, one a line."""
    topics = {}
    for line in text.split("\n"):
        if line.strip():
            kind, name = line.split()
            topics[name] = Topic(name, TYPES[kind], count)
    return choose(topics, given or {}, BAG, sensor=sensor, partners=partners)


def stereo(place: str, image: str = "image_rect", kind: str = "image") -> str:
    """A stereo pair with its calibration."""
    return "".join(
        f"{kind} {place}/{side}/{image}\ninfo {place}/{side}/camera_info\n"
        for side in ("left", "right")
    )


@pytest.mark.parametrize(
    ("left", "right", "left_info", "right_info"),
    [
        ("/left/image_raw", "/right/image_raw", "/left/camera_info", "/right/camera_info"),
        ("/cam0/image_raw", "/cam1/image_raw", "/cam0/camera_info", "/cam1/camera_info"),
        (
            "/camera/infra1/image_rect_raw",
            "/camera/infra2/image_rect_raw",
            "/camera/infra1/camera_info",
            "/camera/infra2/camera_info",
        ),
        (
            "/kitti/camera_gray_left/image_raw",
            "/kitti/camera_gray_right/image_raw",
            "/kitti/camera_gray_left/camera_info",
            "/kitti/camera_gray_right/camera_info",
        ),
        (
            "/zed/zed_node/left/color/rect/image",
            "/zed/zed_node/right/color/rect/image",
            "/zed/zed_node/left/color/rect/camera_info",
            "/zed/zed_node/right/color/rect/camera_info",
        ),
        ("/left_image", "/right_image", "/left_camera_info", "/right_camera_info"),
        (
            "/oak/left/image_rect/compressed",
            "/oak/right/image_rect/compressed",
            "/oak/left/camera_info",
            "/oak/right/camera_info",
        ),
    ],
)
def test_a_pair_is_told_by_its_names(
    left: str, right: str, left_info: str, right_info: str
) -> None:
    kind = "packed" if left.endswith("compressed") else "image"
    found = chosen(
        f"{kind} {left}\n{kind} {right}\ninfo {left_info}\ninfo {right_info}\n"
        "image /rear/image_raw\ninfo /rear/camera_info\n"
    )
    assert found.problem is None
    assert found.kind == "stereo"
    assert found.roles == {
        "left": left, "right": right, "left_info": left_info, "right_info": right_info,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("better", "worse"),
    [
        (("image", "image_rect"), ("image", "image_raw")),
        (("image", "image_rect"), ("image", "image_rect_color")),
        (("image", "image_rect"), ("packed", "image_rect/compressed")),
        (("packed", "image_rect/compressed"), ("image", "image_raw")),
        (("image", "image_mono"), ("image", "image_color")),
        (("image", "image_rect_color"), ("image", "image_color")),
    ],
)
def test_rectified_before_raw_grey_before_colour_plain_before_compressed(
    better: tuple[str, str], worse: tuple[str, str]
) -> None:
    text = "".join(stereo("/s", image, kind) for kind, image in (worse, better))
    assert chosen(text).roles["left"] == f"/s/left/{better[1]}"


def test_several_pairs_are_an_error_that_names_them_and_the_flag() -> None:
    text = stereo("/front") + stereo("/rear")
    problem = chosen(text).problem
    assert problem is not None
    for part in ("/front/left/image_rect", "/rear/right/image_rect", "--topic left="):
        assert part in str(problem)
    found = chosen(text, {"left": "/rear/left/image_rect"})
    assert found.problem is None
    assert found.roles["right"] == "/rear/right/image_rect"
    assert found.roles["right_info"] == "/rear/right/camera_info"


def test_what_is_given_outranks_names() -> None:
    text = stereo("/s") + "image /a\nimage /b\ninfo /c\ninfo /d\n"
    given = {"left": "/a", "right": "/b", "left_info": "/c", "right_info": "/d"}
    assert chosen(text, given).roles == given
    problem = chosen(text, {"left": "/a"}).problem
    assert problem is not None
    assert "add --topic right=" in str(problem)
    with pytest.raises(RecordingError, match="give two topics"):
        chosen(text, {"left": "/a", "right": "/a"})


def test_the_sensor_is_stereo_then_disparity_then_depth_then_cloud_or_the_given_one() -> None:
    depth = "image /d/depth/image_rect_raw\ninfo /d/depth/camera_info\n"
    disparity = "disparity /s/disparity\ninfo /s/left/camera_info\n"
    cloud = "cloud /lidar/points\n"
    everything = stereo("/s") + depth + disparity + cloud
    assert chosen(everything).kind == "stereo"
    found = chosen(depth + disparity + cloud)
    assert (found.kind, found.roles["left_info"]) == ("disparity", "/s/left/camera_info")
    found = chosen(depth + cloud)
    assert found.kind == "depth"
    assert found.roles["depth_info"] == "/d/depth/camera_info"
    assert chosen(cloud).kind == "cloud"
    assert chosen(everything, {"cloud": "/lidar/points"}).kind == "cloud"
    assert chosen(everything, sensor="depth").kind == "depth"
    assert chosen(cloud, sensor="depth").kind == ""
    problem = chosen(everything, {"cloud": "/lidar/points", "left": "/s/left/image_rect"}).problem
    assert problem is not None
    assert "give those of one" in str(problem)


def test_plain_depths_before_packed_ones_and_those_without_loss_first() -> None:
    info = "info /d/depth/camera_info"
    plain, whole, lossy = (
        f"/d/depth/image_rect{end}" for end in ("", "/compressedDepth", "/compressed")
    )
    found = chosen(f"image {plain}\npacked {whole}\npacked {lossy}\n{info}")
    assert found.roles["depth"] == plain
    found = chosen(f"packed {whole}\npacked {lossy}\n{info}")
    assert (found.roles["depth"], found.roles["depth_info"]) == (whole, "/d/depth/camera_info")


def test_the_depth_of_a_camera_may_be_called_stereo() -> None:
    text = "image /oak/stereo/image_raw\ninfo /oak/stereo/camera_info\nimage /oak/rgb/image_raw\n"
    found = chosen(text)
    assert (found.kind, found.roles["depth"]) == ("depth", "/oak/stereo/image_raw")
    assert found.roles["depth_info"] == "/oak/stereo/camera_info"
    assert chosen(text + stereo("/oak")).kind == "stereo"
    assert chosen("image /stereo/label/image_raw\nimage /mystereo/image_raw\n").kind == ""


@pytest.mark.parametrize(
    ("topic", "rectified"),
    [
        ("/left/image_rect", True),
        ("/left/image_rect_color/compressed", True),
        ("/camera/infra1/image_rect_raw", True),
        ("/left/color/rect/image", True),
        ("/left/color/raw/image", False),
        ("/left/image_raw", False),
        ("/direct/image", False),
        ("/rect_cam/left/image_raw", False),
    ],
)
def test_names_tell_whether_images_are_rectified(topic: str, rectified: bool) -> None:
    assert is_rectified(topic) is rectified


def test_a_bag_without_frames_has_no_problem_yet() -> None:
    found = chosen("fix /fix\nother /chatter\nimage /front/image_raw\n")
    assert (found.kind, found.problem) == ("", None)
    assert found.roles == {"fix": "/fix"}
    assert any("/front/image_raw" in note and "/chatter" not in note for note in found.notes)


@pytest.mark.parametrize(
    ("role", "text", "expected"),
    [
        ("imu", "imu /zed/imu/data\nimu /imu/data\nimu /imu/data_raw", "/imu/data"),
        ("imu", "imu /camera/accel/sample\nimu /camera/gyro/sample", "/camera/gyro/sample"),
        ("odometry", "odometry /odometry/gps\nodometry /odometry/filtered", "/odometry/filtered"),
        ("odometry", "odometry /filtered/global\nodometry /filtered/local", "/filtered/local"),
        ("odometry", "odometry /odometry/filtered\nodometry /wheel/odom", "/wheel/odom"),
        ("fix", "fix /gps/filtered\nfix /gps/fix", "/gps/fix"),
    ],
)
def test_of_several_sensors_the_vehicles_own_is_taken(role: str, text: str, expected: str) -> None:
    assert chosen(text).roles[role] == expected


def test_a_gyro_goes_with_the_accelerometer_beside_it() -> None:
    found = chosen("imu /camera/accel/sample\nimu /camera/gyro/sample").roles
    assert found == {"imu": "/camera/gyro/sample", "acceleration": "/camera/accel/sample"}
    assert "acceleration" not in chosen("imu /camera/accel/sample\nimu /imu/data").roles


@pytest.mark.parametrize("role", ["fix", "nmea", "imu", "odometry"])
def test_several_alike_are_an_error_that_names_them_and_the_flag(role: str) -> None:
    with pytest.raises(RecordingError, match=rf"for {role}: /a, /b; .*--topic {role}=/a"):
        chosen(f"{role} /b\n{role} /a")
    assert chosen(f"{role} /b\n{role} /a", {role: "/b"}).roles[role] == "/b"


def test_static_transforms_are_those_of_the_namespaces_in_use() -> None:
    tf = "tf2_msgs/msg/TFMessage"
    names = ("/tf_static", "/a/tf_static", "/b/tf_static", "/a/tf")
    topics = {name: Topic(name, tf, 1) for name in names}
    topics["/b/x/tf_static"] = Topic("/b/x/tf_static", "std_msgs/msg/String", 1)
    assert static_transforms(topics, {"fix": "/fix"}) == ["/tf_static"]
    assert static_transforms(topics, {"fix": "fix"}) == ["/tf_static"]
    assert static_transforms(topics, {"fix": "/a/fix"}) == ["/a/tf_static", "/tf_static"]
    assert static_transforms(topics, {"fix": "/ab/fix"}) == ["/tf_static"]


def test_topics_without_messages_are_not_taken() -> None:
    assert chosen(stereo("/s"), count=0).kind == ""
    with pytest.raises(RecordingError, match="has no message"):
        chosen(stereo("/s"), {"left": "/s/left/image_rect"}, count=0)


def test_a_depth_image_is_no_side_of_a_pair() -> None:
    found = chosen("image /left/depth\nimage /right/depth\ninfo /left/camera_info")
    assert found.kind in ("", "depth")


@pytest.mark.parametrize(
    "given", [{}, {"left": "/front/one/compressed", "right": "/front/two/compressed"}]
)
def test_a_calibration_below_its_image(given: dict[str, str]) -> None:
    text = "".join(
        f"packed /front/{name}/compressed\ninfo /front/{name}/camera_info\n"
        for name in ("one", "two")
    )
    partners = {"/front/one/camera_info": "/front/two/camera_info"}
    roles = chosen(text, given, partners=partners).roles
    assert roles["left"] == "/front/one/compressed"
    assert roles["left_info"] == "/front/one/camera_info"
    assert roles["right_info"] == "/front/two/camera_info"
