"""How well two drives agree, shift by shift."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from fieldgrid.export.figures.page import new_figure
from fieldgrid.field import MapAlignment

_MOST = 12
"""Pairs of drives that find room on a page, those in doubt first."""

_DOWN = 20.0
"""How far below the best log-posteriors are drawn."""


def alignment_scores(found: MapAlignment) -> Figure:
    """The score of every shift of one drive against another, a panel for each pair of drives, with
    the best shift (a cross) and others that are not ruled out (rings)."""
    pairs = sorted(found.pairs, key=lambda pair: pair.doubt is None)[:_MOST]
    columns = max(min(len(pairs), 4), 1)
    rows = -(-max(len(pairs), 1) // columns)
    figure = new_figure((1.0 + 4.2 * columns, 0.6 + 4.2 * rows))
    grid = figure.add_gridspec(rows, columns)
    panels = []
    for n, pair in enumerate(pairs):
        axes = figure.add_subplot(grid[n // columns, n % columns])
        one = pair.agreement
        half = float(one.shifts_m[1] - one.shifts_m[0]) / 2.0
        low, high = float(one.shifts_m[0]) - half, float(one.shifts_m[-1]) + half
        image = axes.imshow(
            np.maximum(one.score, -_DOWN), origin="lower", extent=(low, high, low, high),
            cmap="cividis", vmin=-_DOWN, vmax=0.0,
        )  # fmt: skip
        axes.plot(*one.shift_m, "x", color="white", markersize=9, markeredgewidth=2)
        for rival in one.rivals_m:
            axes.plot(*rival, "o", color="white", markersize=11, fillstyle="none")
        axes.axhline(0.0, color="white", linewidth=0.4)
        axes.axvline(0.0, color="white", linewidth=0.4)
        verdict = "agree" if pair.doubt is None else "in doubt"
        axes.set_title(f"{pair.b}\nagainst {pair.a}: {verdict}", fontsize="medium")
        axes.set(xlabel="shift east (m)", ylabel="shift north (m)")
        panels.append(axes)
    if panels:
        figure.colorbar(image, ax=panels, shrink=0.8, label="log-posterior less its best")
    return figure
