"""What is said on the screen when the first run on a machine compiles."""

from __future__ import annotations

from fieldgrid.cli import output
from fieldgrid.core import when_compiling


def tell_of_compiling() -> None:
    """Say it on a terminal when the inner loops have to be compiled."""

    def say() -> None:
        if output.shows_progress():
            output.message(
                "compiling the inner loops for this machine, which takes up to a minute; "
                "later runs load them"
            )

    when_compiling(say)
