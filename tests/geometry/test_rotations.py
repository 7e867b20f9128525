"""Rotations beside SciPy's, and the conventions of roll and pitch."""

from __future__ import annotations

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given
from scipy.spatial.transform import Rotation

from fieldgrid.geometry import (
    R_enu_level,
    R_level_vehicle,
    cross_matrices,
    from_vectors,
    heading_rad,
    roll_pitch_deg,
    to_vectors,
    wrap_deg,
)

small = st.floats(-1.7, 1.7)


@given(st.tuples(small, small, small))
def test_vectors_and_matrices_are_those_of_scipy(vector: tuple[float, float, float]) -> None:
    rotation = Rotation.from_rotvec(vector)
    np.testing.assert_allclose(from_vectors(np.array(vector)), rotation.as_matrix(), atol=1e-14)
    np.testing.assert_allclose(to_vectors(rotation.as_matrix()), vector, atol=1e-9)


def test_many_at_a_time() -> None:
    vectors = np.random.default_rng(0).normal(size=(4, 5, 3)) * 0.5
    np.testing.assert_allclose(to_vectors(from_vectors(vectors)), vectors, atol=1e-12)
    others = np.ones((4, 5, 3))
    product = (cross_matrices(vectors) @ others[..., None])[..., 0]
    np.testing.assert_allclose(product, np.cross(vectors, others))


@given(st.floats(-179.0, 179.0), st.floats(-60.0, 60.0), st.floats(-60.0, 60.0))
def test_roll_pitch_and_heading_come_back(heading: float, roll: float, pitch: float) -> None:
    R = R_enu_level(heading) @ R_level_vehicle(roll, pitch)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    found = roll_pitch_deg(R)
    assert found[0] == pytest.approx(roll, abs=1e-9)
    assert found[1] == pytest.approx(pitch, abs=1e-9)
    assert float(wrap_deg(np.degrees(heading_rad(R)) - heading)) == pytest.approx(0.0, abs=1e-9)


def test_the_nose_rises_with_pitch_and_the_right_side_falls_with_roll() -> None:
    right, forward, _ = (R_enu_level(90.0) @ R_level_vehicle(0.0, 10.0)).T
    np.testing.assert_allclose(
        forward, [np.cos(np.radians(10)), 0, np.sin(np.radians(10))], atol=1e-12
    )
    np.testing.assert_allclose(right, [0.0, -1.0, 0.0], atol=1e-12)
    right, forward, _ = (R_enu_level(0.0) @ R_level_vehicle(10.0, 0.0)).T
    np.testing.assert_allclose(
        right, [np.cos(np.radians(10)), 0, -np.sin(np.radians(10))], atol=1e-12
    )
    np.testing.assert_allclose(forward, [0.0, 1.0, 0.0], atol=1e-12)
