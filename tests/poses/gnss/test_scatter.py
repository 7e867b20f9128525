"""How fine positions are written, and how much they scatter from fix to fix."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
import pytest

from fieldgrid.poses.gates.scatter import fix_noise, quantum_m, short_term_sigma_m
from tests.poses.gnss.sentences import NOON, SECOND

Float64 = npt.NDArray[np.float64]

M_PER_DEG = 111_195.0


def lane_and_turns(n: int, period_s: float, speed_mps: float = 1.5) -> tuple[Float64, Float64]:
    """Rows of 40 m joined by half-turns of 4 m radius, left and right in turn."""
    row_m, turn_m = 40.0, math.pi * 4.0
    distance_m = np.arange(n) * period_s * speed_mps
    lap, in_lap = np.divmod(distance_m, row_m + turn_m)
    turned = np.clip((in_lap - row_m) / 4.0, 0.0, np.pi)
    heading = np.where(lap % 2 == 0, turned, np.pi - turned)
    step_m = period_s * speed_mps
    return np.cumsum(np.sin(heading)) * step_m, np.cumsum(np.cos(heading)) * step_m


def smooth_bias(n: int, period_s: float, rng: np.random.Generator) -> Float64:
    """0.75 m that wander over minutes, as smoothly as a receiver's filter makes them."""
    t = np.arange(n) * period_s
    periods_s, phases = rng.uniform(60.0, 600.0, 6), rng.uniform(0.0, 2 * np.pi, 6)
    return np.sum(
        [0.43 * np.sin(2 * np.pi * t / p + a) for p, a in zip(periods_s, phases, strict=True)],
        axis=0,
    )


def times(n: int, period_s: float) -> npt.NDArray[np.int64]:
    return NOON + np.round(np.arange(n) * period_s * SECOND).astype(np.int64)


@pytest.mark.parametrize(
    ("rate_hz", "sigma_m", "written_m"),
    [
        (1.0, 0.1, 0.0),
        (1.0, 0.3, 0.185),
        (5.0, 0.01, 0.0),
        (5.0, 0.03, 0.0),
        (5.0, 0.03, 0.185),
        (5.0, 0.002, 0.185),
        (10.0, 0.01, 0.0185),
        (10.0, 0.3, 0.0),
        (20.0, 0.01, 0.0),
    ],
)
def test_white_noise_is_found_beside_bias_motion_and_rounding(
    rate_hz: float, sigma_m: float, written_m: float
) -> None:
    rng, n, period_s = np.random.default_rng(11), 1500, 1.0 / rate_hz
    axes = []
    for axis in lane_and_turns(n, period_s):
        noisy = axis + smooth_bias(n, period_s, rng) + rng.normal(0.0, sigma_m, n)
        axes.append(np.round(noisy / written_m) * written_m if written_m else noisy)
    found = short_term_sigma_m(axes[0], axes[1], times(n, period_s), written_m)
    true = math.hypot(sigma_m, written_m / math.sqrt(12.0))
    assert found == pytest.approx(true, rel=0.3)


def test_outliers_gaps_and_uneven_steps_do_not_change_it() -> None:
    rng = np.random.default_rng(5)
    east_m, north_m = (a + rng.normal(0.0, 0.03, 1500) for a in lane_and_turns(1500, 0.2))
    time_ns = times(1500, 0.2)
    east_m[::40] += 8.0
    kept = rng.random(1500) > 0.1
    kept[700:760] = False
    found = short_term_sigma_m(east_m[kept], north_m[kept], time_ns[kept], 0.0)
    assert found == pytest.approx(0.03, rel=0.3)


def test_it_is_the_same_far_from_the_origin() -> None:
    rng = np.random.default_rng(5)
    east_m, north_m = (a + rng.normal(0.0, 0.01, 400) for a in lane_and_turns(400, 0.1))
    here = short_term_sigma_m(east_m, north_m, times(400, 0.1), 0.0)
    far = short_term_sigma_m(east_m + 3e6, north_m - 4e6, times(400, 0.1), 0.0)
    assert far == pytest.approx(here, rel=1e-3)


def test_rounding_is_the_least_that_it_can_be() -> None:
    still = np.zeros(200)
    assert short_term_sigma_m(still, still, times(200, 0.1), 0.12) == pytest.approx(
        0.0346, abs=1e-4
    )
    assert short_term_sigma_m(still, still, times(200, 0.1), 0.0) == 0.001


@pytest.mark.parametrize("n", [0, 1, 2, 5, 10])
def test_of_too_few_nothing_is_said(n: int) -> None:
    rng = np.random.default_rng(5)
    assert short_term_sigma_m(rng.normal(size=n), rng.normal(size=n), times(n, 0.2), 0.0) == 0.001


def test_equal_times_are_no_steps() -> None:
    assert short_term_sigma_m(np.arange(30.0), np.zeros(30), np.full(30, NOON), 0.0) == 0.001


@pytest.mark.parametrize(
    ("spacing_deg", "decimals", "north_m"),
    [
        (1e-4 / 60.0, None, 0.1853),  # ddmm.mmmm
        (1e-5 / 60.0, None, 0.01853),
        (1e-7 / 60.0, None, 0.0001853),
        (1e-5 / 60.0, 9, 0.01853),  # minutes once, degrees with nine decimals since
        (1e-6, None, 0.1112),
        (1e-7, None, 0.01112),  # ISO 11783 and UBX
        (2.0**-18, None, 0.4242),  # single precision, once
        (1e-12, None, 0.0),
    ],
)
def test_the_spacing_of_written_positions(
    spacing_deg: float, decimals: int | None, north_m: float
) -> None:
    rng = np.random.default_rng(2)
    lat_deg = np.round((39.5 + rng.uniform(0.0, 2e-3, 300)) / spacing_deg) * spacing_deg
    lon_deg = np.round((-1.1 + rng.uniform(0.0, 2e-3, 300)) / spacing_deg) * spacing_deg
    if decimals is not None:
        lat_deg, lon_deg = np.round(lat_deg, decimals), np.round(lon_deg, decimals)
    assert quantum_m(lat_deg, lon_deg) == pytest.approx(north_m, rel=1e-3)


