"""Whether a pose is sure enough, and the sentences that say why not."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from fieldgrid.core import PoseSettings
from fieldgrid.poses import ErrorBudget
from fieldgrid.poses.table import PoseTable, jumps
from fieldgrid.poses.verdict import refusals

PLAIN = PoseSettings()


def refusal(
    heading_deg: float,
    position_m: float,
    relative_m: float,
    doubt: float,
    settings: PoseSettings,
    budget: ErrorBudget | None,
    offset_m: float = 0.0,
    stated_m: float = 1.0,
    rejection: str = "",
) -> str:
    """The reason of a table of one pose."""
    one, nothing = np.ones(1), np.zeros(1)
    table = PoseTable(
        np.zeros(1, np.int64),
        nothing,
        nothing,
        nothing,
        nothing,
        heading_deg * one,
        position_m * one,
        relative_m * one,
        one,
        np.ones(1, np.int64),
        doubt * one,
        offset_m * one,
        stated_m * one,
        np.zeros(1, np.int64),
        np.zeros(1, np.bool_),
        [rejection],
        [""],
    )
    (reason,) = refusals(table, settings, budget)
    return reason


UNKNOWN = "heading unknown: none is recorded, and the vehicle does not move"
GOOD = (0.5, 0.1, 0.02, 0.001)


@pytest.mark.parametrize(
    ("sure", "sentence"),
    [
        ((math.inf, 0.1, 0.02, 0.0), UNKNOWN),
        ((math.nan, 0.1, 0.02, 0.0), UNKNOWN),
        ((90.0, 0.1, 0.02, 0.0), UNKNOWN),
        ((3.1, 0.1, 0.02, 0.0), "heading sigma 3.1° > 3°"),
        ((0.5, 2.25, 0.02, 0.0), "position sigma 2.25 m > 2 m"),
        ((0.5, 0.1, 0.02, 0.3), "forward or reverse is unsure: 30.0 % > 2 % for the other"),
        ((3.0, 2.0, 0.02, 0.02), ""),
        (GOOD, ""),
    ],
)  # fmt: skip
def test_sentences(sure: tuple[float, float, float, float], sentence: str) -> None:
    assert refusal(*sure, PLAIN, None) == sentence


def test_limits_can_be_set() -> None:
    wide = PoseSettings(max_heading_sigma_deg=20.0, max_position_sigma_m=9.0, max_gear_doubt=0.4)
    assert refusal(15.0, 8.0, 8.0, 0.35, wide, None) == ""
    assert "20°" in refusal(21.0, 8.0, 8.0, 0.35, wide, None)


@given(st.floats(0.01, 2.9), st.floats(0.0, 0.5), st.floats(2.0, 15.0), st.floats(0.02, 1.0))
def test_a_far_cell_must_stay_within_the_budget(
    sigma_deg: float, relative_m: float, reach_m: float, cell_m: float
) -> None:
    """The position counts by what it errs among neighbours, the heading by the reach."""
    against = refusal(sigma_deg, 1.0, relative_m, 0.0, PLAIN, ErrorBudget(cell_m, reach_m))
    off_m = abs(complex(relative_m, reach_m * sigma_deg * math.pi / 180.0))
    if abs(off_m - cell_m) > 1e-9:
        assert bool(against) == (off_m > cell_m)


def test_the_budget_s_sentence() -> None:
    against = refusal(2.0, 0.1, 0.05, 0.0, PLAIN, ErrorBudget(0.25, 12.0))
    assert against == "a cell 12 m ahead would be off by 0.42 m > 0.25 m: heading sigma 2.0°"


def test_a_pose_that_leaves_its_fixes_is_refused() -> None:
    sentence = refusal(*GOOD, PLAIN, None, offset_m=0.7, stated_m=0.3)
    assert sentence == (
        "the estimate lies 0.70 m from the fixes around it, which state an error of 0.30 m"
    )
    assert refusal(*GOOD, PLAIN, None, offset_m=0.5, stated_m=0.3) == ""
    # A receiver of millimetres is not held to them: an antenna sways.
    assert refusal(*GOOD, PLAIN, None, offset_m=0.09, stated_m=0.002) == ""


def test_the_first_reason_stays() -> None:
    assert refusal(math.inf, 9.0, 9.0, 1.0, PLAIN, None, rejection="a jump") == "a jump"


# --- jumps


def straight(n: int = 20) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    return np.arange(n) * 0.3, np.zeros(n), np.full(n, 90.0)


@pytest.mark.parametrize("size_deg", [40.0, -90.0, 180.0])
def test_a_lone_jump_is_found(size_deg: float) -> None:
    east, north, heading = straight()
    heading[7] += size_deg
    found = jumps(east, north, heading, np.full(20, 0.5), 1.0)
    assert np.flatnonzero(found).tolist() == [7]


def test_what_a_vehicle_can_turn_is_no_jump() -> None:
    n = 40
    angle = np.arange(n) * 0.3 / 1.5  # a circle of 1.5 m
    east, north = 1.5 * (1.0 - np.cos(angle)), 1.5 * np.sin(angle)
    heading = np.degrees(angle)
    assert not jumps(east, north, heading, np.full(n, 0.5), 1.0).any()
    # The same turns are jumps to a vehicle that needs 30 m for them.
    assert not jumps(east, north, heading, np.full(n, 0.5), 30.0)[0]
    assert jumps(east, north, heading, np.full(n, 0.1), 30.0)[1:-1].all()


def test_a_lasting_change_is_no_jump() -> None:
    east, north, heading = straight()
    heading[10:] += 120.0
    assert not jumps(east, north, heading, np.full(20, 0.5), 1.0).any()


def test_an_unsure_heading_does_not_jump() -> None:
    east, north, heading = straight()
    heading[7] += 40.0
    sigma = np.full(20, 0.5)
    sigma[7] = 15.0
    assert not jumps(east, north, heading, sigma, 1.0).any()


def test_unknown_headings_are_passed_over() -> None:
    east, north, heading = straight()
    heading[7] += 90.0
    heading[[6, 8]] = np.nan
    sigma = np.where(np.isnan(heading), np.inf, 0.5)
    assert np.flatnonzero(jumps(east, north, heading, sigma, 1.0)).tolist() == [7]
    few = np.where(np.arange(20) < 2, heading, np.nan)
    assert not jumps(east, north, few, np.full(20, 0.5), 1.0).any()


def test_across_south_is_no_jump() -> None:
    east, north, _ = straight()
    heading = np.where(np.arange(20) % 2 == 0, 179.5, -179.5)
    assert not jumps(east, north, heading, np.full(20, 0.2), 1.0).any()
