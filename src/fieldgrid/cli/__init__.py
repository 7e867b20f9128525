"""The command line: parse, call one function of the library, print its result.

Data goes to stdout, everything else to stderr. Exit status 0 is success, 1 a problem with the
data, 2 a wrong use of the command, 70 a defect of this program.
"""

from __future__ import annotations

import errno
import gc
import os
import signal
import sys
from typing import Annotated, Any

import typer

# Before NumPy is imported: the banded systems of a drive are too small for the threads of BLAS,
# which then wait for each other, four times as long as one thread takes.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from fieldgrid.cli.listing import CONTEXT, Commands
from fieldgrid.cli.output import log_cost, message
from fieldgrid.core import FieldgridError, printable, when_compiling

app = typer.Typer(
    name="fieldgrid",
    cls=Commands,
    help="One map in metres east and north from a stereo camera and a GNSS receiver.",
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings=CONTEXT,
)

_UsageError: Any = typer.BadParameter.__base__  # typer has no public name for it

_COMPILES = (
    "compiling the inner loops for this machine, which takes up to a minute; later runs load them"
)

_LONGEST = 2000
"""Letters of a message: a file may hold a name of a megabyte."""


def _version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version  # 60 ms, which no command has to wait for

        typer.echo(f"fieldgrid {version('fieldgrid')}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    pass


_REMEDIES = {
    errno.ENAMETOOLONG: "give a shorter name",
    errno.ENOSPC: "free some space on the disk",
    errno.EACCES: "check the permissions of it and of its folder",
    errno.EROFS: "the disk is for reading only; write elsewhere",
    **dict.fromkeys(
        [errno.ESTALE, errno.ENOTCONN, errno.EHOSTDOWN, errno.ENODEV, errno.ETIMEDOUT],
        "connect the drive or network folder again, and repeat the command",
    ),
}


def main() -> None:
    """Run the command line; the entry point of the `fieldgrid` script.

    Whatever ends with a status other than 0 has its sentence on stderr.
    """
    # A polite request to end unwinds like an error, so that nothing half-written stays.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    when_compiling(lambda: message(_COMPILES))
    # What is imported lives on; to look for cycles in it every 700 objects takes 0.1 s.
    gc.set_threshold(50_000)
    # A name that is no UTF-8 can still be printed.
    sys.stdout.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    try:
        try:
            asked = sys.argv[1:] or ["--help"]
            if "--ros-args" in asked and not {"--ros", "serve-ros"}.isdisjoint(asked):
                asked = asked[: asked.index("--ros-args")]  # what follows is for ROS
            app(asked, prog_name="fieldgrid", standalone_mode=False)
        finally:
            log_cost()
    except _UsageError as error:
        if error.ctx is not None:
            usage = f"{error.ctx.get_usage()}\nTry '{error.ctx.command_path} -h' for help."
            print(usage, end="\n\n", file=sys.stderr)
        _end(error.format_message().rstrip(".") + ".", 2)
    except SystemExit as request:
        _end_at_request(request)
    except FieldgridError as error:
        _end(str(error), 1)
    except BrokenPipeError:
        # The reader of our stdout has gone (a pager, head): not a problem worth a message.
        sys.stderr.close()
        sys.exit(1)
    except OSError as error:
        # What no part of the library could foresee: a disk that fills up under a cache, say.
        what = error.filename or "a file"
        remedy = _REMEDIES.get(error.errno or 0, "check the disk")
        _end(f"{what}: {error.strerror or error}; {remedy}.", 1)
    except MemoryError:
        _end("The memory is full; give smaller --bounds, a larger --cell or fewer --jobs.", 1)
    except Exception as error:  # noqa: BLE001 - the last line of defence
        from fieldgrid.cli.defect import describe

        cause: BaseException | None = error
        while cause is not None:
            # A request to end that arrives in compiled code comes back as an error of another kind.
            if isinstance(cause, SystemExit):
                _end_at_request(cause)
            cause = cause.__cause__

        _end(describe(error), 70)


def _end_at_request(request: SystemExit) -> None:
    """End as Ctrl-C or SIGTERM asked, saying what is kept; other ends stay as they are."""
    if request.code not in (128 + signal.SIGINT, 128 + signal.SIGTERM):
        raise request
    kept = getattr(request, "__notes__", [""])[-1]
    _end(f"interrupted. {kept}".rstrip(), request.code)


def _end(message: str, status: int) -> None:
    if len(message) > _LONGEST:
        message = f"{message[: _LONGEST // 2]} [...] {message[-_LONGEST // 2 :]}"
    print(f"fieldgrid: {printable(message)}", file=sys.stderr)
    sys.exit(status)
