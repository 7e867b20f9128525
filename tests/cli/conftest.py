"""Running commands, in this process and in one of their own."""

from __future__ import annotations

import os
import pty
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from typing import NamedTuple, TextIO

import pytest

from fieldgrid.cli import main
from fieldgrid.cli.listing import load
from fieldgrid.export import formats
from tests.conftest import HANGS_S


class Result(NamedTuple):
    """What a command left: its exit status, its data, and its messages."""

    status: int
    out: str
    err: str

    def sentence(self) -> str:
        """The one sentence of a command that failed for its data, without the name."""
        assert self.status == 1, self
        assert self.out == ""
        assert self.err.startswith("fieldgrid: ")
        assert self.err.endswith(".\n"), self.err
        assert self.err.count("\n") == 1, self.err
        assert "Traceback" not in self.err
        return self.err.removeprefix("fieldgrid: ").rstrip("\n")

    def usage(self) -> str:
        """The message of a command that was used wrongly."""
        assert self.status == 2, self
        assert self.out == ""
        assert self.err.startswith("Usage: ")
        assert "Traceback" not in self.err
        return self.err

    def output(self) -> str:
        """The data of a command that succeeded, and had nothing to say beside it."""
        assert self.status == 0, self
        assert self.err == ""
        return self.out


Run = Callable[..., Result]


DEFECTS_ALLOWED = False
"""Set by the test of the last line of defence alone."""


def checked(result: Result) -> Result:
    """The result of a command, which never ends at the last line of defence."""
    assert DEFECTS_ALLOWED or result.status != 70, result.err
    return result


@cache
def _loaded(name: str, formats: tuple[str, ...]) -> object:
    return load(name)


def loaded_once(name: str) -> object:
    """A command, made once for the hundreds of times that tests run it.

    A process of a user makes it once too. What it takes depends on the formats that there are.
    """
    return _loaded(name, tuple(formats()))


@pytest.fixture
def fieldgrid(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Run:
    """Runs `fieldgrid ARGUMENTS...` in this process."""

    def run(*arguments: object) -> Result:
        monkeypatch.setattr(sys, "argv", ["fieldgrid", *map(str, arguments)])
        monkeypatch.setattr("fieldgrid.cli.listing.load", loaded_once)
        monkeypatch.setattr("fieldgrid.cli.when_compiling", lambda _: None)
        capsys.readouterr()
        try:
            main()
            status = 0
        except SystemExit as end:
            status = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
        return checked(Result(status, *capsys.readouterr()))

    return run


@contextmanager
def a_terminal() -> Iterator[tuple[TextIO, list[bytes]]]:
    """A stream that writes to a terminal, and what that has shown when the block has ended."""
    ours, theirs = pty.openpty()
    shown: list[bytes] = []

    def watch() -> None:
        with suppress(OSError):  # how Linux ends a terminal
            while part := os.read(ours, 1 << 16):
                shown.append(part)

    watcher = threading.Thread(target=watch)
    watcher.start()
    try:
        with os.fdopen(theirs, "w") as stream:
            yield stream, shown
    finally:
        watcher.join()
        os.close(ours)


def in_a_process(*arguments: object, before: str = "") -> list[str]:
    """The command line of a process of its own; `before` is Python to run first in it.

    Ctrl-C interrupts it as one that a user begins: what a shell starts in the background ignores
    it, with all that it starts. Whether it is the first run on a machine, no test sees.
    """
    code = (
        "import signal, sys\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "import fieldgrid.cli\nfieldgrid.cli.when_compiling = lambda _: None\n"
        f"{before}\nsys.argv[0] = 'fieldgrid'\nfieldgrid.cli.main()"
    )
    return [sys.executable, "-c", code, *map(str, arguments)]


@pytest.fixture
def fieldgrid_process() -> Run:
    """Runs `fieldgrid ARGUMENTS...` in a process of its own."""

    def run(*arguments: object, before: str = "", prefix: tuple[str, ...] = ()) -> Result:
        done = subprocess.run(
            [*prefix, *in_a_process(*arguments, before=before)],
            capture_output=True,
            text=True,
            timeout=HANGS_S,
            check=False,
        )
        return checked(Result(done.returncode, done.stdout, done.stderr))

    return run


@pytest.fixture(autouse=True)
def _nothing_is_worked_out_twice(worked_out_once: None) -> None:
    """What pairs show and where drives went is tested elsewhere."""
