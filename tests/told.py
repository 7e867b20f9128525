"""What a report tells of a drive, by codes."""

from __future__ import annotations

from typing import Protocol

from fieldgrid.core import Finding, Severity


class Telling(Protocol):
    """A report with findings."""

    @property
    def findings(self) -> tuple[Finding, ...]: ...


def warnings(report: Telling) -> list[Finding]:
    """Its errors and warnings, in their order."""
    return [one for one in report.findings if one.severity is not Severity.INFO]


def codes(report: Telling) -> list[str]:
    """The codes of its errors and warnings."""
    return [one.code for one in warnings(report)]
