"""Numbers in tables."""

import math

import pytest

from fieldgrid.cli import output


@pytest.mark.parametrize(
    ("value", "text"), [(None, "-"), (math.nan, "-"), (0.0, "0.0 °"), (-12.34, "-12.3 °")]
)
def test_what_is_not_known_is_a_dash(value: float | None, text: str) -> None:
    assert output.number(value, 1, "°") == text
