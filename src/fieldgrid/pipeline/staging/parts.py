"""Staged parts of drives beside the map, for a build that is to go on after it was ended.

`MAP.gpkg.parts/KEY/` holds the parts of one drive. The key is a digest of all that the staged
frames depend on, so parts are found again only by a build that would make the same. Each part is
a stage file and a JSON file that is written after it; one without the other is no part.
"""

from __future__ import annotations

import hashlib
import json
import math
import secrets
import shutil
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

from fieldgrid.core import (
    Closing,
    ConfigError,
    MapError,
    MapWriteError,
    RecordingError,
    holding,
    parse_json,
)
from fieldgrid.maps import StagedFrame, StageEntry, StageFile, read_staged
from fieldgrid.perception import CameraStep, Refusal
from fieldgrid.pipeline.report import BadFrame, StageTimes
from fieldgrid.pipeline.staging.shares import FrameOutcome, StagedDrive, StepOutcome, Tell, collect

SHARE_FRAMES = 16
"""Frames of a part. The frame before it is looked at twice, and what an end of the build costs is
a part for each process."""

_ABOUT = "drive.json"
_MAX_INFO_BYTES = 16 << 20
_YOUNG_S = 60.0


class Share(NamedTuple):
    """Frames number `first` to before `last` of those that are taken of a drive."""

    first: int
    last: int

    @property
    def name(self) -> str:
        """What its files are called, without their endings."""
        return f"{self.first:08d}-{self.last:08d}"


class PartsInfo(NamedTuple):
    """The parts of a drive as they are found without its recording: their folder, and its name."""

    key: str
    name: str


def shares_of(count: int) -> list[Share]:
    """The shares of a drive of `count` frames."""
    return [
        Share(first, min(first + SHARE_FRAMES, count)) for first in range(0, count, SHARE_FRAMES)
    ]


def parts_folder(out: Path) -> Path:
    """Where the parts of a build of the map `out` lie."""
    place = out.resolve()
    return place.with_name(f"{place.name}.parts")


def left_behind(out: Path) -> list[PartsInfo]:
    """The drives of which a build of `out` that has ended left parts; not those of a build that
    still runs."""
    found = []
    folder = parts_folder(out)
    for drive in sorted(folder.iterdir()) if folder.is_dir() else ():
        try:
            with holding(drive / _ABOUT) as free:
                about = parse_json((drive / _ABOUT).read_text(encoding="utf-8"))
                done = sum(1 for _ in drive.glob("????????-????????.json"))
                if free and done:
                    found.append(PartsInfo(drive.name, str(about["name"])))
        except (OSError, ValueError, KeyError, TypeError):
            found.append(PartsInfo(drive.name, "a drive"))
    return found


def settle_left_behind(out: Path, resume: bool | None) -> None:
    """Refuse to build where an earlier build has left parts, unless it is said what to do. The
    folders of builds that were killed before their first part are removed."""
    left = left_behind(out)
    if left and resume is None:
        names = ", ".join(about.name for about in left[:3]) + (", ..." if len(left) > 3 else "")
        raise ConfigError(
            f"{parts_folder(out)} holds staged parts of a build that was ended ({names}); give "
            "--resume with the command that it was to go on, or --no-resume to remove them."
        )
    if resume is False:
        remove_parts(out, [about.key for about in left])
    for about in parts_folder(out).glob(f"*/{_ABOUT}"):
        with suppress(OSError), holding(about) as free:
            # A build that begins at this moment does not hold its folder yet.
            is_old = time.time() - about.stat().st_mtime > _YOUNG_S
            if free and is_old and not any(about.parent.glob("????????-????????.json")):
                remove_parts(out, [about.parent.name])


def remove_parts(out: Path, keys: Iterable[str]) -> None:
    """Remove the parts of drives, and the folder with the last."""
    folder = parts_folder(out)
    for key in keys:
        shutil.rmtree(folder / key, ignore_errors=True)
    with suppress(OSError):  # there are others
        folder.rmdir()


