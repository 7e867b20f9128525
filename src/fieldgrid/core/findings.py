"""What is found out about a drive besides its poses and its map, for people and for programs.

`inspect`, `track`, `build` and `live` tell the same findings. A code is short and stays what it
is; `docs/findings.md` lists all of them.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from enum import StrEnum
from functools import partial
from typing import Any, NamedTuple

from fieldgrid.core.choices import StopCode


class Severity(StrEnum):
    """How bad a finding is.

    With an error `build` makes no map, unless the error is one that can be accepted; with a
    warning the map is poorer than the drive; the rest is for information.
    """

    ERROR = "error"
    WARNING = "warning"
    INFO = "info"


class Figure(NamedTuple):
    """A number that a finding is about, with its unit: `m`, `s`, `deg`, `%`, `px`, `Hz`,
    `ppm`, `sigmas` or `times`."""

    value: float
    unit: str


@dataclass(frozen=True, slots=True)
class Finding:
    """One finding: `message` is a sentence with the value, `remedy` another one that names the
    flag or the key, empty where nothing is to be done. `figure` is the value for programs, None
    where the finding is about no number or about several."""

    severity: Severity
    code: str
    message: str
    remedy: str = ""
    figure: Figure | None = None

    def __str__(self) -> str:
        return f"{self.message} {self.remedy}".strip()

    @property
    def acceptable(self) -> bool:
        """Whether it stops a build only until it is accepted."""
        return self.severity is Severity.ERROR and self.code in list(StopCode)

    def whole(self) -> str:
        """The finding with how to accept it, where that can be."""
        accept = f" To build nevertheless, give --accept {self.code}." if self.acceptable else ""
        return f"{self}{accept}"

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return {
            **asdict(self),
            "severity": self.severity.value,
            "figure": self.figure and self.figure._asdict(),
            "acceptable": self.acceptable,
        }


error = partial(Finding, Severity.ERROR)
warning = partial(Finding, Severity.WARNING)
info = partial(Finding, Severity.INFO)


def in_order(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """The worst first, each once; those of one severity in the order in which they were found."""
    worst_first = list(Severity)
    once = dict.fromkeys(findings)
    return tuple(sorted(once, key=lambda finding: worst_first.index(finding.severity)))
