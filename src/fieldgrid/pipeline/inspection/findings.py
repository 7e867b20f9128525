"""What an inspection finds: how bad it is, what it is called, what it is, and what to do."""

from __future__ import annotations

from enum import StrEnum
from typing import Any, NamedTuple

from fieldgrid.core import StopCode


class Severity(StrEnum):
    """How bad a finding is.

    With an error `build` makes no map, unless the error is one that can be accepted; with a
    warning the map is poorer than the drive; the rest is for information.
    """

    ERROR = "error"
    WARNING = "warning"
    INFO = "info"


class Finding(NamedTuple):
    """One finding. `code` is short and stays what it is, for programs; `message` is a sentence
    with the value, `remedy` another one that names the flag or the key."""

    severity: Severity
    code: str
    message: str
    remedy: str = ""

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        can_accept = self.severity is Severity.ERROR and self.code in list(StopCode)
        return {**self._asdict(), "severity": self.severity.value, "acceptable": can_accept}


def error(code: str, message: str, remedy: str = "") -> Finding:
    """What stops a build."""
    otherwise = f" To build nevertheless, give --accept {code}." if code in list(StopCode) else ""
    return Finding(Severity.ERROR, code, message, f"{remedy}{otherwise}".strip())


def warning(code: str, message: str, remedy: str = "") -> Finding:
    """What makes the map poorer."""
    return Finding(Severity.WARNING, code, message, remedy)


def info(code: str, message: str, remedy: str = "") -> Finding:
    """What is good to know."""
    return Finding(Severity.INFO, code, message, remedy)


def in_order(findings: list[Finding]) -> tuple[Finding, ...]:
    """The worst first; those of one severity in the order in which they were found."""
    worst_first = list(Severity)
    return tuple(sorted(findings, key=lambda finding: worst_first.index(finding.severity)))
