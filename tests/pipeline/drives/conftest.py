"""What most tests of builds share."""

from __future__ import annotations

import pytest


@pytest.fixture(autouse=True)
def _nothing_is_worked_out_twice(request: pytest.FixtureRequest) -> None:
    """What pairs show and where drives went is tested elsewhere."""
    if "worked_out_afresh" not in request.fixturenames:
        request.getfixturevalue("worked_out_once")
