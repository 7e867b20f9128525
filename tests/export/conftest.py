"""What tests of exports share."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from tests.export.killing import KilledAt, small_process


@pytest.fixture(scope="session")
def killed_at() -> Iterator[KilledAt]:
    """Writes sets of files and is killed at it."""
    with small_process() as killed:
        yield killed
