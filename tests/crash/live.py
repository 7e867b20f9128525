"""A live session that is killed with SIGKILL at random moments, until its map is made, again and
again.

    python -m tests.crash.live 250 [SEED]

prints how many kills there were, and what they hit. After each, what the session had told or taken
must be on the disk but for one frame, and the next start goes on there. Each map that is made must
verify and have the bits of a build of the drive. Sessions are forked from a process that is warm,
so that kills hit them at work and not while they are loaded.
"""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from fieldgrid.core import BuildSettings, ConfigError
from fieldgrid.geometry import Fix
from fieldgrid.live import LiveGrid, LiveResult, finish_session, live_folder, replay
from fieldgrid.live.kept.session_folder import SessionFolder
from fieldgrid.maps import open_map
from fieldgrid.pipeline import build_map
from fieldgrid.recordings import open_recording
from tests.conftest import TWO_LANES, make_small_drive
from tests.live.making import begin, cut_log, drive_live
from tests.pipeline.drives.making import content

FRAMES = range(20, 28)
STRANGE = 4
"""Exit code of a session that met an error."""

ENDED = "nothing: it had ended"


class Had(NamedTuple):
    """What a session has on the disk."""

    frames: list[str]
    fixes: int


NOTHING = Had([], 0)


def run_kills(count: int, seed: int, folder: Path) -> Counter[str]:
    """Kill so many sessions; returns what they were doing. AssertionError at the first loss."""
    random = np.random.default_rng(seed)
    cv2.setNumThreads(1)  # threads of OpenCV do not live on in a fork
    drive = make_small_drive(folder / "drive", FRAMES)
    cut_log(drive)
    (drive / "imu").symlink_to(TWO_LANES / "imu")  # by which its grids are level at the end
    names = [f"{k:06d}" for k in FRAMES]
    built, out = folder / "built.gpkg", folder / "m.gpkg"
    build_map([drive], built, BuildSettings(), jobs=1)
    expected = content(built)
    drive_live(drive, folder / "warm.gpkg")
    start_s = time.monotonic()
    drive_live(drive, folder / "again.gpkg")
    whole_s = time.monotonic() - start_s
    hit: Counter[str] = Counter()
    had = NOTHING
    while hit.total() - hit[ENDED] < count:
        # Most meet it while it drives, after so many frames; some at its begin or its end.
        left = len(FRAMES) - len(had.frames)
        grids = int(random.integers(-1, left + 1)) if left else -1
        longest_s = whole_s / (20.0 if 0 < grids < left else 2.0)
        after = "grid", grids
        if not left and random.random() < 0.7:
            # One that has all of its frames; often it is let to end, for the next to drive.
            after, longest_s = ("driven", 1), 2.0 * whole_s
        doing, said = _one(drive, out, after, float(random.uniform(0.0, longest_s)))
        hit[doing] += 1
        if live_folder(out).exists():
            now = _kept(out)
            told = [line.split()[1] for line in said if line.startswith("grid")]
            # What went on is what was there and then whole frames, in their order.
            assert now.frames == names[: len(now.frames)], (now, said)
            assert len(now.frames) >= max(len(had.frames), len(set(told) | set(had.frames)) - 1)
            assert now.fixes >= had.fixes + sum(line == "fix" for line in said), (now, had, said)
            had = now
        elif out.exists():
            had = NOTHING
        else:
            # It was killed before it had begun, or it lost all of it.
            assert had == NOTHING, (had, doing)
        if out.exists():
            assert content(out) == expected
            with open_map(out) as universal:
                verdict = universal.verify(deep=True)
            assert verdict.sound, verdict.problems
            if had == NOTHING:
                out.unlink()
        # A draft that a session left, and its journal, are removed before the next draft is
        # written: one that is empty is of a session that was killed in between.
        drafts = [path.name for path in folder.glob(".m.gpkg.*") if path.stat().st_size]
        assert len(drafts) <= 2, (drafts, doing)
    return hit


def _kept(out: Path) -> Had:
    """What is there of a session, read as its end would."""
    try:
        with SessionFolder(out, None) as kept:
            drive = kept.drive
            return Had([frame.entry.frame_id for frame in kept.drive.frames], len(drive.fixes))
    except ConfigError:
        return NOTHING  # it was killed before it had written what it is


def _one(drive: Path, out: Path, after: tuple[str, int], then_s: float) -> tuple[str, list[str]]:
    """One session's life: it is killed some time after so many of its lines began so, at once for
    none. What it was doing then, and what it had said."""
    begins, count = after
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        _drive(drive, out, writer)
    os.close(writer)
    said: list[str] = []
    with os.fdopen(reader) as pipe:
        while sum(line.startswith(begins) for line in said) < count and (line := pipe.readline()):
            said.append(line.strip())
        time.sleep(then_s)
        os.kill(child, signal.SIGKILL)
        said += pipe.read().splitlines()
    _, status = os.waitpid(child, 0)
    if not os.WIFSIGNALED(status):
        assert os.WEXITSTATUS(status) == 0, said
        return ENDED, said
    phases = [line for line in said if line in ("begun", "driven")]
    doing = {"begun": "driving", "driven": "making the map"}
    return doing[phases[-1]] if phases else "starting", said


def _drive(drive: Path, out: Path, pipe: int) -> None:
    """The life of a session; does not return."""
    code = STRANGE

    def say(text: str) -> None:
        os.write(pipe, f"{text}\n".encode())

    def take(result: LiveResult) -> None:
        if isinstance(result, LiveGrid):
            say(f"grid {result.frame_id}")

    try:
        if out.exists():  # the end before was killed when the drive was in the map
            say("driven")
            finish_session(out)
            os._exit(0)
        with open_recording(drive) as recording:
            live = begin(recording, out, on_result=take)
            say("begun")
            push_fix = live.push_fix

            def pushed(fix: Fix) -> None:
                push_fix(fix)
                say("fix")

            live.push_fix = pushed  # type: ignore[method-assign]
            replay(live, recording, rate=None)
            say("driven")
            live.finish()
        code = 0
    except BaseException as error:  # noqa: BLE001 - whatever it is, the parent shall hear of it
        say(f"{type(error).__name__}: {error}")
    finally:
        os._exit(code)


def main() -> None:
    """Run as a program."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 250
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        hit = run_kills(count, seed, Path(folder))
    print(f"{hit.total() - hit[ENDED]} kills in {time.perf_counter() - start:.0f} s:")
    print("  " + ", ".join(f"{what} {n}" for what, n in hit.most_common()))
    print("  no more than one frame was lost, no fix, and every map had the bits of a build")


if __name__ == "__main__":
    main()
