"""Broken drives, one call each."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from fieldgrid.core import Severity
from fieldgrid.pipeline import Inspection
from tests.pipeline.inspection.broken import copy_of

Make = Callable[..., Path]


@pytest.fixture
def drive(tmp_path: Path) -> Make:
    """Makes copies of the example drive in a folder of the test's own."""

    def make(name: str = "drive", **how: Any) -> Path:
        return copy_of(tmp_path / name, **how)

    return make


def codes(found: Inspection, *severities: Severity) -> set[str]:
    """The codes of the findings, of all severities or of some."""
    wanted = severities or tuple(Severity)
    return {finding.code for finding in found.findings if finding.severity in wanted}


def serious(found: Inspection) -> set[str]:
    """The codes of errors and warnings."""
    return codes(found, Severity.ERROR, Severity.WARNING)


@pytest.fixture(autouse=True)
def _nothing_is_worked_out_twice(worked_out_once: None) -> None:
    """What pairs show and where drives went is tested elsewhere."""
