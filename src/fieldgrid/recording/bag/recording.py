"""A bag as a recording: frames as a stream, the rest read once when it opens."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Self

from fieldgrid.array_types import Int64
from fieldgrid.errors import RecordingError
from fieldgrid.fixes import FixColumns
from fieldgrid.geodesy import Datum
from fieldgrid.motion import Motion
from fieldgrid.recording.bag.drive import find_motion
from fieldgrid.recording.bag.frames import Plan, Taken, read_frames
from fieldgrid.recording.bag.mounts import find_mounting
from fieldgrid.recording.bag.opened import Opened, read_bag
from fieldgrid.recording.bag.sensed import find_lidar, frame_maker, sense
from fieldgrid.recording.bag.topics import short
from fieldgrid.recording.bare import BareDrive
from fieldgrid.recording.options import Options
from fieldgrid.recording.protocol import Frame, Stream
from fieldgrid.rig import Rig
from fieldgrid.ros import Bag, is_bag, open_bag

LOOKS_FOR = "a ROS 1 .bag, an .mcap or .db3, or the folder of one that is several files"


def recognises(path: Path) -> bool:
    """Whether a path is a bag."""
    return is_bag(path)


@dataclass(frozen=True, slots=True)
class BagRecording:
    """A :class:`~fieldgrid.recording.protocol.Recording` in a bag, which it holds open.

    Images stay in the bag; a frame holds the bytes of its own messages.
    """

    name: str
    rig: Rig
    path: Path
    bag: Bag
    plan: Plan
    make_frame: Callable[[int, int, tuple[Taken, ...]], Frame]
    fix_log: FixColumns
    gnss_source: str
    datum_hint: Datum | None
    notes: tuple[str, ...]
    own_motion: Motion
    losses: tuple[str, ...]
    roles: Mapping[str, str]
    fixes_sha256: str
    stack: ExitStack = field(repr=False, compare=False)

    @property
    def frame_count(self) -> int:
        """How many frames there are."""
        return len(self.plan.time_ns)

    def frame_times_ns(self) -> Int64:
        """Times of the frames, shape (frame_count,), increasing."""
        return self.plan.time_ns.copy()

    def frames(self) -> Iterator[Frame]:
        """The frames in order of time, images undecoded."""
        times_ns = self.plan.time_ns.tolist()
        for k, taken in enumerate(read_frames(self.bag, self.plan)):
            yield self.make_frame(k, times_ns[k], taken)

    def fixes(self) -> FixColumns:
        """The fixes in the order of the log."""
        return self.fix_log

    def gnss_sha256(self) -> str:
        """The hash of the messages of the fixes' topic one after the other, or of the log."""
        return self.fixes_sha256

    def motion(self) -> Motion:
        """What the drive knows of its own motion."""
        return self.own_motion

    def streams(self) -> Sequence[Stream]:
        """Every topic of the bag, with the stamps of its messages and when they were recorded."""
        return _streams(self.bag, self.roles)

    def close(self) -> None:
        """Close the bag."""
        self.stack.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()


def open_recorded(path: Path, options: Options) -> BagRecording:
    """The recording in a bag. Raises RecordingError for one that has nothing to make frames of,
    and CalibrationError where nothing tells the rig."""
    with ExitStack() as stack:
        bag = stack.enter_context(open_bag(path))
        opened = read_bag(bag, path, options)
        return _recording(opened, options, stack)


def open_drive(path: Path, options: Options) -> BagRecording | BareDrive:
    """What a bag tells of a drive of which no image is wanted.

    Without frames or without a rig it is a bare drive, and says why.
    """
    with ExitStack() as stack:
        bag = stack.enter_context(open_bag(path))
        opened = read_bag(bag, path, options)
        try:
            return _recording(opened, options, stack)
        except RecordingError as problem:
            moved, notes = find_motion(opened.readings, opened.choice.roles, None)
            return BareDrive(
                opened.fixes.fixes,
                _joined(moved, opened.fixes.motion),
                None,
                opened.fixes.source,
                (*_losses(bag), _without_frames(opened, problem), *opened.notes, *notes),
                _streams(bag, opened.choice.roles),
            )


def _streams(bag: Bag, roles: Mapping[str, str]) -> tuple[Stream, ...]:
    role_of = {topic: role for role, topic in roles.items()}
    return tuple(
        Stream(name, short(topic.type), role_of.get(name, ""), topic.count, *bag.stamps(name))
        for name, topic in bag.topics.items()
    )


def _losses(bag: Bag) -> tuple[str, ...]:
    return (bag.damage,) if bag.damage else ()


def _without_frames(opened: Opened, problem: RecordingError) -> str:
    if not opened.choice.kind and opened.choice.problem is None:
        return "There are no images, so the poses are those of the antenna."
    return f"The poses are those of the antenna: {problem}"


def _recording(opened: Opened, options: Options, stack: ExitStack) -> BagRecording:
    bag, path, readings = opened.bag, opened.path, opened.readings
    sensed = sense(opened)
    antenna = readings.frame_ids.get(opened.fixes.role, "")
    mounted = find_mounting(path, options, readings, sensed.frame, antenna)
    R = mounted.R_sensor @ sensed.frame.R
    sensor = sensed.sensor or find_lidar(opened, sensed.plan, R)
    moved, notes = find_motion(readings, opened.choice.roles, mounted.mounting)
    return BagRecording(
        name=opened.settings.name or (path.resolve().name if path.is_dir() else path.stem),
        rig=mounted.mounting.rig(sensor, options.offset_or(opened.settings.image_time_offset_ns)),
        path=path,
        bag=bag,
        plan=sensed.plan,
        make_frame=frame_maker(opened, sensed, sensor, R),
        fix_log=opened.fixes.fixes,
        gnss_source=opened.fixes.source,
        datum_hint=opened.settings.datum,
        notes=(*opened.notes, *sensed.plan.notes, *sensed.notes, *mounted.notes, *notes),
        own_motion=_joined(moved, opened.fixes.motion),
        losses=_losses(bag),
        roles=opened.choice.roles,
        fixes_sha256=opened.fixes.sha256,
        stack=stack.pop_all(),  # the bag is open from here on for the recording
    )


def _joined(moved: Motion, of_log: Motion) -> Motion:
    return moved._replace(gyro=moved.gyro or of_log.gyro, wheels=moved.wheels or of_log.wheels)
