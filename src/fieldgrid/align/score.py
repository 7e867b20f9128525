"""How well two pictures of the same ground agree when one is shifted, as a log-likelihood.

For each shift the values of one picture are explained by those of the other, where both were seen,
by a straight line with Gaussian residuals: with correlation rho over n independent cells the
log-likelihood, maximised over line and variance, is -n/2 log(1 - rho²) (the profile likelihood of
linear regression). Neighbouring residuals are alike, so the cells that count are those that were
seen divided by the area over which residuals correlate. Shifts are compared by what a cell says,
as if the same number of cells spoke for each: that more ground coincides is no evidence. A shift
along an even row then changes nothing, one by a row spacing gives a second peak, and both come out
as what they are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import fft, ndimage

from fieldgrid.align.submaps import Picture
from fieldgrid.array_types import Float32, Float64
from fieldgrid.lattice import Window

LEAST_SHARE = 0.25
"""Shifts at which less than this share of the smaller picture lies on the other are not told."""

CORRELATED_M = 1.0
"""Residuals are taken to correlate no farther than this."""

LEAST_AREA_M2 = 0.2
"""And over no smaller an area: cells of one plant are no independent witnesses."""

LEAST_OBSTACLE_M2 = 0.4
"""Pictures with less obstacle on either side have nothing to compare."""


class Scores(NamedTuple):
    """Log-likelihoods a cell [2 reach + 1, 2 reach + 1] of shifts of `b` against `a`, row 0 the
    farthest south: at [j, i] `b` is taken to lie (i - reach, j - reach) cells east and north of
    its place. `independent` is the number of independent cells that each rests on, 0 where there
    is none; residuals are alike over `alike` cells."""

    by_cell: Float64
    independent: Float64
    alike: float
    cell_m: float

    @property
    def reach(self) -> int:
        """The largest shift, in cells."""
        return len(self.by_cell) // 2

    def within(self, reach_m: float) -> Scores:
        """Those of shifts up to some metres along either axis."""
        off = max(self.reach - round(reach_m / self.cell_m), 0)
        inner = (slice(off, len(self.by_cell) - off),) * 2
        return self._replace(by_cell=self.by_cell[inner], independent=self.independent[inner])

    @property
    def shifts_m(self) -> Float64:
        """The shifts along either axis, metres."""
        return self.cell_m * np.arange(-self.reach, self.reach + 1, dtype=np.float64)


class Against:
    """A picture with which others of its lattice are compared, up to a shift."""

    def __init__(self, a: Picture, reach_m: float) -> None:
        self.a = a
        self._reach = round(reach_m / a.lattice.cell_m)
        self._window = a.window.grown(self._reach)
        self._shape = tuple(fft.next_fast_len(n, real=True) for n in self._window.shape)
        value = a.value / np.float32(255.0)
        parts = a.seen.astype(np.float32), value, value**2
        self._spectra = [np.conj(fft.rfft2(part, self._shape)) for part in parts]

    def scores(self, b: Picture, alike: float | None = None) -> Scores | None:
        """Those of another picture; None where the two share no obstacle to speak of.

        `alike` is told of the residuals when it is not given.
        """
        a, cell_m = self.a, self.a.lattice.cell_m
        if min(_obstacle_m2(a), _obstacle_m2(b)) < LEAST_OBSTACLE_M2:
            return None
        value_b, seen_b = _on(b, self._window)
        if float(seen_b.sum()) < LEAST_SHARE * min(a.cells, b.cells):
            return None
        spectra = [fft.rfft2(part, self._shape) for part in (seen_b, value_b, value_b**2)]

        def lagged(i: int, j: int) -> Float64:
            side = 2 * self._reach + 1
            found = fft.irfft2(self._spectra[i] * spectra[j], self._shape)[:side, :side]
            return np.asarray(found, dtype=np.float64)

        n, sum_a, sum_b = np.maximum(lagged(0, 0), 1.0), lagged(1, 0), lagged(0, 1)
        spread_a = lagged(2, 0) - sum_a**2 / n
        spread_b = lagged(0, 2) - sum_b**2 / n
        least = 1e-3 * n  # a picture that is the same everywhere correlates with nothing
        covariance = lagged(1, 1) - sum_a * sum_b / n
        told = n > LEAST_SHARE * min(a.cells, b.cells)
        told &= (spread_a > least) & (spread_b > least)
        rho = np.where(told, covariance / np.sqrt(np.maximum(spread_a * spread_b, 1e-12)), 0.0)
        rho = np.clip(rho, 0.0, 0.999)
        by_cell = -0.5 * np.log1p(-(rho**2))
        if not rho.any():
            return None
        if alike is None:
            best = np.unravel_index(int((n * by_cell).argmax()), n.shape)
            alike = _correlated_cells(a, value_b, seen_b, int(best[0]), int(best[1]))
        return Scores(by_cell, np.where(told, n, 0.0) / alike, alike, cell_m)


def _obstacle_m2(picture: Picture) -> float:
    """How much ground with full obstacles would have as much of them."""
    return float(picture.value.sum()) / 255.0 * picture.lattice.cell_m**2


def _on(picture: Picture, window: Window) -> tuple[Float32, Float32]:
    """The values, 0..1, and the seen cells of a picture on another window, 0 outside."""
    value, seen = (np.zeros(window.shape, np.float32) for _ in range(2))
    part = picture.window.intersect(window)
    if part is not None:
        value[window.slices_of(part)] = picture.value[picture.window.slices_of(part)]
        value /= np.float32(255.0)
        seen[window.slices_of(part)] = picture.seen[picture.window.slices_of(part)]
    return value, seen


def _correlated_cells(a: Picture, value_b: Float32, seen_b: Float32, j: int, i: int) -> float:
    """Over how many cells the residuals are alike, at one shift."""
    height, width = a.window.shape
    there = (slice(j, j + height), slice(i, i + width))
    both = a.seen & (seen_b[there] > 0.0)
    n = float(both.sum())
    value_a = a.value / 255.0
    y = np.where(both, value_a - value_a[both].mean(), 0.0)
    x = np.where(both, value_b[there] - value_b[there][both].mean(), 0.0)
    residual = y - x * float((x * y).sum() / (x * x).sum())
    lag = round(CORRELATED_M / a.lattice.cell_m)
    shape = tuple(fft.next_fast_len(side + lag, real=True) for side in residual.shape)

    def autocorrelated(values: Float64) -> Float64:
        found = fft.irfft2(np.abs(fft.rfft2(values, shape)) ** 2, shape)
        return np.asarray(np.roll(found, (lag, lag), (0, 1))[: 2 * lag + 1, : 2 * lag + 1])

    products, counts = autocorrelated(residual), autocorrelated(both.astype(np.float64))
    alike = products / np.maximum(counts, 1.0) / max(float((residual**2).sum()) / n, 1e-12)
    north, east = np.mgrid[-lag : lag + 1, -lag : lag + 1]
    inside = np.hypot(north, east) <= lag
    return max(float(alike[inside].sum()), LEAST_AREA_M2 / a.lattice.cell_m**2, 1.0)


class Peak(NamedTuple):
    """What scores near a place say of the shift: information (inverse covariance, 1/m²) [2, 2]
    and the shift east and north that it is about."""

    shift_m: Float64
    information: Float64


NEAR_M = 0.4
"""Scores are read as a Gaussian within about this of a place."""

FINER = 4


def peak(found: Scores, near_m: Float64) -> Peak:
    """The scores around a place as one Gaussian; what they do not tell has no information.

    They are weighted with a Gaussian of `NEAR_M` about the place, whose own information is taken
    off again: so a flat ridge stays flat, and two peaks make one wide one.
    """
    axis = found.shifts_m
    # Three sigmas of the weight, read every quarter of a cell.
    at = np.arange(-3.0 * NEAR_M, 3.0 * NEAR_M, found.cell_m / FINER)
    east, north = near_m[0] + at, near_m[1] + at
    index = np.meshgrid(
        (north - axis[0]) / found.cell_m, (east - axis[0]) / found.cell_m, indexing="ij"
    )
    j, i = (round((float(at_m) - axis[0]) / found.cell_m) for at_m in (near_m[1], near_m[0]))
    cells = found.independent[np.clip(j, 0, len(axis) - 1), np.clip(i, 0, len(axis) - 1)]
    fine = cells * ndimage.map_coordinates(found.by_cell, index, order=3, mode="nearest")
    fine = fine - 0.5 * (at[:, None] ** 2 + at[None, :] ** 2) / NEAR_M**2
    weight = np.exp(fine - fine.max())
    weight /= weight.sum()
    mean = np.array([(weight.sum(axis=0) * at).sum(), (weight.sum(axis=1) * at).sum()])
    dx, dy = at[None, :] - mean[0], at[:, None] - mean[1]
    cross = float((weight * dx * dy).sum())
    covariance = (
        np.array([[(weight * dx * dx).sum(), cross], [cross, (weight * dy * dy).sum()]])
        + np.eye(2) * (found.cell_m / FINER) ** 2
    )
    inverse = np.linalg.inv(covariance)
    values, axes = np.linalg.eigh(inverse - np.eye(2) / NEAR_M**2)
    values = np.maximum(values, 0.0)
    information = (axes * values) @ axes.T
    # Where nothing is told, the shift is of no weight.
    shift = np.linalg.pinv(information, rcond=1e-6, hermitian=True) @ inverse @ mean
    return Peak(near_m + shift, information)


PROBE_DEG = 0.8
"""Pictures are turned by this either way to see which turn fits."""

PROBE_REACH_M = 0.6


def _top(found: Scores) -> float:
    """The highest score a cell, between the shifts too."""
    j, i = np.unravel_index(int(found.by_cell.argmax()), found.by_cell.shape)
    around = np.linspace(-1.0, 1.0, 2 * FINER + 1)
    index = np.meshgrid(j + around, i + around, indexing="ij")
    return float(ndimage.map_coordinates(found.by_cell, index, order=3, mode="nearest").max())


class TurnPeak(NamedTuple):
    """By how much `b` is to be turned clockwise to agree best with `a`, degrees, and the
    information (1/degrees²), 0 where nothing is told."""

    turn_deg: float
    information: float


def turn_peak(a: Against, less: Picture, straight: Scores, more: Picture) -> TurnPeak:
    """The turn of a picture with the scores `straight`, from these and from pictures of it that are
    turned by -PROBE_DEG and +PROBE_DEG: the top of the parabola through the best score of each."""
    probes = a.scores(less, straight.alike), straight, a.scores(more, straight.alike)
    tops = []
    for found in probes:
        near = None if found is None else found.within(PROBE_REACH_M)
        if near is None or not near.by_cell.any():
            return TurnPeak(0.0, 0.0)
        tops.append(_top(near))
    cells = float(straight.independent[straight.reach, straight.reach])
    tops = [cells * top for top in tops]
    curvature = (tops[0] - 2.0 * tops[1] + tops[2]) / PROBE_DEG**2
    if curvature >= 0.0:
        return TurnPeak(0.0, 0.0)
    turn = (tops[0] - tops[2]) / (2.0 * PROBE_DEG * curvature)
    # Beyond the probes a parabola is a guess.
    return TurnPeak(float(np.clip(turn, -2.0 * PROBE_DEG, 2.0 * PROBE_DEG)), -curvature)
