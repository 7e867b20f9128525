"""The paper's figures from any map: universal grid, trajectory, heading against time.

Bright is traversable, dark is an obstacle, tinted was never seen. Figures are made without
pyplot, so that no window system and no global state is involved.
"""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from fieldgrid.errors import ConfigError, MapWriteError
from fieldgrid.mapfile import MEANING, Change, ChangeView, FrameRecord, MapView
from fieldgrid.mapfile.publish import Draft
from fieldgrid.trajectory import Status, Trajectory

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
    draft = Draft(path, overwrite=True)
    try:
        draft.file.write_bytes(written.getvalue())
        draft.publish()
    except OSError as error:
        if isinstance(error, MapWriteError):
            raise
        raise MapWriteError(
            f"{path} could not be written ({error.strerror}); check the space on the disk."
        ) from error
    finally:
        draft.discard()


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
