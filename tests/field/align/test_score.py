"""Log-likelihoods of shifts, and what is read of them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from fieldgrid.core import Float64
from fieldgrid.field.align.score import PROBE_DEG, Scores, SubmapCorrelator, peak, turn_peak
from fieldgrid.field.align.submaps import SubmapImage
from fieldgrid.geometry import Lattice, Window

LATTICE = Lattice(0.1)


def picture(value: Float64, seen: Float64, i0: int = 0, j0: int = 0) -> SubmapImage:
    """A picture over a window that begins at a cell."""
    window = Window(i0, j0, value.shape[1], value.shape[0])
    mask = seen > 0.0
    shown = np.where(mask, 255.0 * np.clip(value, 0.0, 1.0), 0.0).astype(np.uint8)
    cells = int(mask.sum())
    return SubmapImage(LATTICE, window, shown, mask, np.zeros((1, 2)), np.array([0.0, 1.0]), cells)


def noise(seed: int, shape: tuple[int, int] = (60, 50), cells: float = 1.5) -> Float64:
    """Blotches of some cells, 0..1."""
    from scipy.ndimage import gaussian_filter

    found = gaussian_filter(np.random.default_rng(seed).normal(size=shape), cells)
    return np.asarray(found > 0.1 / cells, dtype=np.float64)


def direct(a: SubmapImage, b: SubmapImage, east: int, north: int) -> tuple[float, int]:
    """The correlation where both were seen with `b` lying so many cells off, cell by cell."""
    pairs = []
    for j in range(a.window.height):
        for i in range(a.window.width):
            y, x = a.window.j0 + j + north - b.window.j0, a.window.i0 + i + east - b.window.i0
            if (
                0 <= y < b.window.height
                and 0 <= x < b.window.width
                and a.seen[j, i]
                and b.seen[y, x]
            ):
                pairs.append((a.value[j, i], b.value[y, x]))
    return float(np.corrcoef(np.array(pairs).T)[0, 1]), len(pairs)


def test_it_is_the_likelihood_of_the_correlation_where_both_were_seen() -> None:
    random = np.random.default_rng(4)
    a = picture(noise(1), random.random((60, 50)) < 0.8, 7, -3)
    b = picture(0.3 * noise(1) + 0.5 * noise(2), random.random((60, 50)) < 0.7, 9, -4)
    found = SubmapCorrelator(a, 0.5).scores(b)
    assert found is not None
    for east, north in ((0, 0), (2, -1), (-4, 5), (3, 3)):
        rho, n = direct(a, b, east, north)
        at = found.reach + north, found.reach + east
        expected = -0.5 * np.log1p(-(max(rho, 0.0) ** 2))
        assert found.by_cell[at] == pytest.approx(expected, rel=1e-4, abs=1e-5)
        assert found.independent[at] == pytest.approx(n / found.alike, rel=1e-6)


@settings(max_examples=20)
@given(st.integers(-6, 6), st.integers(-6, 6), st.integers(0, 1000))
def test_a_shift_is_found_and_its_sign_is_that_of_b_against_a(
    east: int, north: int, seed: int
) -> None:
    whole = np.ones((60, 50))
    a = picture(noise(seed), whole)
    b = picture(noise(seed), whole, east, north)
    found = SubmapCorrelator(a, 1.0).scores(b)
    assert found is not None
    shift_m, information = peak(found, np.array([0.1 * east, 0.1 * north]))
    assert shift_m == pytest.approx([0.1 * east, 0.1 * north], abs=0.02)
    assert np.linalg.eigvalsh(information)[0] > 100.0


def test_along_an_even_row_nothing_is_told() -> None:
    random = np.random.default_rng(0)
    wall = np.zeros((120, 60))
    wall[:, 25:31] = 1.0
    a, b = (
        picture(wall + 0.2 * random.random(wall.shape), np.ones(wall.shape), i0=i0) for i0 in (0, 2)
    )
    found = SubmapCorrelator(a, 1.5).scores(b)
    assert found is not None
    shift_m, information = peak(found, np.zeros(2))
    assert shift_m[0] == pytest.approx(0.2, abs=0.02)
    assert information[0, 0] > 1000.0
    assert information[1, 1] < 10.0


def test_rows_that_repeat_have_two_peaks_and_a_place_between_them_is_unsure() -> None:
    rows = np.zeros((80, 80))
    rows[:, np.arange(80) % 20 < 4] = 1.0
    a = picture(rows + 0.3 * noise(1, rows.shape), np.ones(rows.shape))
    b = picture(rows + 0.3 * noise(2, rows.shape), np.ones(rows.shape))
    found = SubmapCorrelator(a, 2.5).scores(b)
    assert found is not None
    across = found.by_cell[found.reach]
    assert across[found.reach + 20] > 0.8 * across[found.reach]
    sure, unsure = (peak(found, np.array([at, 0.0]))[1][0, 0] for at in (0.0, 1.0))
    assert sure > 300.0
    assert unsure < 20.0


def test_what_shows_no_obstacle_is_not_compared() -> None:
    free = picture(np.zeros((40, 40)), np.ones((40, 40)))
    full = picture(noise(1, (40, 40)), np.ones((40, 40)))
    far = picture(noise(1, (40, 40)), np.ones((40, 40)), i0=500)
    assert SubmapCorrelator(free, 0.5).scores(full) is None
    assert SubmapCorrelator(full, 0.5).scores(far) is None


@pytest.mark.parametrize("turn_deg", [-0.4, 0.0, 0.3])
def test_a_turn_is_found(turn_deg: float) -> None:
    """Blotches, as they look when turned by an angle and by the probes."""
    from scipy.ndimage import rotate

    field, random = noise(3, (160, 160), 4.0), np.random.default_rng(8)

    def turned(by_deg: float, errors: Float64) -> SubmapImage:
        # Row 0 is the farthest south: what scipy calls counter-clockwise is clockwise here.
        turned = rotate(field + errors, by_deg, reshape=False, order=1)
        return picture(turned, np.ones(field.shape))

    errors = random.normal(0.0, 0.3, (2, *field.shape))
    b = [turned(turn_deg + probe, errors[0]) for probe in (-PROBE_DEG, 0.0, PROBE_DEG)]
    a = turned(0.0, errors[1])
    against = SubmapCorrelator(a, 1.5)
    base = against.scores(b[1])
    assert base is not None
    turn, information = turn_peak(against, b[0], base, b[2])
    assert turn == pytest.approx(-turn_deg, abs=0.1)
    assert information > 1.0


def test_scores_know_their_shifts() -> None:
    empty = np.zeros((5, 5))
    assert Scores(empty, empty, 1.0, 0.1).shifts_m == pytest.approx([-0.2, -0.1, 0.0, 0.1, 0.2])


def test_a_picture_is_compared_with_many_as_with_one() -> None:
    """Also with those that share only some rows and columns of it."""
    random = np.random.default_rng(5)
    a = picture(noise(1), random.random((60, 50)) < 0.8)
    others = [picture(noise(1), random.random((60, 50)) < 0.7, i0, j0) for i0, j0 in CORNERS]
    against = SubmapCorrelator(a, 0.5)
    for b in others:
        found, alone = against.scores(b), SubmapCorrelator(a, 0.5).scores(b)
        assert found is not None
        assert alone is not None
        assert np.array_equal(found.by_cell, alone.by_cell)
        rho, n = direct(a, b, 1, -2)
        at = found.reach - 2, found.reach + 1
        assert found.by_cell[at] == pytest.approx(-0.5 * np.log1p(-(max(rho, 0.0) ** 2)), abs=1e-5)
        assert found.independent[at] == pytest.approx(n / found.alike, rel=1e-6)


CORNERS = (0, 0), (14, 20), (-14, -20), (12, -9)


def test_cells_are_alike_as_far_as_the_residuals_are() -> None:
    """Summed shift by shift, at the shift that agrees best."""
    random = np.random.default_rng(7)
    a = picture(noise(1, cells=4.0), random.random((60, 50)) < 0.9)
    b = picture(0.7 * noise(1, cells=4.0) + 0.3 * noise(9, cells=4.0), np.ones((60, 50)), 3, 5)
    found = SubmapCorrelator(a, 1.0).scores(b)
    assert found is not None
    north, east = np.subtract(
        np.unravel_index((found.independent * found.by_cell).argmax(), found.by_cell.shape),
        found.reach,
    )
    # The values of b where a's window lies on it, and whether both were seen.
    j, i = north - 5, east - 3
    on, seen = np.zeros((60, 50)), np.zeros((60, 50), np.bool_)
    there = slice(max(j, 0), 60 + min(j, 0)), slice(max(i, 0), 50 + min(i, 0))
    here = slice(max(-j, 0), 60 + min(-j, 0)), slice(max(-i, 0), 50 + min(-i, 0))
    on[here], seen[here] = b.value[there], True
    seen &= a.seen
    slope, line = np.polyfit(on[seen], a.value[seen], 1)
    residual = np.where(seen, a.value - slope * on - line, 0.0)
    alike = 0.0
    for dj in range(-10, 11):
        for di in range(-10, 11):
            if np.hypot(dj, di) <= 10.0:
                cut = slice(max(dj, 0), 60 + min(dj, 0)), slice(max(di, 0), 50 + min(di, 0))
                away = slice(max(-dj, 0), 60 + min(-dj, 0)), slice(max(-di, 0), 50 + min(-di, 0))
                count = max(np.count_nonzero(seen[cut] & seen[away]), 1)
                alike += (residual[cut] * residual[away]).sum() / count
    expected = alike / ((residual**2).sum() / seen.sum())
    assert found.alike > 20.0
    assert found.alike == pytest.approx(expected, rel=1e-3)
