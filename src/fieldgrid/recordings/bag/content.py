"""What is small in a bag: all that was heard in the run that counts its messages, which of its
topics are used, and the fixes.

Which topics are used is known only when the run has ended. Of the topics of one role those are
heard that may still be the one, by what their names are worth.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from fieldgrid.core import Float64, GnssError, Int64, RecordingError, quoted
from fieldgrid.geometry import Datum, FixColumns, Orientation, RecordedTilt, WheelSpeed
from fieldgrid.recordings.bag.listeners import Numbers, Sentences, Texts, TopicListener
from fieldgrid.recordings.bag.order import clock
from fieldgrid.recordings.bag.topic_names import FIX, NMEA
from fieldgrid.recordings.bag.topics import (
    FIXES,
    KINDS,
    Choice,
    TopicKind,
    choose,
    listing,
    short,
    static_transforms,
)
from fieldgrid.recordings.bag.transforms import MovingTrees, Transforms, Trees
from fieldgrid.recordings.drive import Drive
from fieldgrid.recordings.options import DriveOptions
from fieldgrid.recordings.readers.settings_file import SETTINGS, RecordingSettings, read_settings
from fieldgrid.recordings.ros.bag import Take, open_bag
from fieldgrid.recordings.ros.gnss_messages import DATUM, DETAILS, Details, Tilts, datum_of
from fieldgrid.recordings.tables.fix_log import FixLog
from fieldgrid.recordings.tables.logs import chosen_log
from fieldgrid.recordings.tables.stream_log import nmea_notes

_Heard = TypeVar("_Heard", bound=TopicListener)
_FIX_ROLES = {NMEA: "nmea", FIX: "fix"}


class Readings:
    """A bag that was opened, and what was heard meanwhile; the `bag` is to be closed."""

    def __init__(self, path: Path, options: DriveOptions) -> None:
        self._given, self._gnss = options.topics, options.gnss
        self._heard: dict[str, TopicListener] = {}
        self._best: dict[str, str] = {}
        self._notes: dict[str, str] = {}
        self.bag = open_bag(path, self._listen, options.epoch_ns)

    def _listen(self, name: str, type_: str) -> Take | None:
        """What takes the messages of a topic; see :data:`fieldgrid.recordings.ros.bag.Listen`."""
        for kind in KINDS:
            if kind.listener and kind.fits(name, type_) and self._may_be(kind, name, type_):
                heard = self._heard[name] = kind.listener(name, type_)
                is_told = "odometry" in {*self._best, *self._given}
                for moving in self._all(MovingTrees):
                    moving.is_whole = moving.is_whole and not is_told
                return heard.take
        return None

    def _may_be(self, kind: TopicKind, name: str, type_: str) -> bool:
        """Whether a topic may be the one of its role, since no better one is known."""
        if kind.role in FIXES and self._gnss is not None:
            return name == str(self._gnss)
        if kind.role in self._given:
            return name == self._given[kind.role]
        if kind.rank is None:
            return not kind.role
        best = self._best.get(kind.role)
        if best is not None and kind.rank(name, type_) >= kind.rank(best, type_):
            return False
        if best is not None and best != self._given.get("attitude"):
            self._heard.pop(best).is_dropped = True
        self._best[kind.role] = name
        return True

    def of(self, topic: str | None, kind: type[_Heard]) -> _Heard | None:
        """What was heard of a topic, if it is of a kind."""
        heard = self._heard.get(topic or "")
        return heard if isinstance(heard, kind) else None

    def _all(self, kind: type[_Heard]) -> Iterator[_Heard]:
        return (heard for _, heard in sorted(self._heard.items()) if isinstance(heard, kind))

    def first(self, topic: str | None) -> Any:
        """The first message of a topic; None where there is none."""
        heard = self._heard.get(topic or "")
        return None if heard is None else heard.first

    def tilt(self, topic: str) -> RecordedTilt | Orientation | None:
        """What a converted drive keeps of roll and pitch on a topic."""
        heard = self.of(topic, Texts)
        return heard.said.found() if heard is not None and isinstance(heard.said, Tilts) else None

    def stereo_infos(self) -> dict[str, str]:
        """The calibration of a left camera with that of its right one: of one size and one
        projection, but for T, which only the right one has. Empty where that leaves a choice."""
        alike: dict[Any, list[tuple[float, str]]] = {}
        for name, heard in self._heard.items():
            projection = np.asarray(getattr(heard.first, "p", ()), dtype=np.float64)
            if projection.shape == (12,) and projection[0] > 0.0 and projection[3] <= 0.0:
                size = int(heard.first.width), int(heard.first.height)
                camera = (*size, np.delete(projection, 3).tobytes())
                alike.setdefault(camera, []).append((float(projection[3]), name))  # f·T
        pairs = [sorted(infos) for infos in alike.values() if min(infos)[0] < 0.0 == max(infos)[0]]
        if any(len(infos) > 2 for infos in pairs):
            return {}
        return {left: right for (_, right), (_, left) in pairs}

    def datum(self) -> Datum | None:
        """The datum that the bag declares."""
        message = self.first(DATUM)
        return None if message is None else datum_of(message)

    def transforms(self, static: Collection[str]) -> Transforms:
        """The tree of the static transforms of these topics, and below them of what is published
        on others and never moves."""
        trees = [moving.transforms.unmoved() for moving in self._all(MovingTrees)]
        trees += [found.transforms for name in static if (found := self.of(name, Trees))]
        tree = Transforms()
        for one in trees:
            tree.update(one)
        return tree

    def moving(self) -> tuple[str, str, WheelSpeed] | None:
        """The topic of transforms that tells the way of the vehicle, whose way, and its speed."""
        for heard in self._all(MovingTrees):
            try:
                told = heard.speed(self.bag, is_mapped=self.datum() is not None)
            except RecordingError as problem:
                self.leave_out(heard.name, str(problem))
                continue
            if told is not None:
                return heard.name, *told
        return None

    def series(self, topic: str | None) -> tuple[Int64, Float64]:
        """Times [n], 0 where there is none, and numbers [n, k] that were heard of a topic, in the
        order of the record."""
        heard = self.of(topic, Numbers)
        if heard is None:
            return np.zeros(0, dtype=np.int64), np.zeros((0, 10))
        return self.times_ns(heard.name)[heard.places], heard.rows()

    def times_ns(self, topic: str) -> Int64:
        """The times of all messages of a topic, 0 for none."""
        times = clock(topic, *self.bag.stamps(topic))
        if times.received:
            self._notes[topic] = "the header stamps are no UTC; the recorder's times are taken"
        return times.time_ns

    def leave_out(self, topic: str, why: str) -> None:
        """Note why a topic is not used."""
        self._notes[topic] = f"not used: {why.removesuffix('.')}"

    def notes(self, topics: Iterable[str]) -> list[str]:
        """Remarks on topics, a sentence each."""
        found = [f"{topic}: {note}." for topic, note in self._notes.items()]
        for topic in dict.fromkeys(topics):
            found += self._heard[topic].notes() if topic in self._heard else ()
        return found


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
        heard = self.readings.of(self.roles.get(role), TopicListener)
        return "" if heard is None else heard.frame_id


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
        log = chosen_log(gnss, settings, replace(options, epoch_ns=None))  # it is of the bag
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
    source = readings.of(str(gnss), TopicListener)
    return Drive(
        path=path,
        name=settings.name or (path.resolve().name if path.is_dir() else path.stem),
        log=content.log,
        gnss_source=gnss if isinstance(gnss, str) else gnss.name,
        gnss_path=None if isinstance(gnss, str) else gnss,
        gnss_hash="" if source is None else source.sha256(),
        datum_hint=settings.datum or readings.datum(),
        pose_source=settings.poses,
        notes=(*several, *content.choice.notes, *content.log.notes, *of_topics),
    )
