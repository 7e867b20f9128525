"""What Ctrl-C and SIGTERM do to `fieldgrid live`."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import typer

from fieldgrid.errors import printable


@contextmanager
def kept_when_interrupted(folder: Path, out: Path, way: str = "--finish") -> Iterator[None]:
    """Say where the drive is when Ctrl-C or SIGTERM ends the making of its map; `way` is the option
    that makes it."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit) as end:
        where = ""
        if folder.exists():
            where = (
                f"What is kept of the drive is in {folder}; fieldgrid live -o {out} {way} makes "
                "the map of it."
            )
        # Where the end had begun, it has noted what became of the drive.
        where = getattr(end, "__notes__", [where])[-1]
        typer.echo(printable(f"fieldgrid: interrupted. {where}".rstrip()), err=True)
        raise typer.Exit(130 if isinstance(end, KeyboardInterrupt) else 143) from None


@contextmanager
def ended_by_signals() -> Iterator[threading.Event]:
    """In the block Ctrl-C and SIGTERM set an event, and interrupt nothing."""
    stop = threading.Event()
    before = {
        one: signal.signal(one, lambda *_: stop.set()) for one in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield stop
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)
