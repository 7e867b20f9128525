"""Progress lines on stderr, where a terminal watches."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from fieldgrid.cli import output
from fieldgrid.core import RecordingError, printable

if TYPE_CHECKING:
    from fieldgrid.maps import Patience
    from fieldgrid.pipeline import Progress


@contextmanager
def counting(what: str) -> Iterator[Callable[[int, int], None] | None]:
    """Yields what to tell how many of how many are done; None where no terminal watches."""
    if not output.shows_progress():
        yield None
        return
    with _bar() as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@contextmanager
def working(what: str) -> Iterator[None]:
    """Tells that something goes on of which nobody knows the end, and for how long it has."""
    if not output.shows_progress():
        yield
        return
    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = SpinnerColumn(), TextColumn("{task.description}"), TimeElapsedColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as line:
        line.add_task(what, total=None)
        yield


@contextmanager
def stages() -> Iterator[Callable[[str, int, int], None] | None]:
    """Yields what to tell how many of how many are done of a stage, a line for each stage; None
    where no terminal watches."""
    if not output.shows_progress():
        yield None
        return
    with _bar() as bar:
        tasks: dict[str, Any] = {}

        def show(stage: str, done: int, total: int) -> None:
            if stage not in tasks:
                tasks[stage] = bar.add_task(stage, total=total)
            bar.update(tasks[stage], completed=done)

        yield show


def waits_for(path: Path, wait_s: float) -> Callable[[float], None]:
    """What to tell how many seconds another writer of a map has been waited for: says it once."""
    told: list[float] = []

    def say(waited_s: float) -> None:
        if not told:
            output.message(_waits(path, wait_s))
        told.append(waited_s)

    return say


def patience(path: Path, wait_s: float) -> Patience:
    """How long another writer of a map is waited for, which a message on stderr tells."""
    from fieldgrid.maps import Patience

    return Patience(wait_s, waits_for(path, wait_s))


def _waits(path: Path, wait_s: float) -> str:
    return f"waiting for another program that writes {path.name}, up to {wait_s:g} s"


def fetched(recording: str) -> Path:
    """The path of a recording; one at a URL is copied to this machine, with a progress line."""
    from fieldgrid.recordings import fetch, is_url

    if not is_url(recording):
        return Path(recording)
    with counting("files fetched") as show:
        return fetch(recording, progress=show)


def fetched_or_url(recording: str) -> str | Path:
    """The path of a recording, for a build of several: what cannot be fetched stays a URL, so that
    the build reports why and leaves that drive out."""
    try:
        return fetched(recording)
    except RecordingError:
        return recording


class BuildProgress(NamedTuple):
    """Whom a build tells: how far its drives are, None where no terminal watches; and how many
    seconds it has waited for another writer."""

    show: Callable[[Progress], None] | None
    waiting: Callable[[float], None]


@contextmanager
def building(out: Path, wait_s: float) -> Iterator[BuildProgress]:
    """Yields whom a build tells of its progress: one line of frames, rate and distance, over all
    drives."""
    if not output.shows_progress():
        yield BuildProgress(None, waits_for(out, wait_s))
        return
    with _bar("{task.fields[rate]}  {task.fields[distance]}") as bar:
        task = bar.add_task("", total=None, rate="", distance="")
        drives: dict[str, Progress] = {}

        def show(now: Progress) -> None:
            drives[now.session] = now
            ended = sum(one.frames_done == one.frames_total for one in drives.values())
            moved_m = [one.distance_m for one in drives.values() if one.distance_m is not None]
            speed = bar.tasks[task].speed
            bar.update(
                task,
                description=now.session if len(drives) == 1 else f"{ended} of {len(drives)} drives",
                total=sum(one.frames_total for one in drives.values()),
                completed=sum(one.frames_done for one in drives.values()),
                rate=f"{speed:.1f} frames/s" if speed else "",
                distance=f"{sum(moved_m):.0f} m" if moved_m else "",
            )

        def wait(waited_s: float) -> None:
            bar.update(task, description=f"{_waits(out, wait_s)}: {waited_s:.0f} s")

        yield BuildProgress(show, wait)


@contextmanager
def living() -> Iterator[Callable[[str], None] | None]:
    """A line that says how a live session is; None where no terminal watches."""
    if not output.shows_progress():
        yield None
        return
    from rich.console import Console

    with Console(stderr=True).status("") as line:
        yield lambda text: line.update(printable(text))


def _bar(*more: str) -> Any:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeRemainingColumn as Remaining,
    )

    columns = (BarColumn(), MofNCompleteColumn(), *map(TextColumn, more), Remaining())
    return Progress(
        TextColumn("{task.description}"), *columns, console=Console(stderr=True), transient=True
    )
