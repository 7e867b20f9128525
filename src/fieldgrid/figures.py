"""The paper's figures from any map: universal grid, trajectory, heading against time.

Bright is traversable, dark is an obstacle, tinted was never seen. Figures are made without
pyplot, so that no window system and no global state is involved.
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import LogLocator, NullLocator

from fieldgrid.array_types import Bool, Float64, Index, Int64
from fieldgrid.errors import ConfigError
from fieldgrid.mapfile import MEANING, Change, ChangeView, FrameRecord, MapView
from fieldgrid.publish import replacing
from fieldgrid.trajectory import MAX_GAP_NS, Status, Trajectory

UNSEEN = "#cfdbe6"
"""Colour of cells that no frame has seen: neither bright nor dark."""

_DENSITY = LinearSegmentedColormap.from_list("density", ["#ffffff", "#000000"])
_CHANGES = {
    Change.UNKNOWN: UNSEEN,
    Change.FREE: "#ffffff",
    Change.STAYED: "#404040",
    Change.APPEARED: "#c1121f",
    Change.VANISHED: "#1d6fd1",
    Change.NEW_OBSTACLE: "#e08e45",
    Change.NEW_FREE: "#f2ecd8",
    Change.NOT_SEEN_AGAIN: "#a9b4bd",
}
_GRID_POINT, _REJECTED_POINT = "#0b6e4f", "#c1121f"


class _Look(NamedTuple):
    """How a gear is drawn: told apart by hue, by lightness and by width, for any eye or print."""

    gear: int
    label: str
    colour: str
    width: float
    marker: str
    size: float


_GEAR_LOOKS = (
    _Look(1, "forward", "#1f4e9c", 1.1, "", 0.0),
    _Look(-1, "reverse", "#f28e2b", 2.8, "", 0.0),
    _Look(0, "at rest", "#000000", 0.0, "s", 3.5),
)
_REFUSED, _BAND, _NOSE = "#8c8c8c", "#d5d5d5", "0.25"

MOST_POINTS = 12_000
"""A longer track is thinned for drawing: more points than this no page can show."""

_TICK_SHARE, _TICK_STEP, _MOST_TICKS = 0.025, 0.08, 150
"""Headings shown along a track: their length and distance as shares of its extent."""

_MARKS, _DENSE_NS = 800, 250_000_000
"""At most so many rejected poses are marked, and none between accepted ones closer than this:
every other fix of some receivers repeats the one before."""


def universal_grid(
    view: MapView, frames: list[FrameRecord] | None = None, *, title: str = ""
) -> Figure:
    """The universal grid with axes in metres east and north, and the 0-255 bar (Figs. 8-14).

    With `frames`, the positions of their local grids are marked.
    """
    bounds = view.bounds
    width_m, height_m = bounds.east_m - bounds.west_m, bounds.north_m - bounds.south_m
    long_side_in = 9.0
    scale = long_side_in / max(width_m, height_m)
    size = (max(width_m * scale, 3.0) + 2.2, max(height_m * scale, 3.0) + 1.2)
    figure = _figure(size)
    draw_grid(figure.add_subplot(), view, frames or [], title)
    return figure


def trajectory(track: list[Trajectory], frames: list[FrameRecord]) -> Figure:
    """The path driven, with the positions of the local grids highlighted (Figs. 7a, 10a)."""
    figure = _figure((8.0, 7.0))
    draw_trajectory(figure.add_subplot(), track, frames)
    return figure


def heading(track: list[Trajectory], frames: list[FrameRecord]) -> Figure:
    """Heading against time, with its 3-sigma band (Figs. 7b, 10b, 12b)."""
    figure = _figure((9.0, 4.0))
    draw_heading(figure.add_subplot(), track, frames)
    return figure


def change(view: ChangeView, *, title: str = "") -> Figure:
    """What changed between two moments: a colour for what became of each cell."""
    bounds = view.bounds
    width_m, height_m = bounds.east_m - bounds.west_m, bounds.north_m - bounds.south_m
    scale = 9.0 / max(width_m, height_m)
    figure = _figure((max(width_m * scale, 3.0) + 3.8, max(height_m * scale, 3.0) + 1.2))
    axes = figure.add_subplot()
    axes.imshow(
        view.change,
        origin="lower",
        extent=(bounds.west_m, bounds.east_m, bounds.south_m, bounds.north_m),
        cmap=ListedColormap([_CHANGES[kind] for kind in Change]),
        vmin=0,
        vmax=len(Change) - 1,
        interpolation="none",
        aspect="equal",
    )
    axes.set_xlabel("east (m)")
    axes.set_ylabel("north (m)")
    axes.ticklabel_format(useOffset=False)
    axes.set_title(title or f"{', '.join(view.after)} against {', '.join(view.before)}", wrap=True)
    legend = [
        Patch(facecolor=_CHANGES[kind], edgecolor="0.6", label=MEANING[kind]) for kind in Change
    ]
    figure.legend(handles=legend, loc="outside right upper", fontsize="small")
    return figure


def sheet(
    view: MapView, track: list[Trajectory], frames: list[FrameRecord], *, title: str = ""
) -> Figure:
    """All three on one page: the map on the left, trajectory and heading on the right."""
    figure = _figure((16.0, 9.0))
    columns = figure.add_gridspec(1, 2, width_ratios=(1.35, 1.0))
    rows = columns[1].subgridspec(2, 1, height_ratios=(1.35, 1.0))
    draw_grid(figure.add_subplot(columns[0]), view, frames, title)
    draw_trajectory(figure.add_subplot(rows[0]), track, frames)
    draw_heading(figure.add_subplot(rows[1]), track, frames)
    return figure


def track_figure(
    track: Trajectory, *, title: str = "", max_sigma_deg: float | None = None
) -> Figure:
    """A trajectory by gear and verdict beside heading, speed and heading sigma (Figs. 7, 10, 12).

    `max_sigma_deg` is the sigma beyond which a heading is rejected, drawn as a line.
    """
    figure = _figure((14.0, 7.6))
    columns = figure.add_gridspec(1, 2, width_ratios=(1.0, 1.15))
    rows = columns[1].subgridspec(3, 1, height_ratios=(1.7, 1.0, 1.0))
    place = figure.add_subplot(columns[0])
    drawn = _drawn(track)
    _draw_way(place, drawn)
    nose = figure.add_subplot(rows[0])
    _draw_nose(nose, drawn)
    speed = figure.add_subplot(rows[1], sharex=nose)
    _draw_speed(speed, drawn)
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


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure, whole or not at all, in the format that the name ends in.

    An earlier file of that name is replaced. Raises ConfigError for a name of no known format,
    MapWriteError where it cannot be written.
    """
    path = Path(path)
    written = BytesIO()
    try:
        figure.savefig(written, format=path.suffix.lstrip(".").lower() or "png")
    except ValueError as error:
        raise ConfigError(
            f"{path} names no format that a figure can have; end it in .png, .pdf or .svg."
        ) from error
    with replacing(path) as draft:
        draft.write_bytes(written.getvalue())


