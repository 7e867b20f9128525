"""A bag after the one pass over what is small in it, before anything is made of it."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from fieldgrid.errors import RecordingError
from fieldgrid.recording.bag.drive import Fixes, GnssChoice, choose_gnss, find_fixes
from fieldgrid.recording.bag.readings import Readings, read_readings
from fieldgrid.recording.bag.topics import FIXES, Choice, choose
from fieldgrid.recording.options import Options
from fieldgrid.recording.settings_file import SETTINGS, Settings, read_settings
from fieldgrid.ros import Bag


class Opened(NamedTuple):
    """A bag after the one pass over what is small in it."""

    bag: Bag
    path: Path
    settings: Settings
    settings_path: Path
    choice: Choice
    readings: Readings
    fixes: Fixes

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on what was read so far."""
        files = self.bag.files
        read = f"{len(files)} files are read as one drive: {files[0]} to {files[-1]}."
        several = (read,) if len(files) > 1 else ()
        return (*several, *self.choice.notes, *self.fixes.notes, *self.readings.notes)

    @property
    def folder(self) -> Path:
        """Where files that belong to the bag lie."""
        return self.path if self.path.is_dir() else self.path.parent


def read_bag(bag: Bag, path: Path, options: Options) -> Opened:
    """What is small in a bag, and which of its topics are used. Raises RecordingError where that
    is left open, but not for what concerns the frames alone."""
    settings_path = _settings_path(path)
    settings = read_settings(settings_path)
    _refuse_settings(settings, settings_path)
    chosen: GnssChoice = choose_gnss(bag, options.gnss)
    given = {**options.topics, **(chosen.topic or {})}
    unwanted = FIXES - given.keys() if options.gnss is not None else frozenset[str]()
    choice = choose(bag.topics, given, path, unwanted, settings.sensor)
    readings = read_readings(bag, choice.roles)
    columns = options.columns or (settings.columns if chosen.log is not None else None)
    fixes = find_fixes(bag, readings, choice.roles, chosen, columns)
    unused = FIXES - {fixes.role}
    roles = {role: topic for role, topic in choice.roles.items() if role not in unused}
    return Opened(bag, path, settings, settings_path, choice._replace(roles=roles), readings, fixes)


def _settings_path(path: Path) -> Path:
    """The settings in the folder of a bag; beside a file first those that have its name."""
    if path.is_dir():
        return path / SETTINGS
    own = path.with_suffix(".toml")
    return own if own.exists() else path.with_name(SETTINGS)


def _refuse_settings(settings: Settings, path: Path) -> None:
    for key in ("frames", "bayer", "start", "scale"):
        if getattr(settings, key) is not None:
            raise RecordingError(
                f"{path}: {key} is for folders of files, and the messages of a bag say it "
                "themselves; leave it out."
            )
