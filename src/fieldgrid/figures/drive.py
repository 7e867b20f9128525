"""The drives behind a map: their paths, and their headings against time."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fieldgrid.figures.grid import draw_grid
from fieldgrid.figures.page import new_figure
from fieldgrid.mapfile import FrameRecord, MapView
from fieldgrid.trajectory import Status, Trajectory

_GRID_POINT, _REJECTED_POINT = "#0b6e4f", "#c1121f"


def trajectory(track: list[Trajectory], frames: list[FrameRecord]) -> Figure:
    """The path driven, with the positions of the local grids highlighted (Figs. 7a, 10a)."""
    figure = new_figure((8.0, 7.0))
    draw_trajectory(figure.add_subplot(), track, frames)
    return figure


def heading(track: list[Trajectory], frames: list[FrameRecord]) -> Figure:
    """Heading against time, with its 3-sigma band (Figs. 7b, 10b, 12b)."""
    figure = new_figure((9.0, 4.0))
    draw_heading(figure.add_subplot(), track, frames)
    return figure


def sheet(
    view: MapView, track: list[Trajectory], frames: list[FrameRecord], *, title: str = ""
) -> Figure:
    """All three on one page: the map on the left, trajectory and heading on the right."""
    figure = new_figure((16.0, 9.0))
    columns = figure.add_gridspec(1, 2, width_ratios=(1.35, 1.0))
    rows = columns[1].subgridspec(2, 1, height_ratios=(1.35, 1.0))
    draw_grid(figure.add_subplot(columns[0]), view, frames, title)
    draw_trajectory(figure.add_subplot(rows[0]), track, frames)
    draw_heading(figure.add_subplot(rows[1]), track, frames)
    return figure


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