class _Drawn(NamedTuple):
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


def _drawn(track: Trajectory) -> _Drawn:
    # Rows without a heading have no pose to draw.
    known = np.flatnonzero(np.isfinite(track.heading_deg))
    rows = _thinned(known, track.gear[known], track.accepted[known])
    time_ns, heading = track.time_ns[rows], track.heading_deg[rows]
    # No line crosses a hole in time, nor that of the heading the plot at ±180°.
    hole = np.diff(time_ns) > max(MAX_GAP_NS, _usual_step(time_ns))
    wrap = np.abs(np.diff(heading)) > 180.0
    breaks = np.flatnonzero(hole | wrap) + 1
    at_hole = hole[breaks - 1]

    def column(values: npt.NDArray[np.generic]) -> Float64:
        filled = values.astype(np.float64)
        return np.insert(filled, breaks, np.where(at_hole, np.nan, filled[breaks]))

    time_s = (time_ns - (time_ns[0] if len(rows) else 0)) / 1e9
    unit_s, unit = _time_unit(float(time_s[-1]) if len(rows) else 0.0)
    since = f" since {str(time_ns[0].astype('datetime64[ns]'))[:19]}Z" if len(rows) else ""
    return _Drawn(
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


def _thinned(rows: Index, gear: Int64, ok: Bool) -> Index:
    """At most some `MOST_POINTS` of rows, evenly, and each at which gear or verdict change."""
    every = -(-len(rows) // MOST_POINTS)
    if every < 2:
        return rows
    keep = np.zeros(len(rows), dtype=np.bool_)
    keep[::every] = keep[-1] = True
    change = np.flatnonzero((np.diff(gear) != 0) | (np.diff(ok.astype(np.int8)) != 0))
    if len(change) < MOST_POINTS:
        keep[change] = keep[change + 1] = True
    return rows[keep]


def _usual_step(time_ns: Int64) -> float:
    """Three times the usual step: rows that were thinned, or a slow receiver, are no hole."""
    return 3.0 * float(np.median(np.diff(time_ns))) if len(time_ns) > 1 else 0.0


def _time_unit(span_s: float) -> tuple[float, str]:
    if span_s <= 600.0:
        return 1.0, "s"
    return (60.0, "min") if span_s <= 4 * 3600.0 else (3600.0, "h")


def _draw_way(axes: Axes, drawn: _Drawn) -> None:
    """Draw the way by gear, rejected poses, and ticks that show where the nose pointed."""
    _draw_by_gear(axes, drawn, drawn.east_m, drawn.north_m)
    _draw_ticks(axes, drawn)
    axes.set_aspect("equal", adjustable="datalim")
    axes.ticklabel_format(useOffset=False)
    axes.set_xlabel("east (m)")
    axes.set_ylabel("north (m)")
    axes.set_title("trajectory")
    axes.grid(linewidth=0.3)


def _draw_by_gear(axes: Axes, drawn: _Drawn, x: Float64, y: Float64) -> None:
    """One quantity against another, by gear; rejected poses show as crosses under the line."""
    for look in _GEAR_LOOKS:
        mine = drawn.gear == look.gear
        if not mine.any():
            continue
        if look.width:
            # On to the neighbours of the next gear, so that the line is whole.
            mine = mine | np.append(mine[1:], False) | np.insert(mine[:-1], 0, False)
        axes.plot(
            np.where(mine, x, np.nan),
            np.where(mine, y, np.nan),
            linestyle="-" if look.width else "none",
            linewidth=look.width,
            color=look.colour,
            marker=look.marker,
            markersize=look.size,
            markeredgewidth=0.0,
            solid_capstyle="butt",
            label=look.label,
            zorder=3 if look.gear < 0 else 2.5,
        )
    if drawn.refused.any():
        axes.plot(
            x[drawn.refused],
            y[drawn.refused],
            linestyle="none",
            marker="x",
            markersize=5.0,
            markeredgewidth=0.8,
            color=_REFUSED,
            label="rejected",
            zorder=2,
        )


def _draw_ticks(axes: Axes, drawn: _Drawn) -> None:
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


def _draw_nose(axes: Axes, drawn: _Drawn) -> None:
    """Heading against time with its sigma, which goes on at the other edge of the plot."""
    for turn in (-360.0, 0.0, 360.0):
        value = drawn.heading_deg + turn
        low, high = value - drawn.sigma_deg, value + drawn.sigma_deg
        if np.any((high > -180.0) & (low < 180.0)):
            axes.fill_between(drawn.time, low, high, color=_BAND, linewidth=0)
    _draw_by_gear(axes, drawn, drawn.time, drawn.heading_deg)
    axes.set_ylim(-180, 180)
    axes.set_yticks(range(-180, 181, 60))
    axes.set_ylabel("heading (° from north)")
    axes.set_title("heading with 1 sigma, speed, sigma of the heading")
    axes.grid(linewidth=0.3)


def _draw_speed(axes: Axes, drawn: _Drawn) -> None:
    axes.axhline(0.0, color="0.6", linewidth=0.6)
    _draw_by_gear(axes, drawn, drawn.time, drawn.speed_mps)
    axes.set_ylabel("speed (m/s)")
    axes.grid(linewidth=0.3)


def _draw_sigma(axes: Axes, drawn: _Drawn, max_sigma_deg: float | None) -> None:
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
        )
    axes.set_ylabel("heading sigma (°)")
    axes.grid(linewidth=0.3)


def draw_grid(axes: Axes, view: MapView, frames: list[FrameRecord], title: str) -> None:
    """Draw the universal grid into axes."""
    bounds = view.bounds
    shown = np.ma.masked_array(view.density, mask=~view.observed)
    axes.set_facecolor(UNSEEN)
    image = axes.imshow(
        shown,
        origin="lower",
        extent=(bounds.west_m, bounds.east_m, bounds.south_m, bounds.north_m),
        cmap=_DENSITY,
        vmin=0,
        vmax=255,
        interpolation="none",
        aspect="equal",
    )
    marked = [f for f in frames if f.pose.status is Status.OK and _inside(f, view)]
    if marked:
        axes.plot(
            [f.pose.east_m for f in marked],
            [f.pose.north_m for f in marked],
            linestyle="none",
            marker=".",
            markersize=4,
            color=_GRID_POINT,
        )
    axes.set_xlabel("east (m)")
    axes.set_ylabel("north (m)")
    axes.ticklabel_format(useOffset=False)
    axes.set_title(title or f"universal grid, cells of {view.lattice.cell_m * 100:g} cm")
    # Beside the axes and exactly as tall, whatever the map's shape.
    bar = axes.figure.colorbar(image, cax=axes.inset_axes((1.02, 0.0, 0.03, 1.0)))
    bar.set_label("3D density (> 100: obstacle; tinted: unseen)")


def draw_trajectory(axes: Axes, track: list[Trajectory], frames: list[FrameRecord]) -> None:
    """Draw the path and the positions of the local grids into axes."""
    for one in track:
        ok = one.accepted
        path_e, path_n = np.where(ok, one.east_m, np.nan), np.where(ok, one.north_m, np.nan)
        axes.plot(path_e, path_n, linewidth=0.8, color="0.55")
    _mark(axes, frames, [f.pose.east_m for f in frames], [f.pose.north_m for f in frames])
    axes.set_aspect("equal", adjustable="datalim")
    axes.ticklabel_format(useOffset=False)
    axes.set_xlabel("east (m)")
    axes.set_ylabel("north (m)")
    axes.set_title("trajectory and positions of the local grids")
    axes.grid(linewidth=0.3)


def draw_heading(axes: Axes, track: list[Trajectory], frames: list[FrameRecord]) -> None:
    """Draw heading against time into axes, time from the first fix of each session."""
    starts: list[int] = []
    for one in track:
        if len(one) == 0:
            continue
        time_s = (one.time_ns - one.time_ns[0]) / 1e9
        ok = one.accepted
        value = np.where(ok, one.heading_deg, np.nan)
        band = 3.0 * np.where(ok, one.heading_sigma_deg, np.nan)
        # Dots, because a line would cross the plot wherever the heading passes ±180°.
        axes.plot(time_s, value, linestyle="none", marker=".", markersize=2, color="0.4")
        axes.fill_between(time_s, value - band, value + band, color="0.85", linewidth=0)
        starts.append(int(one.time_ns[0]))
    origin = min(starts, default=min((f.pose.time_ns for f in frames), default=0))
    times = [(f.pose.time_ns - _start_of(f, starts, origin)) / 1e9 for f in frames]
    _mark(axes, frames, times, [f.pose.heading_deg for f in frames])
    axes.set_ylim(-180, 180)
    axes.set_yticks(range(-180, 181, 60))
    axes.set_xlabel("time (s)")
    axes.set_ylabel("heading (° clockwise from north)")
    axes.set_title("heading, with 3 sigma")
    axes.grid(linewidth=0.3)


def _start_of(frame: FrameRecord, starts: list[int], otherwise: int) -> int:
    """The start of the session that a frame belongs to: the latest not after it."""
    return max((s for s in starts if s <= frame.pose.time_ns), default=otherwise)


def _mark(axes: Axes, frames: list[FrameRecord], x: list[float], y: list[float]) -> None:
    for status, colour, label in (
        (Status.OK, _GRID_POINT, "used"),
        (Status.REJECTED, _REJECTED_POINT, "rejected"),
    ):
        chosen = [k for k, f in enumerate(frames) if f.pose.status is status]
        if chosen:
            axes.plot(
                [x[k] for k in chosen],
                [y[k] for k in chosen],
                linestyle="none",
                marker="o" if status is Status.OK else "x",
                markersize=3.5,
                color=colour,
                label=f"{len(chosen)} {label}",
            )
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="best", fontsize="small")


def _inside(frame: FrameRecord, view: MapView) -> bool:
    bounds = view.bounds
    east_m, north_m = frame.pose.east_m, frame.pose.north_m
    return bounds.west_m <= east_m <= bounds.east_m and bounds.south_m <= north_m <= bounds.north_m


def _figure(size_in: tuple[float, float]) -> Figure:
    figure = Figure(figsize=size_in, dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    return figure
