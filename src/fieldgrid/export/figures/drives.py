"""The drives behind a map: their paths, and their headings against time, a colour a session."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from fieldgrid.core import MapError, palette
from fieldgrid.export.figures.page import add_scale_bar, name_axes, new_figure
from fieldgrid.geometry import Status, Trajectory
from fieldgrid.maps import DrivenMap, FrameRecord

MOST_HEADINGS = 8
"""Sessions whose headings are drawn on a page: the latest ones."""

MOST_NAMES = 8
"""Sessions that a legend names."""


class DrawnDrive(NamedTuple):
    """A session as figures show it: its frames, its trajectory where one is kept, its colour."""

    name: str
    frames: tuple[FrameRecord, ...] = ()
    trajectory: Trajectory | None = None
    colour: str = palette.SESSIONS[0]


def drives_of(universal: DrivenMap, names: Collection[str] | None = None) -> list[DrawnDrive]:
    """The active sessions of a map or a farm, or those named, in the order of its list."""
    found = []
    for number, info in enumerate(universal.sessions()):
        if info.active if names is None else info.name in names:
            try:
                trajectory = universal.trajectory(info.name)
            except MapError:
                trajectory = None  # frames with poses were added without one
            found.append(
                DrawnDrive(
                    info.name,
                    tuple(universal.frames(info.name)),
                    trajectory,
                    palette.session_colour(number),
                )
            )
    return found


def trajectory(drives: Sequence[DrawnDrive]) -> Figure:
    """The paths driven, with the positions of the local grids highlighted (Figs. 7a, 10a)."""
    figure = new_figure((8.0, 7.0))
    draw_trajectory(figure.add_subplot(), drives)
    return figure


def heading(drives: Sequence[DrawnDrive]) -> Figure:
    """Heading against time with its 3-sigma band, each session with an axis of time of its own
    (Figs. 7b, 10b, 12b)."""
    shown = list(drives)[-MOST_HEADINGS:] or [DrawnDrive("")]
    figure = new_figure((9.0, 1.2 + 2.8 * len(shown)))
    for axes, drive in zip(figure.subplots(len(shown), squeeze=False)[:, 0], shown, strict=True):
        draw_heading(axes, drive)
    if len(drives) > len(shown):
        figure.suptitle(f"the latest {len(shown)} of {len(drives)} sessions")
    return figure


def draw_trajectory(axes: Axes, drives: Sequence[DrawnDrive]) -> None:
    """Draw the paths and the positions of the local grids into axes."""
    for number, drive in enumerate(drives):
        used = [f.pose for f in drive.frames if f.accepted]
        refused = [f.pose for f in drive.frames if f.status is Status.REJECTED]
        if (one := drive.trajectory) is not None:
            east = np.where(one.accepted, one.east_m, np.nan)
            north = np.where(one.accepted, one.north_m, np.nan)
            axes.plot(east, north, linewidth=0.9, color=drive.colour, alpha=0.7)
        for poses, marker, word in ((used, "o", "used"), (refused, "x", "rejected")):
            if poses:
                label = f"{drive.name}: {len(poses)} {word}" if drive.name else word
                axes.plot(
                    [pose.east_m for pose in poses],
                    [pose.north_m for pose in poses],
                    linestyle="none",
                    marker=marker,
                    markersize=3.5 if marker == "o" else 5.0,
                    color=drive.colour if marker == "o" else palette.REJECTED,
                    label=label if number < MOST_NAMES else f"_{label}",
                )
    axes.set_aspect("equal", adjustable="datalim")
    name_axes(axes, "trajectory and positions of the local grids")
    axes.grid(linewidth=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="best", fontsize="small")
    axes.autoscale_view()
    west, east_most = axes.get_xlim()
    add_scale_bar(axes, east_most - west)


def draw_heading(axes: Axes, drive: DrawnDrive) -> None:
    """Draw heading against time into axes, time from the first fix or frame of the session."""
    one = drive.trajectory
    starts = [frame.pose.time_ns for frame in drive.frames]
    start_ns = min(starts, default=0)
    if one is not None and len(one):
        start_ns = int(one.time_ns[0])
        starts = [start_ns]
        time_s = (one.time_ns - start_ns) / 1e9
        value = np.where(one.accepted, one.heading_deg, np.nan)
        band = 3.0 * np.where(one.accepted, one.heading_sigma_deg, np.nan)
        # Dots, because a line would cross the plot wherever the heading passes ±180°.
        axes.plot(
            time_s, value, linestyle="none", marker=".", markersize=2, color=drive.colour, alpha=0.6
        )
        axes.fill_between(time_s, value - band, value + band, color="0.85", linewidth=0)
    for status, marker in ((Status.OK, "o"), (Status.REJECTED, "x")):
        poses = [frame.pose for frame in drive.frames if frame.status is status]
        if poses:
            axes.plot(
                [(pose.time_ns - start_ns) / 1e9 for pose in poses],
                [pose.heading_deg for pose in poses],
                linestyle="none",
                marker=marker,
                markersize=3.5 if marker == "o" else 5.0,
                color=drive.colour if marker == "o" else palette.REJECTED,
                label=f"{len(poses)} {'used' if marker == 'o' else 'rejected'}",
            )
    since = f" since {str(np.datetime64(start_ns, 'ns'))[:19]}Z" if starts else ""
    axes.set(
        ylim=(-180, 180),
        yticks=range(-180, 181, 60),
        xlabel=f"time (s){since}",
        ylabel="heading (° from north)",
        title=f"{drive.name}: heading, with 3 sigma" if drive.name else "heading, with 3 sigma",
    )
    axes.grid(linewidth=0.3)
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="best", fontsize="small")
