"""What is small in a bag, once it was opened: which topics are used, fixes, motion, transforms."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64, GnssError, Int64, RecordingError, quoted
from fieldgrid.geometry import FixColumns, Gyro, Motion, Orientation, RecordedTilt, WheelSpeed
from fieldgrid.recordings.bag.leaning import ODOMETRY_FRAME_SIGMA_DEG, Untold, orientation_of
from fieldgrid.recordings.bag.listeners import Numbers, Sentences, Texts
from fieldgrid.recordings.bag.readings import Readings
from fieldgrid.recordings.bag.sensors.mounts import imu_rotation, is_optical
from fieldgrid.recordings.bag.topics import (
    FIX,
    FIXES,
    IMU,
    NMEA,
    Choice,
    choose,
    listing,
    short,
    static_transforms,
)
from fieldgrid.recordings.bag.transforms import Transforms
from fieldgrid.recordings.bag.trees import forward_speeds
from fieldgrid.recordings.drive import Drive
from fieldgrid.recordings.options import DriveOptions
from fieldgrid.recordings.readers.settings_file import SETTINGS, RecordingSettings, read_settings
from fieldgrid.recordings.ros.bag import Bag
from fieldgrid.recordings.ros.gnss_messages import DETAILS, ORIENTATION, TILT, Details
from fieldgrid.recordings.tables.fix_log import FixLog
from fieldgrid.recordings.tables.logs import chosen_log
from fieldgrid.recordings.tables.motion_files import (
    AXES,
    R_VEHICLE_FLU,
    MotionSeries,
    directions,
    gravity_unit_mps2,
    in_order,
    inertial_of,
    skipped,
)
from fieldgrid.recordings.tables.stream_log import nmea_notes

OPTICAL_AXES = "rdf"
TAKEN = f"axes taken as {AXES}"
_GRAVITY_SHARE = 0.95
"""Of what an accelerometer feels, an axis that is upright feels this much."""

_UPRIGHT = 0.5
"""Of an axis along the vertical, more than this is along it."""
_FIX_ROLES = {NMEA: "nmea", FIX: "fix"}


class BagFixes(NamedTuple):
    """The fixes of a drive with remarks and the motion of a log; the log, or the topic with the
    hash of its messages, that they are from."""

    log: FixLog
    path: Path | None = None
    topic: str = ""
    sha256: str = ""

    @property
    def source(self) -> str:
        """The name of what they are from."""
        return self.topic if self.path is None else self.path.name


@dataclass(frozen=True, slots=True)
class BagIndex:
    """A bag after the one run over it, before anything is made of its frames."""

    bag: Bag
    path: Path
    settings: RecordingSettings
    settings_path: Path
    choice: Choice
    readings: Readings
    transforms: Transforms
    fixes: BagFixes

    @property
    def roles(self) -> Mapping[str, str]:
        """The topics that are used, by their roles."""
        return self.choice.roles

    @property
    def folder(self) -> Path:
        """Where files that belong to the bag lie."""
        return self.path if self.path.is_dir() else self.path.parent

    def frame_id(self, role: str) -> str:
        """The frame of the messages of a role, empty where there are none."""
        return self.readings.frame_id(self.roles.get(role))

    def notes(self) -> tuple[str, ...]:
        """Remarks on what was read so far."""
        files = self.bag.files
        read = f"{len(files)} files are read as one drive: {files[0]} to {files[-1]}."
        several = (read,) if len(files) > 1 else ()
        of_topics = self.readings.notes(self.roles.values())
        return (*several, *self.choice.notes, *self.fixes.log.notes, *of_topics)


def read_content(bag: Bag, path: Path, options: DriveOptions, readings: Readings) -> BagIndex:
    """What is small in a bag, and which of its topics are used. Raises RecordingError where that
    is left open, but not for what concerns the frames alone."""
    settings_path = _settings_path(path)
    settings = read_settings(settings_path)
    for key in ("frames", "bayer", "start", "scale"):
        if getattr(settings, key) is not None:
            raise RecordingError(
                f"{settings_path}: {key} is for folders of files, and the messages of a bag say it "
                "themselves; leave it out."
            )
    log_path, gnss_topic = _choose_gnss(bag, options.gnss)
    given = {**options.topics, **gnss_topic}
    unwanted = FIXES - given.keys() if options.gnss is not None else frozenset[str]()
    partners = readings.stereo_infos()
    choice = choose(bag.topics, given, path, unwanted, settings.sensor, partners)
    if log_path is None:
        options.refuse("The fixes of a bag are no table", "columns")
        fixes = _fixes_of_topics(bag, readings, choice.roles)
    else:
        log = chosen_log(log_path, settings, options)
        fixes = BagFixes(log, log_path)
    fixes = fixes._replace(log=options.in_time(fixes.log, settings.gnss_offset_ns))
    used = {r: topic for r, topic in choice.roles.items() if r not in FIXES or topic == fixes.topic}
    for role in {"imu", "acceleration", "odometry", "attitude"} & used.keys():
        try:
            readings.times_ns(bag, used[role])
        except RecordingError as problem:
            readings.leave_out(used.pop(role), str(problem))
    if "odometry" not in used and (moving := readings.moving(bag)) is not None:
        used["odometry"] = moving[0]
    return BagIndex(
        bag,
        path,
        settings,
        settings_path,
        choice._replace(roles=used),
        readings,
        readings.transforms(static_transforms(bag.topics, choice.roles)),
        fixes,
    )


def _settings_path(path: Path) -> Path:
    """The settings in the folder of a bag; beside a file first those that have its name."""
    if path.is_dir():
        return path / SETTINGS
    own = path.with_suffix(".toml")
    return own if own.exists() else path.with_name(SETTINGS)


def _choose_gnss(bag: Bag, gnss: str | Path | None) -> tuple[Path | None, dict[str, str]]:
    """What `--gnss` means for a bag: a log beside it or anywhere, or one of its topics by the role
    that it gets; neither when nothing is asked for."""
    if gnss is None:
        return None, {}
    name = str(gnss)
    topic = bag.topics.get(name)
    if topic is not None:
        if topic.type not in _FIX_ROLES:
            raise RecordingError(
                f"{bag.path}: {name} is of the type {short(topic.type)} and holds no fixes; give a "
                f"topic of {short(FIX)} or {short(NMEA)}."
            )
        return None, {_FIX_ROLES[topic.type]: name}
    folder = bag.path if bag.path.is_dir() else bag.path.parent
    for path in (folder / "gnss" / name, folder / name, Path(name)):
        if path.is_file():
            return path, {}
    raise RecordingError(
        f"{quoted(name)} is neither a topic of {bag.path} nor a log in {folder} or of its own; it "
        f"has {listing(bag.topics.values())}."
    )


def _fixes_of_topics(bag: Bag, readings: Readings, roles: Mapping[str, str]) -> BagFixes:
    """The fixes of NMEA sentences, else of NavSatFix."""
    topic = roles.get("nmea", "")
    sentences = readings.of(topic, Sentences)
    notes: list[str] = []
    if sentences is not None:
        nmea = sentences.finish()
        if sentences.fixes:
            log = FixLog(
                FixColumns.of_rows(sentences.fixes),
                tuple(f"{topic}: {n}." for n in nmea_notes(nmea)),
            )
            return BagFixes(log, None, topic, sentences.sha256())
        if nmea.undated and "fix" not in roles:
            raise GnssError(
                f"{bag.path}: {topic} has {nmea.undated} positions but no valid RMC or ZDA "
                "sentence, which alone give their date; let the receiver write RMC besides GGA."
            )
        notes.append(f"{topic}: no sentence gives a dated position.")
    topic = roles.get("fix", "")
    found = readings.of(topic, Numbers)
    if found is None:
        notes.append("No topic with fixes; give a log with --gnss FILE.")
        return BagFixes(FixLog(FixColumns.of([]), tuple(notes)))
    fixes = found.fixes(readings.times_ns(bag, topic))
    beside = readings.of(f"{topic}{DETAILS}", Texts)
    if beside is not None and isinstance(beside.said, Details):
        fixes = beside.said.added_to(fixes)
    return BagFixes(FixLog(fixes, tuple(notes)), None, topic, found.sha256())


def find_motion(content: BagIndex, imu_axes: str = AXES) -> tuple[Motion, tuple[str, ...]]:
    """Gyro and wheels, and remarks. The axes of the IMU are `imu_axes` if these are others than
    the usual, else those of the static transforms, else of the name of its frame."""
    bag, readings = content.bag, content.readings
    notes: list[str] = []
    gyro = wheels = inertial = None
    topic = content.roles.get("imu", "")
    turns = readings.of(topic, Numbers)
    if turns is not None and turns.places:
        R_flu_imu, told = axes_of(content.transforms, imu_axes, content.frame_id("imu"))
        times_ns, sensed = readings.series(bag, topic, turns.places, turns.rows())
        accelerometer = content.roles.get("acceleration", "")
        forces = readings.of(accelerometer, Numbers)
        if forces is not None and forces.places:
            felt_at = readings.series(bag, accelerometer, forces.places, forces.rows()[:, 3:])
            sensed[:, 3:] = between(times_ns, in_order(*felt_at, 3)[0])
        upward, is_whole = R_flu_imu[2], True
        if told == TAKEN and (felt := felt_upward(sensed[:, 3:])) is not None:
            upward, is_whole = felt, False
            told = f"axes taken so that gravity is felt upward, along {upward.astype(int).tolist()}"
        rates = -rate_about(sensed[:, :3], upward)
        series, lost = in_order(times_ns, rates)
        gyro = Gyro(*series) if len(series.time_ns) else None
        notes += [*skipped(topic, lost, "message"), f"{topic}: {told}."]
        # With one axis, an IMU says 0 or NaN of the others.
        if gyro is not None and is_whole and turns_across(sensed, upward):
            R_vehicle_imu = R_VEHICLE_FLU @ R_flu_imu
            with np.errstate(over="ignore", invalid="ignore"):
                turned = [sensed[:, part] @ R_vehicle_imu.T for part in (slice(3), slice(3, 6))]
            inertial = inertial_of(in_order(times_ns, np.hstack(turned), 3)[0], notes)
    topic = content.roles.get("odometry", "")
    speeds = readings.of(topic, Numbers)
    if speeds is not None and speeds.places:
        told_mps = readings.series(bag, topic, speeds.places, np.array(speeds.values))
        series, lost = in_order(*told_mps)
        wheels = WheelSpeed(*series) if len(series.time_ns) else None
        notes += skipped(topic, lost, "message")
    elif speeds is None and topic and (moving := readings.moving(bag)) is not None:
        way = moving[1]
        told_ns, told_speeds = forward_speeds(way)
        wheels = WheelSpeed(told_ns, told_speeds) if len(told_ns) else None
        notes.append(
            f"{topic}: no topic has odometry, so the speed is that of {way.child} in {way.parent}."
        )
    motion = _leaning(content, imu_axes, Motion(gyro=gyro, wheels=wheels, inertial=inertial), notes)
    return motion, tuple(notes)


def _leaning(content: BagIndex, imu_axes: str, motion: Motion, notes: list[str]) -> Motion:
    """The motion with roll and pitch that messages state: those of the topic that was given for
    them, else, where no accelerometer tells them, those of the IMU or of the odometry. An
    accelerometer is what an IMU has its orientation from: it does not count twice."""
    readings, sensed = content.readings, motion.inertial
    if isinstance(tilt := readings.tilt(TILT), RecordedTilt):
        motion = motion._replace(tilt=tilt)
    given = content.roles.get("attitude", "")
    if not given and isinstance(kept := readings.tilt(ORIENTATION), Orientation):
        return motion._replace(orientation=kept)
    feels = sensed is not None and bool(np.isfinite(sensed.force_mps2).any())
    if not given and (feels or motion.tilt is not None):
        return motion
    roles = ("attitude",) if given else ("imu", "odometry")
    for topic in filter(None, map(content.roles.get, roles)):
        heard = readings.attitude if given else readings.of(topic, Numbers)
        if heard is None or not heard.leans.places:
            continue
        is_imu = content.bag.topics[topic].type == IMU
        R_flu_body, how = axes_of(content.transforms, imu_axes if is_imu else AXES, heard.body)
        frame_sigma_deg = 0.0 if is_imu else ODOMETRY_FRAME_SIGMA_DEG
        told = readings.series(content.bag, topic, heard.leans.places, heard.leans.values())
        found: Orientation | Untold
        if how == TAKEN and is_imu and felt_upward(heard.rows()[:, 3:]) is not None:
            found = Untold("it does not feel gravity along its z axis", by_axes=True)
        else:
            found = orientation_of(*told, R_flu_body, frame_sigma_deg, axes_known=how != TAKEN)
        if isinstance(found, Orientation):
            notes.append(f"{topic}: roll and pitch by its orientation.")
            return motion._replace(orientation=found)
        if given or found.by_axes:
            by = (
                "imu_axes in mounting.json or a static transform"
                if is_imu
                else "a static transform"
            )
            remedy = f"; say how it sits by {by}" if found.by_axes else ""
            notes.append(f"{topic}: tells no roll and pitch: {found.why}{remedy}.")
    return motion


def axes_of(transforms: Transforms, axes: str, frame: str) -> tuple[Float64, str]:
    """From the axes of a frame to forward, left, up [3, 3], and how that is known: `TAKEN` where
    nothing tells it."""
    if axes == AXES:
        R_flu_imu = imu_rotation(frame, transforms)
        if R_flu_imu is not None:
            return R_flu_imu, "axes by the static transforms"
        if is_optical(frame):
            axes = OPTICAL_AXES
    told = TAKEN if axes == AXES else f"axes taken as {axes}"
    return np.array(directions(axes), dtype=np.float64).T, told


def felt_upward(forces_mps2: Float64) -> Float64 | None:
    """The axis of an IMU along which gravity is felt, [3], where that is another than the third.
    None where what is felt has not the size of gravity: then no axis is told by it."""
    known = np.isfinite(forces_mps2).all(axis=1)
    if not known.any():
        return None
    usual = np.median(forces_mps2[known], axis=0)
    own = int(np.abs(usual).argmax())
    upright = abs(usual[own]) >= _GRAVITY_SHARE * float(np.linalg.norm(usual))
    if gravity_unit_mps2(usual) is None or not upright:
        return None
    upward = np.zeros(3)
    upward[own] = np.sign(usual[own])
    return None if upward[2] == 1.0 else upward


def between(times_ns: Int64, series: MotionSeries) -> Float64:
    """Values [n, k] of a series at other times, straight between its own; NaN outside of it."""
    if not len(series.time_ns):
        return np.full((len(times_ns), series.values.shape[1]), math.nan)
    first_ns = times_ns[0]
    at, known = (times_ns - first_ns) / 1e9, (series.time_ns - first_ns) / 1e9
    columns = [np.interp(at, known, one, math.nan, math.nan) for one in series.values.T]
    return np.column_stack(columns)


def turns_across(sensed: Float64, upward: Float64) -> bool:
    """Whether the rates [n, 3 or more] of an IMU say anything of its axes across the vertical."""
    across = sensed[:, [k for k in range(3) if abs(upward[k]) < _UPRIGHT]]
    return bool(np.nan_to_num(across).any())


def rate_about(rates: Float64, row: Float64) -> Float64:
    """The rate about an axis; an axis that is one of the IMU's own gives its very numbers."""
    own = int(np.abs(row).argmax())
    if np.count_nonzero(row) == 1 and abs(row[own]) == 1.0:
        return np.asarray(rates[:, own] * row[own], dtype=np.float64)
    with np.errstate(over="ignore", invalid="ignore"):  # such a rate is none, and left out
        return np.asarray(rates @ row, dtype=np.float64)


def as_drive(content: BagIndex) -> Drive:
    """The drive without its frames and its own motion."""
    path, settings, fixes = content.path, content.settings, content.fixes
    return Drive(
        path=path,
        name=settings.name or (path.resolve().name if path.is_dir() else path.stem),
        log=fixes.log,
        gnss_source=fixes.source,
        gnss_path=fixes.path,
        gnss_hash=fixes.sha256,
        datum_hint=settings.datum or content.readings.datum(),
        pose_source=settings.poses,
        notes=content.notes(),
    )