def test_the_coarser_axis_counts_and_longitude_shrinks() -> None:
    fine = 39.5 + np.random.default_rng(2).uniform(0.0, 2e-3, 300)
    lon_deg = np.round(-1.1 + (fine - 39.5), 6)
    expected = 1e-6 * M_PER_DEG * math.cos(math.radians(float(np.median(fine))))
    assert quantum_m(fine, lon_deg) == pytest.approx(expected, rel=1e-6)


def test_a_few_odd_positions_do_not_hide_the_spacing() -> None:
    rng = np.random.default_rng(2)
    lat_deg = np.round(39.5 + rng.uniform(0.0, 2e-3, 300), 6)
    lon_deg = np.round(-1.1 + rng.uniform(0.0, 2e-3, 300), 6)
    lat_deg[:20] += 3.3e-7
    lat_deg[20], lon_deg[21] = np.nan, np.inf
    assert quantum_m(lat_deg, lon_deg) == pytest.approx(0.1112, rel=1e-3)


@pytest.mark.parametrize("decimals", [8, 9, 12])
def test_a_drive_along_a_round_meridian_is_not_written_coarsely(decimals: int) -> None:
    """Within a metre of it every longitude lies near one point of the lattice of 0.001 degrees."""
    k = np.arange(300)
    lat_deg = np.round(41.65 + k * 2.7e-6, decimals)
    lon_deg = np.round(-4.72 + 1e-5 * np.sin(k / 30.0), decimals)
    assert quantum_m(lat_deg, lon_deg) < 0.02


def test_a_vehicle_that_stands_does_not_show_it() -> None:
    assert quantum_m(np.full(100, 39.5), np.full(100, -1.1)) == 0.0
    assert quantum_m([], []) == 0.0


# --- along the path and across it


def weaving(n: int, period_s: float, speed_mps: float = 1.5) -> tuple[Float64, Float64, Float64]:
    """East and north of rows with turns, and the direction of travel."""
    east, north = lane_and_turns(n, period_s, speed_mps)
    return east, north, np.arctan2(np.gradient(east), np.gradient(north))


@pytest.mark.parametrize("rate_hz", [1.0, 5.0, 10.0])
@pytest.mark.parametrize(("noise_m", "late_s"), [(0.02, 0.0), (0.02, 0.1), (0.05, 0.2)])
def test_late_stamps_count_along_the_path_and_not_across(
    rate_hz: float, noise_m: float, late_s: float
) -> None:
    n, rng = 1500, np.random.default_rng(4)
    east, north, course = weaving(n, 1.0 / rate_hz)
    along = rng.normal(0.0, late_s, n) * 1.5
    noise = rng.normal(0.0, noise_m, (2, n))
    found = fix_noise(
        east + along * np.sin(course) + noise[0],
        north + along * np.cos(course) + noise[1],
        times(n, 1.0 / rate_hz),
        np.full(n, 1.5),
        np.zeros(n, np.int64),
        0.0,
    )
    assert found.across_m == pytest.approx(noise_m, rel=0.35)
    assert found.late_s == pytest.approx(late_s, rel=0.3, abs=0.02)
    # Over a second, the motion has a part in it.
    assert (found.second_m >= found.across_m).all()
    assert found.second_m.max() < 4.0 * noise_m


def test_noise_is_at_most_what_is_stated_and_measured_for_each_quality_apart() -> None:
    n, rng = 1200, np.random.default_rng(4)
    east, north, _ = weaving(n, 0.2)
    quality = np.where(np.arange(n) < n // 2, 4, 5)
    white = np.where(quality == 4, 0.01, 0.2)
    noise = rng.normal(0.0, 1.0, (2, n)) * white
    stated = np.where(quality == 4, 0.02, 0.1)
    place = (east + noise[0], north + noise[1], times(n, 0.2))
    found = fix_noise(*place, stated, quality, 0.0)
    assert found.across_m[quality == 4] == pytest.approx(0.01, rel=0.3)
    assert (found.across_m[quality == 5] == 0.1).all()


def test_of_few_fixes_a_share_of_the_stated_error_is_taken() -> None:
    few = fix_noise(np.zeros(3), np.arange(3.0), times(3, 1.0), np.full(3, 0.4), np.zeros(3), 0.0)
    assert few.across_m == pytest.approx(0.02)
    assert np.isinf(few.second_m).all()
    assert few.late_s == 0.0
    none = fix_noise(np.zeros(0), np.zeros(0), times(0, 1.0), np.zeros(0), np.zeros(0), 0.0)
    assert len(none.across_m) == 0


@pytest.mark.parametrize("seed", range(6))
def test_of_few_fixes_the_noise_is_what_it_hardly_exceeds(seed: int) -> None:
    """Four pieces of five fixes with holes between, of a receiver that states metres."""
    rng, time_s = np.random.default_rng(seed), np.arange(40.0)
    seen = time_s % 10.0 < 5.0
    east_m, north_m = rng.normal(0.0, 0.3, (2, 40)) + np.stack([time_s, 1.5 * time_s])
    n = int(seen.sum())
    found = fix_noise(
        *(east_m[seen], north_m[seen], times(40, 1.0)[seen], np.full(n, 1.5)),
        *(np.full(n, 4), 0.0),
    )
    assert 0.15 < found.across_m[0] < 0.9
