"""A bag as a drive: which of its positions and motion are taken, frames or not."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fieldgrid.array_types import Float64
from fieldgrid.errors import ConfigError, GnssError, RecordingError
from fieldgrid.fixes import FixColumns
from fieldgrid.motion import Gyro, Motion, WheelSpeed
from fieldgrid.recording.bag.mounts import is_optical, vertical_row
from fieldgrid.recording.bag.readings import Readings
from fieldgrid.recording.bag.topics import FIX, NMEA, listing, short
from fieldgrid.recording.columns import Columns
from fieldgrid.recording.fix_log import FixLog
from fieldgrid.recording.logs import read_fix_log
from fieldgrid.recording.motion_files import AXES, directions, in_order
from fieldgrid.recording.mounting import Mounting
from fieldgrid.recording.stream_log import nmea_notes
from fieldgrid.ros import Bag

_OPTICAL_AXES = "rdf"

_FIX_ROLES = {NMEA: "nmea", FIX: "fix"}


class GnssChoice(NamedTuple):
    """Where the fixes are to come from: a log beside the bag, a topic (by its role), or either
    None for whatever the bag has."""

    log: Path | None = None
    topic: Mapping[str, str] | None = None


class Fixes(NamedTuple):
    """The fixes of a drive, what they are from, its role and hash, remarks, and the motion of a
    log."""

    fixes: FixColumns
    source: str
    role: str
    notes: tuple[str, ...]
    sha256: str = ""
    motion: Motion = Motion()


def choose_gnss(bag: Bag, gnss: str | Path | None) -> GnssChoice:
    """What `--gnss` means for a bag: one of its topics, or a log beside it or anywhere."""
    if gnss is None:
        return GnssChoice()
    name = str(gnss)
    topic = bag.topics.get(name)
    if topic is not None:
        if topic.type not in _FIX_ROLES:
            raise RecordingError(
                f"{bag.path}: {name} is of the type {short(topic.type)} and holds no fixes; give a "
                f"topic of {short(FIX)} or {short(NMEA)}."
            )
        return GnssChoice(topic={_FIX_ROLES[topic.type]: name})
    folder = bag.path if bag.path.is_dir() else bag.path.parent
    for path in (folder / "gnss" / name, folder / name, Path(name)):
        if path.is_file():
            return GnssChoice(log=path)
    raise RecordingError(
        f"{name!r} is neither a topic of {bag.path} nor a log in {folder} or of its own; it has "
        f"{listing(bag.topics.values())}."
    )


def find_fixes(
    bag: Bag,
    readings: Readings,
    roles: Mapping[str, str],
    chosen: GnssChoice,
    columns: Columns | None,
) -> Fixes:
    """The fixes of a log that is given, else of NMEA sentences, else of NavSatFix."""
    if chosen.log is not None:
        log: FixLog = read_fix_log(chosen.log, columns)
        with chosen.log.open("rb") as file:
            sha256 = hashlib.file_digest(file, "sha256").hexdigest()
        return Fixes(log.fixes, chosen.log.name, "", log.notes, sha256, log.motion)
    if columns is not None:
        raise ConfigError("Columns: the fixes of a bag are no table; leave them out.")
    if readings.nmea.fixes:
        counted = (f"{roles['nmea']}: {note}." for note in nmea_notes(readings.nmea))
        sha256 = readings.sha256["nmea"]
        return Fixes(
            FixColumns.of_rows(readings.nmea.fixes), roles["nmea"], "nmea", tuple(counted), sha256
        )
    undated = readings.nmea.undated
    if undated and not readings.fixes:
        raise GnssError(
            f"{bag.path}: {roles['nmea']} has {undated} positions but no valid RMC or ZDA "
            "sentence, which alone give their date; let the receiver write RMC besides GGA."
        )
    notes = [f"{roles['nmea']}: no sentence gives a dated position."] if "nmea" in roles else []
    if "fix" in roles:
        sha256 = readings.sha256["fix"]
        return Fixes(FixColumns.of_rows(readings.fixes), roles["fix"], "fix", tuple(notes), sha256)
    notes.append("No topic with fixes; give a log with --gnss FILE.")
    return Fixes(FixColumns.of([]), "", "", tuple(notes))


def find_motion(
    readings: Readings, roles: Mapping[str, str], mounting: Mounting | None
) -> tuple[Motion, tuple[str, ...]]:
    """Gyro and wheels, and remarks. Of a mounting the axes of the IMU are taken if it names
    others than the usual, else those of the static transforms, else of the name of its frame."""
    notes: list[str] = []
    gyro = wheels = None
    if readings.turns is not None:
        upwards, told = _upwards(readings, mounting)
        times_ns, rates = readings.turns
        series, lost = in_order(times_ns, -_rate(rates, upwards))
        gyro = Gyro(*series) if len(series.time_ns) else None
        notes += [*_lost(roles["imu"], lost), f"{roles['imu']}: {told}."]
    if readings.speeds is not None:
        series, lost = in_order(*readings.speeds)
        wheels = WheelSpeed(*series) if len(series.time_ns) else None
        notes += _lost(roles["odometry"], lost)
    return Motion(gyro=gyro, wheels=wheels), tuple(notes)


def _upwards(readings: Readings, mounting: Mounting | None) -> tuple[Float64, str]:
    axes = AXES if mounting is None else mounting.imu_axes
    if axes == AXES:
        frame = readings.frame_ids.get("imu", "")
        row = vertical_row(frame, readings)
        if row is not None:
            return row, "axes by the static transforms"
        if is_optical(frame):
            axes = _OPTICAL_AXES
    return np.array(
        [up for _, _, up in directions(axes)], dtype=np.float64
    ), f"axes taken as {axes}"


def _rate(rates: Float64, row: Float64) -> Float64:
    """The rate about an axis; an axis that is one of the IMU's own gives its very numbers."""
    own = int(np.abs(row).argmax())
    if np.count_nonzero(row) == 1 and abs(row[own]) == 1.0:
        return np.asarray(rates[:, own] * row[own], dtype=np.float64)
    with np.errstate(over="ignore", invalid="ignore"):  # such a rate is none, and left out
        return np.asarray(rates @ row, dtype=np.float64)


def _lost(topic: str, lost: int) -> list[str]:
    if not lost:
        return []
    return [f"{topic}: {lost} messages without a time or value, or repeated, skipped."]
