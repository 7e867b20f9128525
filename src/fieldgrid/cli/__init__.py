"""The command line: parse, call one function of the library, print its result.

Data goes to stdout, everything else to stderr. Exit status 0 is success, 1 a problem with the
data, 2 a wrong use of the command.
"""

from __future__ import annotations

import importlib.metadata
import os
import signal
import sys
from typing import Annotated

import typer

# Before NumPy is imported: the banded systems of a drive are too small for the threads of BLAS,
# which then wait for each other, four times as long as one thread takes.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from fieldgrid.cli import (
    build,
    convert,
    diff,
    evaluate,
    export,
    inspect,
    merge,
    mount,
    query,
    repair,
    sessions,
    show,
    track,
    verify,
)
from fieldgrid.errors import FieldgridError

app = typer.Typer(
    name="fieldgrid",
    help="One map in metres east and north from a stereo camera and a GNSS receiver.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command("inspect")(inspect.command)
app.command("track")(track.command)
app.command("build")(build.command)
app.command("mount")(mount.command)
app.command("convert")(convert.command)
app.command("sessions")(sessions.command)
app.command("show")(show.command)
app.command("export")(export.command)
app.command("evaluate")(evaluate.command)
app.command("diff")(diff.command)
app.command("query")(query.command)
app.command("merge")(merge.command)
app.command("verify")(verify.command)
app.command("repair")(repair.command)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"fieldgrid {importlib.metadata.version('fieldgrid')}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print it and exit.")
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command line; the entry point of the `fieldgrid` script."""
    # A polite request to end unwinds like an error, so that nothing half-written stays.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    try:
        app()
    except FieldgridError as error:
        print(f"fieldgrid: {error}", file=sys.stderr)
        sys.exit(1)
    except BrokenPipeError:
        # The reader of our stdout has gone (a pager, head): not a problem worth a message.
        sys.stderr.close()
        sys.exit(1)
    except OSError as error:
        # What no part of the library could foresee: a disk that fills up under a cache, say.
        what = error.filename or "a file"
        print(f"fieldgrid: {what}: {error.strerror or error}; check the disk.", file=sys.stderr)
        sys.exit(1)
