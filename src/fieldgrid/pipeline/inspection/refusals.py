"""What a build would raise, as findings."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from fieldgrid.core import (
    CalibrationError,
    ConfigError,
    FieldgridError,
    Finding,
    GnssError,
    LackingError,
    RecordingError,
    error,
)

_CODES: tuple[tuple[type[FieldgridError], str], ...] = (
    (CalibrationError, "calibration"),
    (RecordingError, "recording"),
    (GnssError, "fixes"),
    (ConfigError, "setting"),
)


def refusal(problem: FieldgridError, code: str = "") -> Finding:
    """The finding that is an error of a build, whose sentence ends with what to do."""
    usual = next((name for kind, name in _CODES if isinstance(problem, kind)), "recording")
    what, _, remedy = str(problem).rpartition("; ")
    if not what:
        return error(code or usual, str(problem), "Look at what the recording page asks for.")
    return error(code or usual, f"{what}.", remedy[0].upper() + remedy[1:])


def refusals(problem: FieldgridError) -> list[Finding]:
    """The findings that an error of a build is, one for each thing that is lacking."""
    problems = problem.problems if isinstance(problem, LackingError) else (problem,)
    return [refusal(one) for one in problems]


@contextmanager
def noted(findings: list[Finding], code: str = "") -> Iterator[None]:
    """Turns what a build would raise into a finding."""
    try:
        yield
    except FieldgridError as problem:
        findings.append(refusal(problem, code))
