"""Progress lines on stderr, where a terminal watches."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from fieldgrid.cli import output

if TYPE_CHECKING:
    from fieldgrid.build import Progress


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
    """The same for work in stages that have names, a line each."""
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


@contextmanager
def building() -> Iterator[Callable[[Progress], None] | None]:
    """The same for a build: frames, rate and distance of each session."""
    if not output.shows_progress():
        yield None
        return
    with _bar("{task.fields[rate]}  {task.fields[distance]}") as bar:
        tasks: dict[str, Any] = {}

        def show(now: Progress) -> None:
            if now.session not in tasks:
                tasks[now.session] = bar.add_task(
                    now.session, total=now.frames_total, rate="", distance=""
                )
            task = tasks[now.session]
            speed = bar.tasks[task].speed
            bar.update(
                task,
                completed=now.frames_done,
                rate=f"{speed:.1f} frames/s" if speed else "",
                distance="" if now.distance_m is None else f"{now.distance_m:.0f} m",
            )

        yield show


def _bar(*more: str) -> Any:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
    from rich.progress import TimeRemainingColumn as Remaining

    columns = (BarColumn(), MofNCompleteColumn(), *map(TextColumn, more), Remaining())
    return Progress(
        TextColumn("{task.description}"), *columns, console=Console(stderr=True), transient=True
    )
