"""Where a live session takes images and fixes from, by the options of `fieldgrid live`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from fieldgrid.cli.drive_options import DriveFlags
from fieldgrid.core import quoted

if TYPE_CHECKING:
    import threading

    from fieldgrid.cli.pose_flags import PoseFlags
    from fieldgrid.geometry import Datum, Rig
    from fieldgrid.live import Live, RosSession
    from fieldgrid.recordings import DriveOptions, GrowingFolder, PairKind, PoseBody, Recording

_PANEL = "Sources"

GNSS = typer.Option(
    "--gnss",
    metavar="URL|FILE",
    help="The receiver: tcp://HOST:PORT, udp://[HOST]:PORT, gpsd://HOST[:PORT], "
    "serial:/dev/ttyUSB0?baud=115200, a FIFO, or - for standard input. With --replay: the "
    "name of a GNSS log in the recording, or the path of another.",
    rich_help_panel=_PANEL,
)


class SourceFlags(NamedTuple):
    """Sources of images, and who looks on."""

    images: Annotated[
        Path | None,
        typer.Option(
            "--images",
            metavar="FOLDER",
            help="Read images as they appear in a folder with the layout of a recording.",
            rich_help_panel=_PANEL,
        ),
    ] = None
    camera: Annotated[
        str | None,
        typer.Option(
            "--camera",
            metavar="N|L,R",
            help="Read images of a UVC camera: one device with left and right side by side, or "
            "two devices.",
            rich_help_panel=_PANEL,
        ),
    ] = None
    mcap: Annotated[
        str | None,
        typer.Option(
            "--mcap",
            metavar="-|FIFO|URL",
            help="Read images or clouds, fixes, gyro and wheels from an MCAP stream: standard "
            "input, a FIFO, or tcp://HOST:PORT.",
            rich_help_panel=_PANEL,
        ),
    ] = None
    ros: Annotated[
        bool,
        typer.Option(
            "--ros",
            help="Be a node of ROS 2: take images, depths or clouds, fixes, IMU and odometry "
            "from its topics, and publish costmap, pose and map. Behind --ros-args: remappings.",
            rich_help_panel=_PANEL,
        ),
    ] = False
    camera_fps: Annotated[
        float,
        typer.Option(
            "--camera-fps",
            metavar="N",
            help="Largest rate of --camera, pairs per second.",
            rich_help_panel=_PANEL,
        ),
    ] = 10.0
    rig: Annotated[
        Path | None,
        typer.Option(
            "--rig",
            metavar="FOLDER",
            help="Folder of a recording with the calibration/ of --camera or --mcap; for a "
            "lidar in --mcap, with its mounting.",
            rich_help_panel=_PANEL,
        ),
    ] = None
    gnss_log: Annotated[
        Path | None,
        typer.Option(
            "--gnss-log",
            metavar="FILE",
            help="Append the receiver's data to a log such as FOLDER/gnss/log.nmea, which "
            "--finish-from FOLDER needs.",
            rich_help_panel=_PANEL,
        ),
    ] = None
    feed: Annotated[
        str | None,
        typer.Option(
            "--feed",
            metavar="tcp://HOST:PORT",
            help="Send the costmap around the vehicle to every client that connects (HOST "
            "127.0.0.1: from this machine only).",
            rich_help_panel=_PANEL,
        ),
    ] = None
    view: Annotated[
        str | None,
        typer.Option(
            "--view",
            metavar="[HOST:]PORT",
            help="Serve a page that follows the vehicle, to this machine only unless HOST is "
            "given; port 0 picks a free port.",
            rich_help_panel=_PANEL,
        ),
    ] = None
    foxglove: Annotated[
        str | None,
        typer.Option(
            "--foxglove",
            metavar="[HOST:]PORT",
            help="Accept connections from Foxglove, from this machine only unless HOST is "
            "given; its usual port is 8765.",
            rich_help_panel=_PANEL,
        ),
    ] = None
    points_gb: Annotated[
        float | None,
        typer.Option(
            "--points-gb",
            metavar="GB",
            help="Disk space for the points of frames, from which the grids of a drive with roll "
            "and pitch are made level at its end; with 0 they stay perpendicular to the ground "
            "ahead [default: 50].",
            rich_help_panel=_PANEL,
        ),
    ] = None


class LiveInput(NamedTuple):
    """What a session is made for, and how it is pushed to, until the event is set; `run` returns
    whether all was pushed before."""

    rig: Rig
    name: str
    datum_hint: Datum | None
    source: str
    source_sha256: str
    notes: tuple[str, ...]
    poses: PoseBody | None
    run: Callable[[Live, threading.Event], bool]


def of_recording(found: Recording, rate: float | None) -> LiveInput:
    """A recording that is replayed."""
    from fieldgrid.live import replay

    return LiveInput(
        found.rig,
        found.name,
        found.datum_hint,
        found.gnss_source,
        found.gnss_sha256(),
        (*found.losses, *found.notes),
        found.pose_body,
        lambda live, stop: replay(live, found, rate=rate, stop=stop),
    )


def of_ros(ros: RosSession) -> LiveInput:
    """What the topics of ROS say, once a drive has begun."""
    import threading

    found = ros.wait(threading.Event())
    about = found.rig, found.name, found.datum_hint, found.gnss_source, "", found.notes
    return LiveInput(*about, None, ros.run)


def of_sources(flags: SourceFlags, drive: DriveFlags, poses: PoseFlags) -> LiveInput:
    """A receiver and a folder or a camera; a usage error where one of them is not said."""
    from fieldgrid.live import (
        ImageFolder,
        InputSource,
        McapStream,
        PoseTopic,
        Receiver,
        Sources,
        StereoDevices,
        parse_devices,
    )
    from fieldgrid.recordings import AXES, CAMERA_AXES, PoseBody, folder_mounting_path, open_growing

    if flags.mcap is None and drive.gnss is None:
        raise typer.BadParameter("say where the receiver is", param_hint="--gnss")
    receiver = None if drive.gnss is None else Receiver(drive.gnss, flags.gnss_log)
    images: InputSource
    body, pose_topic = None, None
    if flags.mcap is not None:
        folder = _rig(flags, replace(drive.options(), epoch_ns=None))  # it is of the stream
        mounting = drive.options().find_mounting(folder_mounting_path(folder.path), folder.path)
        said = poses.source()
        if said is not None:
            if said.topic is None:
                raise typer.BadParameter(
                    "say which topic of the MCAP has the poses", param_hint="--poses-topic"
                )
            axes = said.axes or AXES
            body = PoseBody(said.topic, axes, said.point_flu_m)
            offset_ns = said.offset_ns
            if offset_ns is None:  # those of a camera have the stamps of its images
                offset_ns = folder.rig.image_time_offset_ns if axes == CAMERA_AXES else 0
            pose_topic = PoseTopic(said.topic, offset_ns)
        images = McapStream(
            flags.mcap,
            folder.kind,
            drive.options().topics,
            imu_axes=mounting.imu_axes,
            takes_fixes=receiver is None,
            poses=pose_topic,
            epoch_ns=drive.options().epoch_ns,
        )
    elif flags.camera is None:
        assert flags.images is not None
        folder = open_growing(flags.images, drive.options())
        images = ImageFolder(folder)
    else:
        devices = parse_devices(flags.camera)
        folder, kind = _camera_rig(flags, drive)
        images = StereoDevices(devices, folder.rig, kind.rectifier, most_fps=flags.camera_fps)
    all_of_them = (images,) if receiver is None else (receiver, images)
    source = drive.gnss or flags.mcap or ""

    def run(live: Live, stop: threading.Event) -> bool:
        with Sources(live, all_of_them) as sources:
            while not (stop.is_set() or sources.wait(_LOOK_S)):
                pass
        return not stop.is_set()

    about = folder.rig, folder.name, folder.datum_hint, source, "", folder.notes
    return LiveInput(*about, body, run)


def _camera_rig(flags: SourceFlags, drive: DriveFlags) -> tuple[GrowingFolder, PairKind]:
    """The folder of --rig, which must be that of a stereo camera, and what its pairs are."""
    from fieldgrid.core import ConfigError
    from fieldgrid.recordings import PairKind

    folder = _rig(flags, drive.options())
    if not isinstance(folder.kind, PairKind):
        raise ConfigError(f"{flags.rig} is of no stereo pair; give the rig of the camera.")
    return folder, folder.kind


def _rig(flags: SourceFlags, options: DriveOptions) -> GrowingFolder:
    """The folder of --rig."""
    from fieldgrid.recordings import open_growing

    if flags.rig is None:
        raise typer.BadParameter(
            "say which folder has the calibration/ of the camera or the lidar", param_hint="--rig"
        )
    return open_growing(flags.rig, options)


_LOOK_S = 0.2
"""How often it is looked whether the session is to end."""


def speed(text: str) -> float | None:
    """How fast, None for as fast as can be."""
    if text == "max":
        return None
    try:
        rate = float(text)
    except ValueError:
        rate = math.nan
    if not 0.01 <= rate <= 1000.0:
        raise typer.BadParameter(
            f"{quoted(text)} is neither 0.01 to 1000 nor max", param_hint="--rate"
        )
    return rate
