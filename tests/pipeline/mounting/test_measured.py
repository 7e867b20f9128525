"""Means of values that follow each other, and how sure they are."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fieldgrid.core import MeasuredValue, mean_of, repeated
from fieldgrid.core.measured import kept


def test_independent_values_each_speak_for_themselves() -> None:
    values = np.random.default_rng(0).normal(3.0, 0.5, 400)
    mean = mean_of(values, 0.0)
    assert mean.value == pytest.approx(3.0, abs=0.08)
    assert mean.sigma == pytest.approx(0.5 / 20.0, rel=0.35)


def test_values_that_wander_are_less_sure() -> None:
    """The scatter of the means of many wandering series is what their sigmas say."""
    random = np.random.default_rng(1)
    means, sigmas = [], []
    for _ in range(200):
        noise = random.normal(0.0, 1.0, 160)
        wandering = np.convolve(noise, np.ones(8) / 8.0, mode="valid")
        mean = mean_of(wandering, 0.0)
        means.append(mean.value)
        sigmas.append(mean.sigma)
    assert np.median(sigmas) == pytest.approx(np.std(means), rel=0.4)
    assert np.median(sigmas) > 1.8 * np.std(wandering) / math.sqrt(len(wandering))


def test_an_outlier_is_left_out() -> None:
    values = np.append(np.random.default_rng(2).normal(0.0, 0.1, 30), 40.0)
    assert list(np.flatnonzero(~kept(values))) == [30]
    assert abs(mean_of(values, 0.0).value) < 0.1


def test_the_floor_is_what_no_number_of_values_removes() -> None:
    assert mean_of(np.full(100, 2.0), 0.3) == MeasuredValue(2.0, 0.3)


def test_a_series_that_does_not_change_repeats_nothing() -> None:
    assert repeated(np.full(9, 4.0)) == 1.0


def test_off_counts_sigmas_upwards() -> None:
    assert MeasuredValue(2.0, 0.5).off(3.0) == 2.0
    assert MeasuredValue(2.0, 0.5).off(1.5) == -1.0


def test_a_mean_of_eight_repeats_itself_eight_times() -> None:
    noise = np.random.default_rng(3).normal(0.0, 1.0, 40_000)
    smooth = np.convolve(noise, np.ones(8) / 8.0, mode="valid")
    assert repeated(smooth) == pytest.approx(8.0, rel=0.1)
