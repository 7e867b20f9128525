"""Quality of rows, and rows against a survey."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shapely import LineString

from fieldgrid.core import ConfigError
from fieldgrid.field import Planting as Found, against_survey, block_quality, row_quality
from fieldgrid.field.rows.find import rows_of_view
from fieldgrid.geometry import wrap_deg
from tests.field.rows.fields import straight, view_of

ROWS = straight(4, 25.0, 2.4, 30.0)


@pytest.fixture(scope="module")
def found() -> Found:
    return rows_of_view(view_of(ROWS))


@pytest.fixture(scope="module")
def posts() -> np.ndarray:
    """A post each 5 m of each row."""
    along = np.linspace(0.02, 0.98, 6)[:, None]
    return np.concatenate([row[0] + along * (row[1] - row[0]) for row in ROWS])


def test_a_good_block_is_parallel_straight_and_equally_spaced(found: Found) -> None:
    (block,) = block_quality(found)
    assert block.spacing_m == pytest.approx(2.4, abs=0.02)
    assert block.spacing_sd_m < 0.05
    assert block.parallel_deg < 0.2
    assert block.bend_m < 0.02
    assert [q.row for q in row_quality(found)] == [r.id for r in found.rows]


def test_one_turned_row_stands_out() -> None:
    rows = [*ROWS[:3], ROWS[3] + np.array([[0.0, 0.0], [0.6, -0.3]])]
    found = rows_of_view(view_of(rows))
    turns = [q.turn_deg for q in row_quality(found)]
    assert int(np.argmax(np.abs(turns))) in (0, 3)
    assert block_quality(found)[0].parallel_deg > 0.3


def test_rows_count_by_their_lengths_in_whatever_direction_they_run(found: Found) -> None:
    first, *others = found.rows
    start = np.array(first.line.coords[0])
    along = np.subtract(first.line.coords[-1], start)
    turn = np.radians(2.0)
    R = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])  # clockwise
    short = first._replace(line=LineString([start, start + 0.2 * R @ along]))
    for way in (1, -1):
        rows = tuple(r._replace(line=LineString(r.line.coords[::way])) for r in (short, *others))
        block = found.blocks[0]._replace(
            heading_deg=wrap_deg(found.blocks[0].heading_deg + (0.0 if way == 1 else 180.0))
        )
        turned = replace(found, rows=rows, blocks=(block,))
        assert [q.turn_deg for q in row_quality(turned)] == pytest.approx(
            [2.0, 0.0, 0.0, 0.0], abs=0.2
        )
        assert block_quality(turned)[0].parallel_deg == pytest.approx(
            2.0 * (0.2 / 3.2) ** 0.5, abs=0.1
        )


def test_a_survey_tells_the_offset_with_its_sign(found: Found, posts: np.ndarray) -> None:
    exact = against_survey(found, posts)
    assert exact.rows == 4
    assert exact.points >= 20
    assert abs(exact.offset_m) < 0.03
    assert exact.rms_m < 0.04
    along = np.subtract(*(found.rows[0].line.coords[k] for k in (-1, 0)))
    left = np.array([-along[1], along[0]]) / np.hypot(*along)
    moved = against_survey(found, posts + 0.3 * left)
    assert moved.offset_m - exact.offset_m == pytest.approx(0.3, abs=0.02)
    assert moved.within_3_sigma < 0.2


def test_a_survey_elsewhere_is_refused(found: Found, posts: np.ndarray) -> None:
    with pytest.raises(ConfigError, match="lies within 1 m of a row"):
        against_survey(found, posts + 500.0)
