"""What the staged parts of a drive belong to: a digest of all that they depend on."""

from __future__ import annotations

import hashlib
import json
import pickle
from pathlib import Path

import numpy as np

from fieldgrid.core import BuildSettings
from fieldgrid.geometry import Datum
from fieldgrid.pipeline.inputs import Inputs, to_arrays
from fieldgrid.recordings import Recording, StoredFrames
from fieldgrid.version import software_version


def part_key(
    recording: Recording, settings: BuildSettings, datum: Datum, total: int, every: int
) -> str:
    """A digest of all that the staged frames of a drive depend on: its files by their size and
    time, what was read of it, the settings, which frames are taken and the version of this package.
    Not of the bound on bad frames: a part that is done without it has none."""
    source, kind = recording.source, b""
    if isinstance(source, StoredFrames):
        files = [source.folder / name for shot in source.shots for name in shot.files]
        # How these are read: in which unit, with which axes, colours and lenses.
        kind = pickle.dumps(source.kind)
    elif recording.path.is_dir():
        files = sorted(path for path in recording.path.iterdir() if path.is_file())
    else:
        files = [recording.path]
    facts = {
        "version": software_version(),
        "path": str(recording.path),
        "settings": settings.model_dump(mode="json", exclude={"checks"}),
        "rig": recording.rig.as_dict(),
        "datum": repr(datum),
        "frames": [total, every],
        "files": [_state(file) for file in files],
        "kind": hashlib.sha256(kind).hexdigest(),
    }
    digest = hashlib.sha256(json.dumps(facts, sort_keys=True).encode())
    times_ns = recording.frame_times_ns()
    inputs = Inputs(recording.fixes(), recording.motion(), times_ns, np.zeros(0, dtype=np.bool_))
    for name, array in sorted(to_arrays(inputs).items()):
        digest.update(f"{name} {array.dtype} {array.shape} ".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()[:20]


def _state(file: Path) -> list[int | str]:
    """What tells that a file was changed."""
    try:
        found = file.stat()
    except OSError:
        return [str(file), "missing"]
    return [str(file), found.st_size, found.st_mtime_ns]
