"""A trajectory as it was judged: gears, verdicts, speed and sigma."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from fieldgrid.core import Bool, Float64, Int64, palette
from fieldgrid.export.figures.page import new_figure
from fieldgrid.geometry import MAX_GAP_NS, Trajectory, thinned

_GEAR_STYLES = (
    (1, "forward", 1.1, "", 0.0),
    (-1, "reverse", 2.8, "", 0.0),
    (0, "at rest", 0.0, "s", 3.5),
)
"""How gears are drawn: gear, name, width of the line, marker and its size. Hue, lightness and width
tell them apart, for any eye or print."""


_NOSE = "0.25"


MOST_POINTS = 12_000
"""A longer track is thinned for drawing: more points than this no page can show."""


_TICK_SHARE, _TICK_STEP, _MOST_TICKS = 0.025, 0.08, 150
"""Headings shown along a track: their length and distance as shares of its extent."""


_MARKS, _DENSE_NS = 800, 250_000_000
"""Most rejected poses that are marked, and the time between accepted ones, ns, up to which none is
marked between them: every other fix of some receivers repeats the one before."""


def track_figure(
    track: Trajectory, *, title: str = "", max_sigma_deg: float | None = None
) -> Figure:
    """A trajectory by gear and verdict beside heading, speed and heading sigma (Figs. 7, 10, 12).

    `max_sigma_deg` is the sigma beyond which a heading is rejected, drawn as a line.
    """
    figure = new_figure((14.0, 7.6))
    columns = figure.add_gridspec(1, 2, width_ratios=(1.0, 1.15))
    rows = columns[1].subgridspec(3, 1, height_ratios=(1.7, 1.0, 1.0))
    place = figure.add_subplot(columns[0])
    drawn = _track_columns(track)
    _draw_way(place, drawn)
    nose = figure.add_subplot(rows[0])
    _draw_nose(nose, drawn)
    speed = figure.add_subplot(rows[1], sharex=nose)
    speed.axhline(0.0, color="0.6", linewidth=0.6)
    _draw_by_gear(speed, drawn, drawn.time, drawn.speed_mps)
    speed.set_ylabel("speed (m/s)")
    speed.grid(linewidth=0.3)
    sigma = figure.add_subplot(rows[2], sharex=nose)
    _draw_sigma(sigma, drawn, max_sigma_deg)
    for axes in (nose, speed):
        axes.tick_params(labelbottom=False)
    sigma.set_xlabel(drawn.time_label)
    figure.suptitle(f"{title}: heading {track.heading_source}" if title else "")
    handles, labels = place.get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower center", ncols=6, frameon=False)
    return figure


class _TrackColumns(NamedTuple):
    """The rows of a track that are drawn, in columns; a row of NaN breaks lines at a hole.

    `refused` marks the rejected poses to be shown as such, `accepted` the others.
    """

    time: Float64
    time_label: str
    east_m: Float64
    north_m: Float64
    heading_deg: Float64
    sigma_deg: Float64
    speed_mps: Float64
    gear: Float64
    accepted: Bool
    refused: Bool


def _track_columns(track: Trajectory) -> _TrackColumns:
    # Rows without a heading have no pose to draw.
    known = np.flatnonzero(np.isfinite(track.heading_deg))
    rows = known[thinned(track.gear[known], track.accepted[known], MOST_POINTS)]
    time_ns, heading = track.time_ns[rows], track.heading_deg[rows]
    # No line crosses a hole in time, nor that of the heading the plot at ±180°.
    steps_ns = np.diff(time_ns)
    # Rows that were thinned, or a slow receiver, are no hole.
    usual_ns = 3.0 * float(np.median(steps_ns)) if len(steps_ns) else 0.0
    hole = steps_ns > max(MAX_GAP_NS, usual_ns)
    wrap = np.abs(np.diff(heading)) > 180.0
    breaks = np.flatnonzero(hole | wrap) + 1
    at_hole = hole[breaks - 1]

    def column(values: npt.NDArray[np.generic]) -> Float64:
        filled = values.astype(np.float64)
        return np.insert(filled, breaks, np.where(at_hole, np.nan, filled[breaks]))

    time_s = (time_ns - (time_ns[0] if len(rows) else 0)) / 1e9
    unit_s, unit = _time_unit(float(time_s[-1]) if len(rows) else 0.0)
    since = f" since {str(time_ns[0].astype('datetime64[ns]'))[:19]}Z" if len(rows) else ""
    return _TrackColumns(
        column(time_s / unit_s),
        f"time ({unit}){since}",
        column(track.east_m[rows]),
        column(track.north_m[rows]),
        np.insert(heading, breaks, np.nan),
        column(track.heading_sigma_deg[rows]),
        column(track.speed_mps[rows]),
        column(track.gear[rows]),
        column(track.accepted[rows]) == 1.0,
        column(_marked(time_ns, track.accepted[rows])) == 1.0,
    )


def _marked(time_ns: Int64, ok: Bool) -> Bool:
    """Which rejected rows are marked."""
    marked = ~ok
    accepted_ns = time_ns[ok]
    if accepted_ns.size:
        after = np.clip(np.searchsorted(accepted_ns, time_ns), 1, max(accepted_ns.size - 1, 1))
        after = np.minimum(after, accepted_ns.size - 1)
        before_ns, after_ns = accepted_ns[np.maximum(after - 1, 0)], accepted_ns[after]
        between = (before_ns <= time_ns) & (time_ns <= after_ns)
        marked &= ~(between & (after_ns - before_ns <= _DENSE_NS))
    rows = np.flatnonzero(marked)
    marked[:] = False
    marked[rows[:: -(-len(rows) // _MARKS) or 1]] = True
    return marked


def _time_unit(span_s: float) -> tuple[float, str]:
    if span_s <= 600.0:
        return 1.0, "s"
    return (60.0, "min") if span_s <= 4 * 3600.0 else (3600.0, "h")


def _draw_way(axes: Axes, drawn: _TrackColumns) -> None:
    """Draw the way by gear, rejected poses, and ticks that show where the nose pointed."""
    _draw_by_gear(axes, drawn, drawn.east_m, drawn.north_m)
    _draw_ticks(axes, drawn)
    axes.set_aspect("equal", adjustable="datalim")
    axes.ticklabel_format(useOffset=False)
    axes.set(xlabel="east (m)", ylabel="north (m)", title="trajectory")
    axes.grid(linewidth=0.3)


def _draw_by_gear(axes: Axes, drawn: _TrackColumns, x: Float64, y: Float64) -> None:
    """One quantity against another, by gear; rejected poses show as crosses under the line."""
    for gear, name, width, marker, size in _GEAR_STYLES:
        mine = drawn.gear == gear
        if not mine.any():
            continue
        if width:
            # On to the neighbours of the next gear, so that the line is whole.
            mine = mine | np.append(mine[1:], False) | np.insert(mine[:-1], 0, False)
        axes.plot(
            np.where(mine, x, np.nan),
            np.where(mine, y, np.nan),
            linestyle="-" if width else "none",
            linewidth=width,
            color=palette.GEARS[gear],
            marker=marker,
            markersize=size,
            markeredgewidth=0.0,
            solid_capstyle="butt",
            label=name,
            zorder=3 if gear < 0 else 2.5,
        )
    if drawn.refused.any():
        axes.plot(
            x[drawn.refused],
            y[drawn.refused],
            linestyle="none",
            marker="x",
            markersize=5.0,
            markeredgewidth=0.8,
            color=palette.REJECTED,
            label="rejected",
            zorder=2,
        )


def _draw_ticks(axes: Axes, drawn: _TrackColumns) -> None:
    """Short arrows along the nose, evenly along the way driven."""
    rows = np.flatnonzero(np.isfinite(drawn.east_m) & np.isfinite(drawn.heading_deg))
    if rows.size < 2:
        return
    east, north = drawn.east_m[rows], drawn.north_m[rows]
    way = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(east), np.diff(north)))])
    extent_m = max(float(np.ptp(east)), float(np.ptp(north)), 0.1)
    count = min(_MOST_TICKS, 2 + int(way[-1] / (_TICK_STEP * extent_m)))
    at = np.unique(np.searchsorted(way, np.linspace(0.0, way[-1], count)))
    length_m = _TICK_SHARE * extent_m
    phi = np.radians(drawn.heading_deg[rows][at])
    axes.quiver(
        east[at],
        north[at],
        length_m * np.sin(phi),
        length_m * np.cos(phi),
        angles="xy",
        scale_units="xy",
        scale=1.0,
        width=0.003,
        color=_NOSE,
        zorder=4,
    )
    axes.plot([], [], linestyle="none", marker=(3, 0, -90), color=_NOSE, label="nose")


def _draw_nose(axes: Axes, drawn: _TrackColumns) -> None:
    """Heading against time with its sigma, which goes on at the other edge of the plot."""
    for turn in (-360.0, 0.0, 360.0):
        value = drawn.heading_deg + turn
        low, high = value - drawn.sigma_deg, value + drawn.sigma_deg
        if np.any((high > -180.0) & (low < 180.0)):
            axes.fill_between(drawn.time, low, high, color=palette.BAND, linewidth=0)
    _draw_by_gear(axes, drawn, drawn.time, drawn.heading_deg)
    axes.set(
        ylim=(-180, 180),
        yticks=range(-180, 181, 60),
        ylabel="heading (° from north)",
        title="heading with 1 sigma, speed, sigma of the heading",
    )
    axes.grid(linewidth=0.3)


def _draw_sigma(axes: Axes, drawn: _TrackColumns, max_sigma_deg: float | None) -> None:
    _draw_by_gear(axes, drawn, drawn.time, drawn.sigma_deg)
    values = drawn.sigma_deg[np.isfinite(drawn.sigma_deg) & (drawn.sigma_deg > 0.0)]
    limits = [] if max_sigma_deg is None else [max_sigma_deg]
    axes.set_yscale("log")
    axes.set_ylim(0.7 * min([0.5, *limits, *values]), 1.8 * max([1.0, *limits, *values]))
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.yaxis.set_minor_locator(NullLocator())
    for limit in limits:
        axes.axhline(limit, color="0.2", linewidth=0.9, linestyle="--")
        axes.annotate(
            f"limit {limit:g}°",
            (1.0, limit),
            xycoords=("axes fraction", "data"),
            xytext=(-3, 2),
            textcoords="offset points",
            ha="right",
            fontsize="small",
            bbox={"facecolor": "white", "alpha": 0.8, "pad": 0.8, "linewidth": 0.0},
        )
    axes.set_ylabel("heading sigma (°)")
    axes.grid(linewidth=0.3)
