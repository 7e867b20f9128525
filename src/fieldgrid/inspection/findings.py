"""What an inspection finds: how bad it is, what it is called, what it is, and what to do."""

from __future__ import annotations

from enum import StrEnum
from typing import Any, NamedTuple


class Severity(StrEnum):
    """How bad a finding is.

    With an error `build` fails or the map is wrong; with a warning the map is poorer than the
    drive; the rest is for information.
    """

    ERROR = "error"
    WARNING = "warning"
    INFO = "info"


_ORDER = {Severity.ERROR: 0, Severity.WARNING: 1, Severity.INFO: 2}


class Finding(NamedTuple):
    """One finding. `code` is short and stays what it is, for programs; `message` is a sentence
    with the value, `remedy` another one that names the flag or the key; `stops_build` says that
    `build` would not make a map of this drive."""

    severity: Severity
    code: str
    message: str
    remedy: str = ""
    stops_build: bool = False

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {**self._asdict(), "severity": self.severity.value}


def error(code: str, message: str, remedy: str = "") -> Finding:
    """What makes the map wrong, though one is made."""
    return Finding(Severity.ERROR, code, message, remedy)


def stop(code: str, message: str, remedy: str = "") -> Finding:
    """What `build` refuses."""
    return Finding(Severity.ERROR, code, message, remedy, stops_build=True)


def warning(code: str, message: str, remedy: str = "") -> Finding:
    """What makes the map poorer."""
    return Finding(Severity.WARNING, code, message, remedy)


def info(code: str, message: str, remedy: str = "") -> Finding:
    """What is good to know."""
    return Finding(Severity.INFO, code, message, remedy)


def in_order(findings: list[Finding]) -> tuple[Finding, ...]:
    """The worst first; those of one severity in the order in which they were found."""
    return tuple(sorted(findings, key=lambda finding: _ORDER[finding.severity]))
