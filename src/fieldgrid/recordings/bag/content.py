"""What is small in a bag, once it was opened: its settings, which topics are used, the fixes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from fieldgrid.core import GnssError, RecordingError, quoted
from fieldgrid.geometry import FixColumns, WheelSpeed
from fieldgrid.recordings.bag.listeners import Numbers, Sentences, Texts
from fieldgrid.recordings.bag.readings import Readings
from fieldgrid.recordings.bag.topic_names import FIX, NMEA
from fieldgrid.recordings.bag.topics import (
    FIXES,
    Choice,
    choose,
    listing,
    short,
    static_transforms,
)
from fieldgrid.recordings.bag.transforms import Transforms
from fieldgrid.recordings.drive import Drive
from fieldgrid.recordings.options import DriveOptions
from fieldgrid.recordings.readers.settings_file import SETTINGS, RecordingSettings, read_settings
from fieldgrid.recordings.ros.gnss_messages import DETAILS, Details
from fieldgrid.recordings.tables.fix_log import FixLog
from fieldgrid.recordings.tables.logs import chosen_log
from fieldgrid.recordings.tables.stream_log import nmea_notes

_FIX_ROLES = {NMEA: "nmea", FIX: "fix"}


@dataclass(frozen=True, slots=True)
class BagIndex:
    """A bag after the one run over it, before anything is made of its frames. The fixes of `log`
    are those of `gnss`: a file, or a topic; empty where there are none. Without odometry, `moving`
    is the speed by transforms, with their topic and whose it is."""

    path: Path
    settings: RecordingSettings
    settings_path: Path
    choice: Choice
    readings: Readings
    transforms: Transforms
    log: FixLog
    gnss: Path | str
    moving: tuple[str, str, WheelSpeed] | None

    @property
    def roles(self) -> Mapping[str, str]:
        """The topics that are used, by their roles."""
        return self.choice.roles

    def frame_id(self, role: str) -> str:
        """The frame of the messages of a role, empty where there are none."""
        return self.readings.frame_id(self.roles.get(role))


def read_content(path: Path, options: DriveOptions, readings: Readings) -> BagIndex:
    """What is small in a bag, and which of its topics are used. Raises RecordingError where that
    is left open, but not for what concerns the frames alone."""
    settings_path = path / SETTINGS if path.is_dir() else path.with_suffix(".toml")
    if not settings_path.exists():  # beside a file, one that has its name goes first
        settings_path = folder_of(path) / SETTINGS
    settings = read_settings(settings_path)
    for key in ("frames", "bayer", "start", "scale"):
        if getattr(settings, key) is not None:
            raise RecordingError(
                f"{settings_path}: {key} is for folders of files, and the messages of a bag say it "
                "themselves; leave it out."
            )
    topics, given = readings.bag.topics, dict(options.topics)
    gnss = None if options.gnss is None else _find_gnss(path, str(options.gnss), readings)
    if isinstance(gnss, str):
        given[_FIX_ROLES[topics[gnss].type]] = gnss
    unwanted = () if gnss is None else FIXES - given.keys()
    partners = readings.stereo_infos()
    choice = choose(topics, given, path, unwanted, settings.sensor, partners)
    if isinstance(gnss, Path):
        log = chosen_log(gnss, settings, options)
    else:
        options.refuse("The fixes of a bag are no table", "columns")
        log, gnss = _fixes_of_topics(path, readings, choice.roles)
    used = {r: topic for r, topic in choice.roles.items() if r not in FIXES or topic == gnss}
    for role in {"imu", "acceleration", "odometry", "attitude"} & used.keys():
        try:
            readings.times_ns(used[role])
        except RecordingError as problem:
            readings.leave_out(used.pop(role), str(problem))
    moving = None if "odometry" in used else readings.moving()
    if moving is not None:
        used["odometry"] = moving[0]
    return BagIndex(
        path,
        settings,
        settings_path,
        choice._replace(roles=used),
        readings,
        readings.transforms(static_transforms(topics, choice.roles)),
        options.in_time(log, settings.gnss_offset_ns),
        gnss,
        moving,
    )


def folder_of(path: Path) -> Path:
    """Where files that belong to a bag lie."""
    return path if path.is_dir() else path.parent


def _find_gnss(path: Path, name: str, readings: Readings) -> Path | str:
    """What `--gnss` means for a bag: one of its topics, or a log beside it or anywhere."""
    topics, folder = readings.bag.topics, folder_of(path)
    if name in topics:
        if topics[name].type not in _FIX_ROLES:
            raise RecordingError(
                f"{path}: {name} is of the type {short(topics[name].type)} and holds no fixes; "
                f"give a topic of {short(FIX)} or {short(NMEA)}."
            )
        return name
    for log in (folder / "gnss" / name, folder / name, Path(name)):
        if log.is_file():
            return log
    raise RecordingError(
        f"{quoted(name)} is neither a topic of {path} nor a log in {folder} or of its own; it has "
        f"{listing(topics.values())}."
    )


def _fixes_of_topics(
    path: Path, readings: Readings, roles: Mapping[str, str]
) -> tuple[FixLog, str]:
    """The fixes of NMEA sentences, else of NavSatFix, and their topic, empty for none."""
    topic = roles.get("nmea", "")
    sentences = readings.of(topic, Sentences)
    notes: tuple[str, ...] = ()
    if sentences is not None:
        fixes = sentences.fixes + sentences.stream.finish()
        counts = sentences.stream.counts
        if fixes:
            told = tuple(f"{topic}: {note}." for note in nmea_notes(counts))
            return FixLog(FixColumns.of_rows(fixes), told), topic
        if counts.undated and "fix" not in roles:
            raise GnssError(
                f"{path}: {topic} has {counts.undated} positions but no valid RMC or ZDA "
                "sentence, which alone give their date; let the receiver write RMC besides GGA."
            )
        notes = (f"{topic}: no sentence gives a dated position.",)
    topic = roles.get("fix", "")
    found = readings.of(topic, Numbers)
    if found is None:
        without = "No topic with fixes; give a log with --gnss FILE."
        return FixLog(FixColumns.of([]), (*notes, without)), ""
    columns = found.fixes(readings.times_ns(topic))
    beside = readings.of(f"{topic}{DETAILS}", Texts)
    if beside is not None and isinstance(beside.said, Details):
        columns = beside.said.added_to(columns)
    return FixLog(columns, notes), topic


def as_drive(content: BagIndex) -> Drive:
    """The drive without its frames and its own motion."""
    path, settings, gnss = content.path, content.settings, content.gnss
    readings, files = content.readings, content.readings.bag.files
    read = f"{len(files)} files are read as one drive: {files[0]} to {files[-1]}."
    several = (read,) if len(files) > 1 else ()
    of_topics = readings.notes(content.roles.values())
    return Drive(
        path=path,
        name=settings.name or (path.resolve().name if path.is_dir() else path.stem),
        log=content.log,
        gnss_source=gnss if isinstance(gnss, str) else gnss.name,
        gnss_path=None if isinstance(gnss, str) else gnss,
        gnss_hash=readings.sha256(str(gnss)),
        datum_hint=settings.datum or readings.datum(),
        pose_source=settings.poses,
        notes=(*several, *content.choice.notes, *content.log.notes, *of_topics),
    )
