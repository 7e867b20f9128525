"""The motion of a camera from matched points: exact, among wrong ones, and with its error."""

from __future__ import annotations

import math

import cv2
import numpy as np
import pytest
from scipy.optimize import least_squares

from fieldgrid.core import Float64
from fieldgrid.perception import RigidMotion
from fieldgrid.perception.odometry.rigid import SIGMA_PX, Lens, predicted, refine, search

LENS = Lens(780.0, 320.0, 240.0, 156.0)
STILL = RigidMotion(np.eye(3), np.zeros(3))


def motion(turn_deg: float, t_m: tuple[float, float, float]) -> RigidMotion:
    R, _ = cv2.Rodrigues(np.radians([0.1 * turn_deg, turn_deg, -0.05 * turn_deg]))
    return RigidMotion(R, np.array(t_m))


def points(count: int, seed: int) -> Float64:
    rng = np.random.default_rng(seed)
    return rng.uniform([-4.0, -2.0, 4.0], [4.0, 2.0, 20.0], (count, 3))


def moved(points_m: Float64, by: RigidMotion) -> Float64:
    return points_m @ by.R_stop_start.T + by.t_stop_start_m


def angle_deg(one: RigidMotion, other: RigidMotion) -> float:
    return math.degrees(
        float(np.linalg.norm(cv2.Rodrigues(one.R_stop_start.T @ other.R_stop_start)[0]))
    )


@pytest.mark.parametrize("wrong", [0.0, 0.5, 0.85])
@pytest.mark.parametrize("true", [motion(0.0, (0, 0, -1.5)), motion(18.0, (0.5, 0.1, 1.0))])
def test_the_search_finds_the_motion_of_most(true: RigidMotion, wrong: float) -> None:
    start = points(200, 1)
    stop = moved(start, true)
    mixed = np.arange(round(wrong * len(start)))
    stop[mixed] = stop[np.roll(mixed, 1)]
    found = search(start, stop, predicted(stop, STILL, LENS), LENS)
    assert found is not None
    assert angle_deg(found, true) < 0.05
    assert found.t_stop_start_m == pytest.approx(true.t_stop_start_m, abs=0.02)


def test_no_motion_from_two_points_nor_from_what_is_not_rigid() -> None:
    start = points(40, 2)
    pixels = predicted(start, STILL, LENS)
    assert search(start[:2], start[:2], pixels[:2], LENS) is None
    assert search(start, 3.0 * start, predicted(3.0 * start, STILL, LENS), LENS) is None


def noisy(true: RigidMotion, seed: int, count: int = 150) -> tuple[Float64, Float64, Float64]:
    """Measured pixels at the start and the stop, and the points that the former stand for."""
    rng = np.random.default_rng(seed)
    exact = points(count, seed)
    start_px = predicted(exact, STILL, LENS) + rng.normal(0.0, SIGMA_PX, (count, 3))
    stop_px = predicted(exact, true, LENS) + rng.normal(0.0, SIGMA_PX, (count, 3))
    u, v, d = start_px.T
    z = LENS.focal_baseline_px_m / d
    start_m = np.column_stack(
        [(u - LENS.cx_px) * z / LENS.focal_px, (v - LENS.cy_px) * z / LENS.focal_px, z]
    )
    return start_px, stop_px, start_m


def test_the_refined_motion_is_the_likeliest_one() -> None:
    """Beside scipy, with points and motion unknown: least squares over both images' pixels."""
    true = motion(3.0, (0.05, -0.02, -0.8))
    start_px, stop_px, start_m = noisy(true, seed=5, count=40)
    found = refine(true, start_m, start_px, stop_px, np.ones((40, 2)), LENS)
    assert found is not None
    assert found.inliers.all()

    def residuals(unknown: Float64) -> Float64:
        R = cv2.Rodrigues(unknown[:3])[0] @ found.motion.R_stop_start
        by = RigidMotion(R, found.motion.t_stop_start_m + unknown[3:6])
        p = unknown[6:].reshape(-1, 3)
        both = predicted(p, STILL, LENS) - start_px, predicted(p, by, LENS) - stop_px
        return np.concatenate([(off / SIGMA_PX).ravel() for off in both])

    best = least_squares(residuals, np.concatenate([np.zeros(6), start_m.ravel()]), x_scale="jac")
    sigma = np.sqrt(np.diag(found.covariance))
    # Tukey's weights take a little from points that lie far off, so the two agree within a sigma.
    assert (np.abs(best.x[:6]) < 0.5 * sigma).all()
    J = best.jac
    exact = np.sqrt(np.diag(np.linalg.inv(J.T @ J))[:6])
    assert sigma == pytest.approx(exact, rel=0.25)


def test_errors_are_as_large_as_is_stated() -> None:
    """Squared errors in units of the covariance have the mean of chi squared, 6 degrees."""
    true, squared = motion(2.0, (0.1, 0.0, -1.0)), []
    for seed in range(60):
        start_px, stop_px, start_m = noisy(true, seed)
        found = refine(true, start_m, start_px, stop_px, np.ones((150, 2)), LENS)
        assert found is not None
        w = cv2.Rodrigues(true.R_stop_start @ found.motion.R_stop_start.T)[0].ravel()
        off = np.concatenate([w, true.t_stop_start_m - found.motion.t_stop_start_m])
        squared.append(off @ np.linalg.inv(found.covariance) @ off)
    assert 4.5 < np.mean(squared) < 8.0


def test_points_on_one_line_do_not_determine_a_motion() -> None:
    line = np.linspace([-1.0, 0.5, 6.0], [1.0, 0.5, 6.0], 60)
    pixels = predicted(line, STILL, LENS)
    assert refine(STILL, line, pixels, pixels, np.ones((60, 2)), LENS) is None


def test_wrong_matches_are_no_inliers() -> None:
    true = motion(1.0, (0.0, 0.0, -0.5))
    start_px, stop_px, start_m = noisy(true, seed=9)
    stop_px[:15] += 30.0
    found = refine(true, start_m, start_px, stop_px, np.ones((150, 2)), LENS)
    assert found is not None
    assert not found.inliers[:15].any()
    assert found.inliers[15:].mean() > 0.97
