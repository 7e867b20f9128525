"""What a drive on its way into a map was begun with, as the first record of its journal has it: all
that its staged frames depend on, and what the end of a live session needs."""

from __future__ import annotations

import hashlib
import json
import pickle
from collections.abc import Sequence
from dataclasses import astuple, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from fieldgrid.core import BuildSettings, ConfigError, quoted
from fieldgrid.geometry import Datum, Rig
from fieldgrid.pipeline.inputs import Inputs, to_arrays
from fieldgrid.recordings import PoseBody, Recording, StoredFrames
from fieldgrid.version import software_version


@dataclass(frozen=True, slots=True)
class DriveStart:
    """What a drive was begun with. `append` to `poses` are those of a live session."""

    name: str
    rig: Rig
    settings: BuildSettings
    datum: Datum | None = None
    datum_hint: Datum | None = None
    append: bool = False
    source: str = "live"
    source_sha256: str = ""
    notes: tuple[str, ...] = ()
    """Remarks on where the data come from, for the report."""
    poses: PoseBody | None = None
    """Whose poses are pushed, None where they are estimated."""
    recording: str = ""
    """The digest of a recording and of which of its frames are taken; empty of what is pushed."""
    version: str = field(default_factory=software_version)

    def to_json(self) -> dict[str, Any]:
        """As a value that JSON has."""
        return {
            **{one.name: getattr(self, one.name) for one in fields(self)},
            "rig": self.rig.as_dict(),
            "settings": self.settings.model_dump(mode="json"),
            "datum": self.datum and astuple(self.datum),
            "datum_hint": self.datum_hint and astuple(self.datum_hint),
            "poses": self.poses and astuple(self.poses),
        }

    @classmethod
    def from_json(cls, value: dict[str, Any]) -> DriveStart:
        """The start of a value that `to_json` made."""
        poses = value["poses"]
        given = {
            "rig": Rig.from_dict(value["rig"]),
            "settings": BuildSettings.model_validate(value["settings"]),
            "datum": value["datum"] and Datum(*value["datum"]),
            "datum_hint": value["datum_hint"] and Datum(*value["datum_hint"]),
            "notes": tuple(value["notes"]),
            "poses": poses and PoseBody(poses[0], poses[1], poses[2] and tuple(poses[2])),
        }
        return cls(**value | given)

    def compared(self) -> dict[str, Any]:
        """What must be the same for a drive to go on, by how errors call it. What is checked at its
        end may differ, and so may the address of a receiver, which a plug may change; replayed logs
        are told apart by their content."""
        said = self.to_json()
        del said["settings"]["checks"]
        return {
            "name": said["name"],
            "rig": said["rig"],
            "settings": said["settings"],
            "datum": [said["datum"], said["datum_hint"]],
            "use of --append": said["append"],
            "log of fixes": said["source_sha256"],
            "source of data": said["notes"],
            "poses of another program": said["poses"],
            "recording or use of --every": said["recording"],
            "version of this program": said["version"],
        }

    @property
    def key(self) -> str:
        """A digest of all that is compared."""
        compared = json.dumps(self.compared(), sort_keys=True)
        return hashlib.sha256(compared.encode()).hexdigest()[:20]


def check_same(path: Path, begun: DriveStart | None, now: Sequence[DriveStart], ways: str) -> None:
    """Raise ConfigError where the journal at `path`, which was `begun` for a drive, is of none of
    those that are to be put into the map `now`; it is told how it differs from the one that is
    most like it. `ways` says what to do with it."""
    if begun is None:
        raise ConfigError(f"What session {path} holds cannot be read. {ways}")
    was = begun.compared().items()
    differing = ([what for what, one in was if one != start.compared()[what]] for start in now)
    other = min(differing, key=len)
    if other:
        raise ConfigError(
            f"{path} holds the session {quoted(begun.name)}, which was ended before it was in the "
            "map and cannot go on with this one, which differs in its "
            f"{' and '.join(other)}. {ways}"
        )


def recording_digest(recording: Recording, total: int, every: int) -> str:
    """A digest of a recording: its files by their size and time, what was read of it, and which
    frames are taken."""
    source, kind = recording.source, b""
    if isinstance(source, StoredFrames):
        files = [source.folder / name for shot in source.shots for name in shot.files]
        # How these are read: in which unit, with which axes, colours and lenses.
        kind = pickle.dumps(source.kind)
    elif recording.path.is_dir():
        files = sorted(path for path in recording.path.iterdir() if path.is_file())
    else:
        files = [recording.path]
    facts = [str(recording.path), total, every, [_state(file) for file in files]]
    digest = hashlib.sha256(json.dumps(facts).encode() + kind)
    times_ns = recording.frame_times_ns()
    inputs = Inputs(recording.fixes(), recording.motion(), times_ns, np.zeros(0, dtype=np.bool_))
    for name, array in sorted(to_arrays(inputs).items()):
        digest.update(f"{name} {array.dtype} {array.shape} ".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def _state(file: Path) -> list[int | str]:
    """What tells that a file was changed."""
    try:
        found = file.stat()
    except OSError:
        return [str(file), "missing"]
    return [str(file), found.st_size, found.st_mtime_ns]
