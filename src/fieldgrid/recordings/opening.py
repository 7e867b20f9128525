"""One way to open a drive, whatever its format."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

from fieldgrid.core import LackingError, NoFramesError, RecordingError
from fieldgrid.recordings.calibration.mounting import Mounting
from fieldgrid.recordings.cutting import cut
from fieldgrid.recordings.drive import Drive, Recording, no_fixes
from fieldgrid.recordings.format import Format, find_format, formats, register_format
from fieldgrid.recordings.frames.frame_table import TABLE
from fieldgrid.recordings.options import DriveOptions
from fieldgrid.recordings.poses.given_poses import with_given_poses
from fieldgrid.recordings.readers import euroc, folder, kitti, kitti_odometry
from fieldgrid.recordings.readers.foreign import about_folder, refuse_foreign
from fieldgrid.recordings.remote.copies import is_url
from fieldgrid.recordings.remote.fetched import fetch
from fieldgrid.recordings.tables import logs
from fieldgrid.recordings.tables.columns import Columns


def _late(module: str, name: str) -> Callable[..., Any]:
    """A function of this room whose module is imported when it is called."""
    return lambda *given: getattr(import_module(f"fieldgrid.recordings.{module}"), name)(*given)


BAG = Format(
    "ROS bag",
    "a ROS 1 .bag, an .mcap or .db3, or the folder of one that is several files",
    _late("ros.bag", "is_bag"),
    _late("bag.opening", "open_bag_drive"),
    _late("bag.opening", "mounting_path"),
)

for _format in (
    logs.FORMAT,
    BAG,
    folder.FORMAT,
    euroc.FORMAT,
    kitti_odometry.FORMAT,
    kitti.FORMAT,
):
    register_format(_format)


def open_drive(path: str | Path, options: DriveOptions | None = None) -> Drive:
    """The drive at a path: a recording, a bag, a folder without images, or a GNSS log alone.

    A URL that fsspec knows, like `s3://vines/june-03`, is copied to this machine first
    (`recordings.remote.fetched`).
    Use it as a context manager. `Drive.recording` gives it as one with
    frames. What is wrong is a RecordingError, a GnssError or a ConfigError that says what to do.
    """
    path = fetch(path) if is_url(path) else Path(path)
    try:
        if not (path.is_file() or path.is_dir()):
            what = "is neither a file nor a folder" if path.exists() else "does not exist"
            raise RecordingError(
                f"{path} {what}; give the folder of a recording, a bag, or a GNSS log."
            )
        if path.name == TABLE:
            raise RecordingError(f"{path} lists the frames of a recording; give its folder.")
        found = find_format(path)
        if found is BAG:
            refuse_foreign(path)  # ZED's container is that of ROS, its content is not
        if found is None:
            kinds = "; ".join(f"{one.looks_for} ({one.name})" for one in formats())
            raise RecordingError(
                f"{path} is no recording; looked for {kinds}; give one of these."
                f"{about_folder(path)}"
            )
        options = options or DriveOptions()
        drive = replace(found.open(path, options), kind=found.name)
        given = drive.pose_source
        if options.poses is not None:
            given = options.poses.over(given)
        lacks = drive.refusal is not None and not isinstance(drive.refusal, NoFramesError)
        if lacks and given is None and not len(drive.fixes()):
            assert drive.refusal is not None
            drive = replace(
                drive, refusal=LackingError(drive.refusal, no_fixes(drive.name, drive.log.notes))
            )
        try:
            drive = with_given_poses(drive, given, options.epoch_ns)
            return cut(drive, options.from_ns, options.until_ns)
        except BaseException:
            drive.close()
            raise
    except OSError as problem:
        raise RecordingError(
            f"{problem.filename or path} cannot be read: {problem.strerror}; check its permissions."
        ) from problem


def open_recording(
    path: str | Path,
    gnss: str | Path | None = None,
    columns: Columns | None = None,
    *,
    topics: Mapping[str, str] | None = None,
    mounting: str | Path | Mounting | None = None,
    image_time_offset_ns: int | None = None,
) -> Recording:
    """:func:`open_drive` of a drive that must have frames, with the options by name."""
    own = mounting if isinstance(mounting, Mounting | None) else Path(mounting)
    drive = open_drive(path, DriveOptions(gnss, columns, topics or {}, own, image_time_offset_ns))
    try:
        return drive.recording()
    except BaseException:
        drive.close()
        raise
