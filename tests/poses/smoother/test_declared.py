"""What the drive makes of what was declared, beside residuals written anew and differenced."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.core import Float64, PoseSettings, Quality
from fieldgrid.geometry import Carrier, Motion
from fieldgrid.poses import estimate_poses
from fieldgrid.poses.smoother import declared, model
from fieldgrid.poses.smoother.declared import Constant, DeclaredCorrection, couplings
from fieldgrid.poses.smoother.envelope import STATES
from fieldgrid.poses.smoother.model import GYRO, GYRO_NOISE, KAPPA, PHI, E, N, V
from tests.poses.smoother.test_model import SEEDS, dense, empty, states
from tests.simulated import DATUM, Command, fixes_of, gyro_of, simulate


@settings(deadline=None, max_examples=25)
@given(SEEDS)
def test_how_fixes_depend_on_lever_and_clock(seed: int) -> None:
    """Beside fixes of an antenna elsewhere, taken a little earlier than they are stamped."""
    random = np.random.default_rng(seed)
    x, lever = states(seed, 3), random.normal(size=2)
    fix, weight = x[:, :2] + random.normal(size=(3, 2)), random.uniform(0.5, 3.0, (3, 2))
    weight[1] = 0.0
    border, corner, right = couplings(x, fix, weight, lever, np.full(2, np.nan), np.ones(2))

    def away(right_m: float, ahead_m: float, late_s: float) -> Float64:
        """Residuals ahead and right [4] in axes that stand still."""
        found = []
        for k in (0, 2):
            heading = 1j * np.exp(-1j * x[k, PHI])
            now = x[k, E] + x[k, model.BIAS_E] + 1j * (x[k, N] + x[k, model.BIAS_N])
            before = now - late_s * x[k, V] * heading
            turned = heading * np.exp(1j * late_s * x[k, V] * x[k, KAPPA])
            lever_now = (lever[1] + ahead_m) - 1j * (lever[0] + right_m)
            off = before + lever_now * turned - (fix[k, 0] + 1j * fix[k, 1])
            found += [(off * np.conj(heading)).real, (off * np.conj(-1j * heading)).real]
        return np.array(found)

    step = 1e-6
    jacobian = np.stack(
        [(away(*(step * e)) - away(*(-step * e))) / (2.0 * step) for e in np.eye(3)], axis=1
    )
    w = weight[[0, 2]].ravel()
    assert corner[:3, :3] == pytest.approx(jacobian.T @ (w[:, None] * jacobian), rel=1e-4, abs=1e-4)
    assert right[:3] == pytest.approx(-jacobian.T @ (w * away(0.0, 0.0, 0.0)), rel=1e-4, abs=1e-4)
    # The coupling is with the states that add_fixes has.
    system = empty(3)
    model.add_fixes(system, x, fix, weight, lever)
    full = dense(system)[: x.size, : x.size]
    for k in (0, 2):
        # A place farther east is the same as one axis' share of an antenna elsewhere.
        sin, cos = np.sin(x[k, PHI]), np.cos(x[k, PHI])
        along = sin * full[STATES * k + E] + cos * full[STATES * k + N]
        assert border[:, 1][STATES * k : STATES * (k + 1)] == pytest.approx(
            along[STATES * k : STATES * (k + 1)]
        )
    assert not border[STATES : 2 * STATES].any()
    assert not border[:, 3].any()


@settings(deadline=None, max_examples=25)
@given(SEEDS, st.booleans())
def test_how_a_gyro_depends_on_its_scale(seed: int, hole: bool) -> None:
    random = np.random.default_rng(seed)
    x, step_s = states(seed, 3), random.uniform(0.1, 0.4, 2)
    turned = random.normal(size=2)
    if hole:
        turned[0] = np.nan
    nowhere = np.zeros((3, 2))
    border, corner, right = couplings(x, nowhere, nowhere, np.zeros(2), turned, step_s)

    def away(x: Float64, scale: float) -> Float64:
        off = np.diff(x[:, PHI]) - ((1.0 + scale) * turned - x[:-1, GYRO] * step_s)
        return np.asarray(np.nan_to_num(off / (GYRO_NOISE * np.sqrt(step_s))))

    by_scale = away(x, 1.0) - away(x, 0.0)  # it is linear
    assert corner[3, 3] == pytest.approx(by_scale @ by_scale)
    assert right[3] == pytest.approx(-by_scale @ away(x, 0.0))
    assert not corner[:3].any()
    for state in range(x.size):
        moved = x.copy()
        moved.flat[state] += 1.0
        assert border[state, 3] == pytest.approx(by_scale @ (away(moved, 0.0) - away(x, 0.0)))


def test_a_solution_that_converges_tells_less_of_a_gyro(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two equal drives the one by a float solution leaves the scale open, and the turns."""
    drive = simulate([Command(8.0, 4.0, bend) for bend in (0.03, -0.03, 0.0)], 40.0)
    fixes = fixes_of(drive, 0.2, 0.01, seed=2)
    motion = Motion(gyro=gyro_of(drive, noise_dps=0.05))

    def usual_deg(quality: Quality) -> float:
        settings = PoseSettings(quality=quality, accuracy_m=0.5)
        found = estimate_poses(fixes, Carrier(0.0), DATUM, settings, motion).trajectory
        return float(np.median(found.heading_sigma_deg))

    float_deg, other_deg = usual_deg(Quality.RTK_FLOAT), usual_deg(Quality.DIFFERENTIAL)
    monkeypatch.setattr(declared, "FLEETING_SHARE", declared.TOLD_SHARE)
    assert float_deg > 1.001 * usual_deg(Quality.RTK_FLOAT)
    assert other_deg == usual_deg(Quality.DIFFERENTIAL)


@pytest.mark.parametrize(
    ("told_s", "misfit", "alone_s", "least_s", "most_s"),
    [
        (2.0, 0.0, 0.5, 0.199, 0.201),  # a drive that tells nothing: a usual clock
        (0.05, 0.0, 0.5, 0.05, 0.08),
        (0.05, 9.0, -0.3, 0.3, 0.32),
    ],
)
def test_how_late_stamps_may_be(
    told_s: float, misfit: float, alone_s: float, least_s: float, most_s: float
) -> None:
    nothing = Constant(0.0, 5.0)
    found = DeclaredCorrection(
        *(nothing, nothing, Constant(0.1, told_s), nothing, misfit),
        *((0.0, 0.0, alone_s, 0.0), (0.0, 0.0, 0.0, 0.0)),
    )
    assert least_s <= found.unsure_late_s <= most_s
