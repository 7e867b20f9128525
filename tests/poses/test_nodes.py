"""The instants of a drive, and a gyro's integral between them."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.geometry import Gyro, Motion, Steps
from fieldgrid.poses.nodes import nodes
from tests.simulated import SECOND, START

_Int64 = npt.NDArray[np.int64]

FILL_NS, UNSEEN_NS = SECOND // 4, 10 * SECOND
"""Nodes are at most a quarter of a second apart, but in holes of more than ten."""

gaps = st.lists(st.integers(1, 15 * SECOND), min_size=0, max_size=12)


def at(*seconds: float) -> _Int64:
    return START + np.round(np.array(seconds) * SECOND).astype(np.int64)


@settings(deadline=None)
@given(gaps, st.data())
def test_every_fix_is_a_node_and_no_two_are_far_apart(
    steps_ns: list[int], data: st.DataObject
) -> None:
    fixes = START + np.cumsum([0, *steps_ns])
    rejected = np.array(
        data.draw(st.lists(st.integers(START - SECOND, START + 60 * SECOND), max_size=6)),
        dtype=np.int64,
    )
    found = nodes(fixes, np.sort(np.concatenate([fixes, rejected])), Motion())
    assert (np.diff(found.time_ns) > 0).all()
    assert found.time_ns[[0, -1]].tolist() == fixes[[0, -1]].tolist()
    own = found.fix >= 0
    assert np.array_equal(found.time_ns[own], fixes)
    assert found.fix[own].tolist() == list(range(len(fixes)))
    inside = rejected[(rejected >= fixes[0]) & (rejected <= fixes[-1])]
    assert np.isin(inside, found.time_ns).all()
    step_ns = np.diff(found.time_ns)
    assert ((step_ns <= FILL_NS) | (step_ns > UNSEEN_NS)).all()
    # What is filled in is even, and no more than is needed.
    wanted = np.unique(np.concatenate([fixes, inside]))
    expected = sum(1 if gap > UNSEEN_NS else -(-gap // FILL_NS) for gap in np.diff(wanted).tolist())
    assert len(found.time_ns) == 1 + expected
    assert np.isnan(found.turned_rad).all()
    assert len(found.turned_rad) == len(found.time_ns) - 1


def steps_at(*seconds: float) -> Steps:
    """Steps from each instant to the next."""
    one = np.ones(len(seconds) - 1)
    return Steps(at(*seconds)[:-1], at(*seconds)[1:], *[one] * 9)


def test_images_are_nodes_and_lead_beyond_the_fixes() -> None:
    fixes = at(2.0, 3.0)
    found = nodes(fixes, fixes, Motion(steps=steps_at(2.1, 2.3, 2.9)))
    assert np.isin(at(2.1, 2.3, 2.9), found.time_ns).all()
    assert found.time_ns[[0, -1]].tolist() == fixes.tolist()
    # A chain of steps that reaches the fixes is followed, another is not.
    chain = steps_at(0.0, 0.4, 1.1, 2.5, 3.2, 4.0)
    found = nodes(fixes, fixes, Motion(steps=chain))
    assert np.isin(at(0.0, 0.4, 1.1, 2.5, 3.2, 4.0), found.time_ns).all()
    assert found.time_ns[[0, -1]].tolist() == at(0.0, 4.0).tolist()
    apart = nodes(fixes, fixes, Motion(steps=steps_at(0.0, 0.4, 1.1)))
    assert apart.time_ns[[0, -1]].tolist() == fixes.tolist()


@pytest.mark.parametrize("rate_hz", [20.0, 100.0])
def test_a_gyro_s_integral_is_the_angle(rate_hz: float) -> None:
    """A rate of cos(t) turns by sin(t), whatever the phase of samples and nodes."""
    samples = np.arange(0.0, 20.0, 1.0 / rate_hz) + 0.0037
    gyro = Gyro(at(*samples), np.cos(samples))
    fixes = at(*np.arange(0.11, 19.0, 0.17))
    found = nodes(fixes, fixes, Motion(gyro=gyro))
    seconds = (found.time_ns - START) / SECOND
    # A node between two samples costs at most an eighth of a square of the step.
    assert found.turned_rad == pytest.approx(np.diff(np.sin(seconds)), abs=0.26 / rate_hz**2)


def test_a_hole_in_the_gyro_is_unknown_and_nothing_else() -> None:
    samples = np.concatenate([np.arange(1.0, 4.0, 0.01), np.arange(6.0, 9.0, 0.01)])
    gyro = Gyro(at(*samples), np.full(len(samples), 0.3))
    fixes = at(*np.arange(0.0, 10.0, 0.2))
    found = nodes(fixes, fixes, Motion(gyro=gyro))
    start, stop = ((found.time_ns[k : len(found.time_ns) - 1 + k] - START) / SECOND for k in (0, 1))
    inside = ((start >= 1.0) & (stop <= 3.99)) | ((start >= 6.0) & (stop <= 8.99))
    assert found.turned_rad[inside] == pytest.approx(0.06)
    assert np.isnan(found.turned_rad[~inside]).all()


def test_one_sample_is_no_gyro() -> None:
    fixes = at(0.0, 0.2, 0.4)
    found = nodes(fixes, fixes, Motion(gyro=Gyro(at(0.2), np.array([0.1]))))
    assert np.isnan(found.turned_rad).all()


def test_a_single_fix_is_a_drive() -> None:
    found = nodes(at(1.0), at(0.0, 1.0, 2.0), Motion())
    assert found.time_ns.tolist() == at(1.0).tolist()
    assert len(found.turned_rad) == 0
