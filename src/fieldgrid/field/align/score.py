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

from fieldgrid.core import Complex64, Float32, Float64
from fieldgrid.field.align.submaps import SubmapImage
from fieldgrid.geometry import Window

LEAST_SHARE = 0.25
"""Shifts at which less than this share of the smaller picture lies on the other are not told."""

CORRELATED_M = 1.0
"""Residuals are taken to correlate no farther than this."""

LEAST_AREA_M2 = 0.2
"""And over no smaller an area: cells of one plant are no independent witnesses."""

LEAST_OBSTACLE_M2 = 0.4
"""Pictures with less obstacle on either side have nothing to compare."""


PRODUCTS = (0, 0), (1, 0), (0, 1), (2, 0), (0, 2), (1, 1)
"""Powers of the values of `a` and `b` whose products are summed."""


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


class SubmapCorrelator:
    """A picture with which others of its lattice are compared, up to a shift."""

    def __init__(self, a: SubmapImage, reach_m: float) -> None:
        self.a = a
        self._reach = round(reach_m / a.lattice.cell_m)
        self._window = a.window.grown(self._reach)
        height, width = self._window.shape
        self._shape = fft.next_fast_len(height), fft.next_fast_len(width, real=True)
        value = np.divide(a.value, 255.0, dtype=np.float32)
        self._spectra = np.conj(self._spectra_of(a.seen.astype(np.float32), value, 0))

    def scores(self, b: SubmapImage, alike: float | None = None) -> Scores | None:
        """Those of another picture; None where the two share no obstacle to speak of.

        `alike` is told of the residuals when it is not given.
        """
        a, cell_m = self.a, self.a.lattice.cell_m
        part = b.window.intersect(self._window)
        if part is None or min(_obstacle_m2(a), _obstacle_m2(b)) < LEAST_OBSTACLE_M2:
            return None
        # Of that part, over all columns of the window; 0 outside.
        value_b, seen_b = np.zeros((2, part.height, self._window.width), np.float32)
        there, here = self._window.slices_of(part)[1], b.window.slices_of(part)
        value_b[:, there] = b.value[here]
        value_b /= np.float32(255.0)
        seen_b[:, there] = b.seen[here]
        least_cells = LEAST_SHARE * min(a.cells, b.cells)
        if float(seen_b.sum()) < least_cells:
            return None
        spectra = self._spectra_of(seen_b, value_b, part.j0 - self._window.j0)
        n, sum_a, sum_b, squares_a, squares_b, products = self._lagged(spectra)
        n = np.maximum(np.rint(n), 1.0)
        spread_a = squares_a - sum_a**2 / n
        spread_b = squares_b - sum_b**2 / n
        least = 1e-3 * n  # a picture that is the same everywhere correlates with nothing
        told = (n > least_cells) & (spread_a > least) & (spread_b > least)
        covariance = products - sum_a * sum_b / n
        rho = np.where(told, covariance / np.sqrt(np.maximum(spread_a * spread_b, 1e-12)), 0.0)
        rho = np.clip(rho, 0.0, 0.999)
        by_cell = -0.5 * np.log1p(-(rho**2))
        if not rho.any():
            return None
        if alike is None:
            j, i = np.unravel_index(int((n * by_cell).argmax()), n.shape)
            at = Window(self._window.i0 + int(i), self._window.j0 + int(j), *a.window[2:])
            alike = _correlated_cells(a, b, at)
        return Scores(by_cell, np.where(told, n, 0.0) / alike, alike, cell_m)

    def _spectra_of(self, seen: Float32, value: Float32, first: int) -> Complex64:
        """Of what was seen, of values and of their squares [3, h, w], from row `first` on."""
        height, width = self._shape
        rows = slice(first, first + len(seen))
        spectra = np.zeros((3, height, width // 2 + 1), np.complex64)
        # Rows that were not seen need no transform.
        spectra[:, rows] = fft.rfft(np.stack([seen, value, value**2]), width, axis=2)
        return np.asarray(fft.fft(spectra, axis=1, overwrite_x=True))

    def _lagged(self, spectra: Complex64) -> Float64:
        """The sums of `PRODUCTS` over the cells that both saw, for each shift [6, 2 reach + 1,
        2 reach + 1]."""
        side = 2 * self._reach + 1
        product = np.empty((6, *spectra.shape[1:]), np.complex64)
        for of, (one, other) in zip(product, PRODUCTS, strict=True):
            np.multiply(self._spectra[one], spectra[other], out=of)
        # Of all rows only the shifts within reach are wanted; the others need no transform.
        rows = fft.ifft(product, axis=1, overwrite_x=True)[:, :side]
        return np.asarray(fft.irfft(rows, self._shape[1], axis=2)[:, :, :side], dtype=np.float64)


def _obstacle_m2(picture: SubmapImage) -> float:
    """How much ground with full obstacles would have as much of them."""
    return float(picture.value.sum()) / 255.0 * picture.lattice.cell_m**2


def _correlated_cells(a: SubmapImage, b: SubmapImage, at: Window) -> float:
    """Over how many cells the residuals are alike where what `at` holds of `b` is laid on `a`."""
    part = at.intersect(b.window)
    assert part is not None  # they were compared
    of_a, of_b = at.slices_of(part), b.window.slices_of(part)
    both = a.seen[of_a] & b.seen[of_b]
    n = float(np.count_nonzero(both))
    value_a, value_b = a.value[of_a] / 255.0, b.value[of_b] / 255.0
    y = np.where(both, value_a - value_a[both].mean(), 0.0)
    x = np.where(both, value_b - value_b[both].mean(), 0.0)
    residual = y - x * float((x * y).sum() / (x * x).sum())
    lag = round(CORRELATED_M / a.lattice.cell_m)
    products, counts = _autocorrelated(np.stack([residual, both]), lag)
    alike = products / np.maximum(counts, 1.0) / max(float((residual**2).sum()) / n, 1e-12)
    north, east = np.mgrid[: lag + 1, -lag : lag + 1]
    # What lies to the south is alike what lies to the north.
    times = np.where(north > 0, 2.0, 1.0) * (np.hypot(north, east) <= lag)
    return max(float((alike * times).sum()), LEAST_AREA_M2 / a.lattice.cell_m**2, 1.0)


def _autocorrelated(values: Float64, lag: int) -> Float64:
    """The sums of products of arrays [n, h, w] with themselves shifted by 0 to `lag` rows and -lag
    to `lag` columns [n, lag + 1, 2 lag + 1]."""
    height, width = (fft.next_fast_len(side + lag, real=True) for side in values.shape[1:])
    spectra = fft.fft(fft.rfft(values, width, axis=2), height, axis=1, overwrite_x=True)
    rows = fft.ifft(spectra.real**2 + spectra.imag**2, axis=1)[:, : lag + 1]
    found = fft.irfft(rows, width, axis=2)
    return np.asarray(np.concatenate([found[..., -lag:], found[..., : lag + 1]], axis=2))


NEAR_M = 0.4
"""Scores are read as a Gaussian within about this of a place."""

FINER = 4


def peak(found: Scores, near_m: Float64) -> tuple[Float64, Float64]:
    """The scores around a place as one Gaussian: the shift [2] east and north that it is about, and
    its information (inverse covariance, 1/m²) [2, 2], zero along what the scores do not tell.

    They are weighted with a Gaussian of `NEAR_M` about the place, whose own information is taken
    off again: so a flat ridge stays flat, and two peaks make one wide one.
    """
    axis = found.shifts_m
    # Three sigmas of the weight, read every quarter of a cell.
    at = np.arange(-3.0 * NEAR_M, 3.0 * NEAR_M, found.cell_m / FINER)
    east, north = ((near + at - axis[0]) / found.cell_m for near in near_m)
    places = np.meshgrid(north, east, indexing="ij")
    j, i = (round((float(at_m) - axis[0]) / found.cell_m) for at_m in (near_m[1], near_m[0]))
    cells = found.independent[np.clip(j, 0, len(axis) - 1), np.clip(i, 0, len(axis) - 1)]
    fine = cells * ndimage.map_coordinates(found.by_cell, places, mode="nearest")
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
    return near_m + shift, information


PROBE_DEG = 0.8
"""Pictures are turned by this either way to see which turn fits."""

PROBE_REACH_M = 0.6


def turn_peak(
    a: SubmapCorrelator, less: SubmapImage, straight: Scores, more: SubmapImage
) -> tuple[float, float]:
    """The turn of a picture with the scores `straight`, degrees clockwise, that agrees best with
    `a`, and its information (1/degrees²), 0 where nothing is told. From these scores and from
    pictures of it that are turned by -PROBE_DEG and +PROBE_DEG: the top of the parabola through the
    best score of each."""
    tops = []
    for found in (a.scores(less, straight.alike), straight, a.scores(more, straight.alike)):
        near = None if found is None else found.within(PROBE_REACH_M)
        if near is None or not near.by_cell.any():
            return 0.0, 0.0
        j, i = np.unravel_index(int(near.by_cell.argmax()), near.by_cell.shape)
        around = np.linspace(-1.0, 1.0, 2 * FINER + 1)
        places = np.meshgrid(j + around, i + around, indexing="ij")
        tops.append(float(ndimage.map_coordinates(near.by_cell, places, mode="nearest").max()))
    cells = float(straight.independent[straight.reach, straight.reach])
    tops = [cells * top for top in tops]
    curvature = (tops[0] - 2.0 * tops[1] + tops[2]) / PROBE_DEG**2
    if curvature >= 0.0:
        return 0.0, 0.0
    turn = (tops[0] - tops[2]) / (2.0 * PROBE_DEG * curvature)
    # Beyond the probes a parabola is a guess.
    return float(np.clip(turn, -2.0 * PROBE_DEG, 2.0 * PROBE_DEG)), -curvature
