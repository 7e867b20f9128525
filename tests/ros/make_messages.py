"""Builds the message packages of ROS 2 that are no wheels: `python make_messages.py PREFIX`.

Every installation of ROS 2 has them. They are built with the generators and CMake rules that are
wheels, for the Python that runs this.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
from pathlib import Path

PACKAGES = {
    "tf2_msgs": {"TFMessage": "geometry_msgs/TransformStamped[] transforms"},
    "map_msgs": {
        "OccupancyGridUpdate": "std_msgs/Header header\nint32 x\nint32 y\nuint32 width\n"
        "uint32 height\nint8[] data"
    },
    "geographic_msgs": {"GeoPoint": "float64 latitude\nfloat64 longitude\nfloat64 altitude"},
    "nav2_msgs": {
        "CostmapFilterInfo": "std_msgs/Header header\nuint8 type\nstring filter_mask_topic\n"
        "float32 base\nfloat32 multiplier"
    },
}
"""The messages of each package by their names, as far as they are used."""

CMAKE = """cmake_minimum_required(VERSION 3.8)
project({name})
find_package(ament_cmake REQUIRED)
find_package(rosidl_default_generators REQUIRED)
find_package(std_msgs REQUIRED)
find_package(geometry_msgs REQUIRED)
rosidl_generate_interfaces({name} {files} DEPENDENCIES std_msgs geometry_msgs)
ament_package()
"""

PACKAGE = """<?xml version="1.0"?>
<package format="3"><name>{name}</name><version>0.0.1</version><description>{name}</description>
<maintainer email="nobody@example.com">nobody</maintainer><license>BSD</license>
<buildtool_depend>ament_cmake</buildtool_depend>
<buildtool_depend>rosidl_default_generators</buildtool_depend>
<depend>std_msgs</depend><depend>geometry_msgs</depend>
<member_of_group>rosidl_interface_packages</member_of_group></package>
"""


def build(name: str, messages: dict[str, str], prefix: Path) -> None:
    """Build a package, and install it into the environment of this Python."""
    folder = prefix / name
    (folder / "msg").mkdir(parents=True, exist_ok=True)
    files = [f"msg/{message}.msg" for message in messages]
    for file, text in zip(files, messages.values(), strict=True):
        (folder / file).write_text(f"{text}\n")
    quoted = " ".join(f'"{file}"' for file in files)
    (folder / "CMakeLists.txt").write_text(CMAKE.format(name=name, files=quoted))
    (folder / "package.xml").write_text(PACKAGE.format(name=name))
    site = next(path for path in sys.path if path.endswith("site-packages"))
    place = sys.prefix
    about = {"AMENT_PREFIX_PATH": place, "CMAKE_PREFIX_PATH": place, "PYTHONPATH": site}
    about["PATH"] = f"{place}/bin:{os.environ['PATH']}"
    definitions = {
        "Python3_EXECUTABLE": sys.executable,
        "CMAKE_INSTALL_PREFIX": place,
        "PYTHON_INSTALL_DIR": os.path.relpath(site, place),
        "CMAKE_BUILD_TYPE": "Debug",  # compiles in half the time
    }
    given = [f"-D{key}={value}" for key, value in definitions.items()]
    for order in (
        ["cmake", "-S", folder, "-B", folder / "build", *given],
        ["cmake", "--build", folder / "build", "--parallel", "2"],
        ["cmake", "--install", folder / "build"],
    ):
        done = subprocess.run(order, env=os.environ | about, capture_output=True, text=True)
        if done.returncode:
            sys.exit(f"{name}: {done.stdout[-2000:]}{done.stderr[-2000:]}")


def point_to_headers() -> None:
    """The wheels name the headers of the Python that they were built with; name those of this."""
    import numpy

    built = "/opt/python/cp312-cp312"
    own = {
        f"{built}/include/python3.12": sysconfig.get_path("include"),
        f"{built}/lib/python3.12/site-packages/numpy/_core/include": numpy.get_include(),
    }
    for file in Path(sys.prefix, "share").glob("*/cmake/*Export*.cmake"):
        text = file.read_text()
        if built in text:
            for theirs, ours in own.items():
                text = text.replace(theirs, ours)
            file.write_text(text)


if __name__ == "__main__":
    point_to_headers()
    for name, messages in PACKAGES.items():
        build(name, messages, Path(sys.argv[1]))
