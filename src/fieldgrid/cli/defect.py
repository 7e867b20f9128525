"""The last line of defence: what no part of the program foresaw, as one sentence."""

from __future__ import annotations

import os
import shlex
import sys
import tempfile
import traceback


def describe(error: BaseException) -> str:
    """One sentence that says what happened and how to report it. The traceback goes to a file."""
    what = f"stopped at an error of its own ({type(error).__name__}: {error})"
    try:
        handle, path = tempfile.mkstemp(prefix="fieldgrid-defect-", suffix=".txt")
        with os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write(f"$ {shlex.join(['fieldgrid', *sys.argv[1:]])}\n\n")
            file.write("".join(traceback.format_exception(error)))
    except OSError:
        return f"{what}; please report it with the command and the output of `fieldgrid info`."
    return f"{what}; please report it with {path} and the output of `fieldgrid info`."
