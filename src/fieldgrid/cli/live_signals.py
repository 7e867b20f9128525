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
def kept_when_interrupted(folder: Path, out: Path) -> Iterator[None]:
    """Say where the drive is when Ctrl-C or SIGTERM ends the making of its map."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit) as end:
        said = (
            f"fieldgrid: interrupted; the drive is kept in {folder}, and fieldgrid live -o {out} "
            "--finish makes the map of it."
        )
        typer.echo(printable(said), err=True)
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