class DriveParts(Closing):
    """The parts of a drive: those that are there already, and those to be made."""

    def __init__(self, out: Path, key: str, name: str, recording: str, count: int) -> None:
        self.key, self._out, self._name, self._count = key, out, name, count
        self.folder = parts_folder(out) / key
        self.shares = shares_of(count)
        self._parts: dict[Share, StagedDrive] = {}
        self.frames_done, self.bad_count, self.moved_m = 0, 0, 0.0
        about = self.folder / _ABOUT
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            if not about.exists():
                said = {"name": name, "recording": recording, "frames": count}
                about.write_text(json.dumps(said), encoding="utf-8")
        except OSError as error:
            remove_parts(out, [key])
            raise MapWriteError(
                f"{out} could not be written ({error.strerror}); check the folder and its "
                "permissions."
            ) from error
        self._held = holding(about)
        if not self._held.__enter__():
            raise MapError(
                f"Another program builds {name} into {out}; wait until it has finished, and try "
                "again."
            )
        for share in self.shares:
            self.take(share)

    def take(self, share: Share) -> StagedDrive | None:
        """Read a part that is done; None where it is not."""
        part = read_part(self.folder, share)
        if part is not None:
            self._parts[share] = part
            self.frames_done += share.last - share.first
            self.bad_count += len(part.bad)
            self.moved_m += sum(
                math.hypot(one.forward_m, one.right_m)
                for one in part.found
                if isinstance(one, CameraStep)
            )
        return part

    def check_bad(self, skip_bad: int | float) -> None:
        """Raise RecordingError when more frames are bad than `skip_bad` allows, a number or, below
        1, a share of the drive's frames."""
        most = int(skip_bad * self._count) if isinstance(skip_bad, float) else skip_bad
        if self.bad_count > most:
            first = next(bad for _, part in sorted(self._parts.items()) for bad in part.bad)
            raise RecordingError(
                f"{self.bad_count} of {self._count} frames of {self._name} cannot be read, and "
                f"--skip-bad allows {most}; allow more, or copy the recording again. "
                f"First: {first.reason}"
            )

    @property
    def is_complete(self) -> bool:
        """Whether no share is missing."""
        return len(self._parts) == len(self.shares)

    def missing(self) -> list[Share]:
        """The shares of which there is no part yet."""
        return [share for share in self.shares if share not in self._parts]

    def runs(self) -> Iterator[list[Share]]:
        """The shares that are missing, those together that follow each other."""
        missing = enumerate(self.missing())
        # Along a run, the number of a share and its place among those missing grow alike.
        for _, run in groupby(missing, lambda one: one[1].first // SHARE_FRAMES - one[0]):
            yield [share for _, share in run]

    def staged(self) -> StagedDrive:
        """The whole drive, once no share is missing."""
        paths: list[Path] = []
        entries: list[StageEntry] = []
        whole = StagedDrive(_PartFrames(paths, entries), entries)
        for share in self.shares:
            part = self._parts[share]
            assert isinstance(part.frames, _PartFrames)
            paths += part.frames.paths
            entries += part.entries
            whole.found += part.found
            whole.bad += part.bad
            whole.times.add(part.times)
        return whole

    def remove(self) -> None:
        """Remove the parts of a drive that is given up."""
        self._parts.clear()
        self.frames_done = 0
        remove_parts(self._out, [self.key])

    def close(self) -> None:
        """Let go of the folder; without a part that is done, it is gone."""
        self._held.__exit__(None, None, None)
        # A process may have finished one that nobody has taken yet.
        if not self._parts and not any(self.folder.glob("????????-????????.json")):
            self.remove()


class _PartFrames:
    """Staged frames that lie in several files."""

    def __init__(self, paths: list[Path], entries: list[StageEntry]) -> None:
        self.paths, self._entries = paths, entries

    def __getitem__(self, index: int) -> StagedFrame:
        return read_staged(self.paths[index], self._entries[index])


def write_part(
    folder: Path, out: Path, share: Share, looks: Iterable[FrameOutcome], tell: Tell
) -> None:
    """Make the part of a share of the frames that come. MapWriteError on a full disk."""
    with _draft_of(folder, share) as draft:
        with StageFile(draft, out) as file:
            staged = collect(looks, file, tell)
        body = json.dumps(
            {
                "frames": len(staged.entries),
                "found": [found_to_json(one) for one in staged.found],
                "bad": staged.bad,
                "times": asdict(staged.times),
            }
        )
        draft.replace(folder / f"{share.name}.grids")
        draft.write_text(f"{_digest(body)}\n{body}", encoding="utf-8")
        draft.replace(folder / f"{share.name}.json")


def part_bytes(folder: Path, share: Share) -> tuple[bytes, bytes]:
    """The two files of a part that was written, for another machine to keep."""
    grids, info = ((folder / f"{share.name}.{kind}").read_bytes() for kind in ("grids", "json"))
    return grids, info


def keep_part(folder: Path, share: Share, part: tuple[bytes, bytes]) -> None:
    """Write a part that another machine has made. MapWriteError on a full disk."""
    with _draft_of(folder, share) as draft:
        for kind, data in zip(("grids", "json"), part, strict=True):
            draft.write_bytes(data)
            draft.replace(folder / f"{share.name}.{kind}")


@contextmanager
def _draft_of(folder: Path, share: Share) -> Iterator[Path]:
    """Where a file of a part is written before it gets its name; gone at the end of the block."""
    draft = folder / f"{share.name}.{secrets.token_hex(4)}.partial"
    try:
        yield draft
    except OSError as error:
        if isinstance(error, MapWriteError):
            raise
        raise MapWriteError(
            f"The local grids of the drive cannot be kept in {folder} ({error.strerror}), so the "
            "drive is not in the map; free some space there and try again."
        ) from error
    finally:
        with suppress(OSError):
            draft.unlink(missing_ok=True)


def read_part(folder: Path, share: Share) -> StagedDrive | None:
    """The part of a share, None when it is not there or damaged: it is then made again."""
    grids, info = folder / f"{share.name}.grids", folder / f"{share.name}.json"
    try:
        if info.stat().st_size > _MAX_INFO_BYTES or not grids.is_file():
            return None
        digest, _, body = info.read_text(encoding="utf-8").partition("\n")
        if digest != _digest(body):
            return None
        said: dict[str, Any] = parse_json(body)
        with StageFile(grids) as file:
            entries = list(file.entries)
        if len(entries) != said["frames"] or len(said["found"]) != len(entries):
            return None
        return StagedDrive(
            _PartFrames([grids] * len(entries), entries),
            entries,
            [found_from_json(one) for one in said["found"]],
            [BadFrame(*one) for one in said["bad"]],
            StageTimes(**said["times"]),
        )
    except (OSError, ValueError, KeyError, TypeError):  # MapError, too, is a ValueError
        return None


def _digest(body: str) -> str:
    return hashlib.sha256(body.encode()).hexdigest()


def found_to_json(found: StepOutcome) -> Any:
    """What became of a step of the camera, as a value that JSON has."""
    if isinstance(found, CameraStep):
        return [*map(float, found[:-1]), int(found.inliers)]
    return None if found is None else found.value


def found_from_json(said: Any) -> StepOutcome:
    """The step of the camera of a value that `found_to_json` made; ValueError or TypeError for
    others."""
    if isinstance(said, str):
        return Refusal(said)
    return None if said is None else CameraStep(*said)
