"""An inspection on one page: streams, fixes, images and the track."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fieldgrid.core import MEASURED, OTHER, SHARE, STATED
from fieldgrid.geometry import Trajectory
from fieldgrid.pipeline.inspection.fixes import FixStretch
from fieldgrid.pipeline.inspection.report import Inspection
from fieldgrid.pipeline.inspection.streams import StreamSummary

MOST_STREAMS = 12


def inspection_figure(found: Inspection) -> Figure:
    """When each stream was recorded, how good fixes and images are over time, and the track."""
    figure = Figure(figsize=(11.0, 8.0), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    track = found.trajectory
    panels: tuple[tuple[Callable[[Axes, Any], None], object, str], ...] = (
        (
            _draw_streams,
            [one for one in found.streams if one.start_ns is not None][:MOST_STREAMS],
            "no stream has stamps",
        ),
        (_draw_fixes, found.fixes and found.fixes.stretches, "no fixes"),
        (_draw_images, found if found.looks else None, "no pairs were looked at"),
        (_draw_track, track if track is not None and track.accepted.any() else None, "no track"),
    )
    for axes, (draw, values, lacking) in zip(figure.subplots(2, 2).flat, panels, strict=True):
        if values:
            draw(axes, values)
        else:
            axes.text(0.5, 0.5, lacking, ha="center", va="center", transform=axes.transAxes)
            axes.set_axis_off()
    figure.suptitle(f"{found.name}: {'builds' if found.builds else 'does not build'}")
    return figure


def _draw_streams(axes: Axes, streams: Sequence[StreamSummary]) -> None:
    spans_ns = np.array([(one.start_ns, one.stop_ns) for one in streams])
    spans_s = (spans_ns - spans_ns.min()) / 1e9
    for row, (one, span_s) in enumerate(zip(streams, spans_s, strict=True)):
        axes.plot(span_s, [row, row], color=MEASURED if one.role else OTHER, linewidth=6)
    axes.set_yticks(range(len(streams)), [one.name[-28:] for one in streams])
    axes.invert_yaxis()
    axes.set(xlabel="time since the first stamp (s)", title="streams (grey: not used)")
    axes.grid(axis="x", linewidth=0.3)


def _draw_fixes(axes: Axes, parts: Sequence[FixStretch]) -> None:
    length_s = parts[1].start_s - parts[0].start_s
    middle_s = np.array([part.start_s for part in parts]) + length_s / 2.0
    shares = [100.0 * (part.accepted_share or 0.0) for part in parts]
    axes.bar(middle_s, shares, width=0.9 * length_s, color=SHARE)
    for at_s, part in zip(middle_s.tolist(), parts, strict=True):
        axes.text(at_s, 3.0, part.quality, rotation=90, ha="center", va="bottom", fontsize="small")
    axes.set(
        ylim=(0, 105),
        xlabel="time since the first fix (s)",
        ylabel="accepted fixes (%)",
        title="fixes",
    )
    sigma = axes.twinx()
    sigmas_m = np.array([part.sigma_m for part in parts], dtype=np.float64)  # None is NaN
    sigma.plot(middle_s, sigmas_m, ".-", color=STATED)
    sigma.set_ylabel("sigma of a fix (m)", color=STATED)
    sigma.set_ylim(bottom=0.0)


def _draw_images(axes: Axes, found: Inspection) -> None:
    looks = found.looks
    time_s = np.array([look.time_ns - looks[0].time_ns for look in looks]) / 1e9
    left, right = np.array([look.images.brightness for look in looks]).T / 255.0
    shifts = np.array([look.shift_px for look in looks], dtype=np.float64)  # None is NaN
    axes.plot(time_s, left, ".-", label="brightness left")
    axes.plot(time_s, right, ".-", label="right")
    axes.plot(time_s, [look.images.blur for look in looks], ".-", label="blur")
    axes.plot(time_s, shifts, ".-", color=STATED, label="rows off (px)")
    axes.set(
        ylim=(np.nanmin([-0.4, *shifts]) - 0.2, np.nanmax([0.8, *shifts]) + 0.2),
        xlabel="time since the first image (s)",
        title=f"{len(looks)} pairs of {found.frames}",
    )
    axes.legend(loc="best", fontsize="small")
    axes.grid(linewidth=0.3)


def _draw_track(axes: Axes, track: Trajectory) -> None:
    used = (track.accepted, ".", 1.5, MEASURED, "used")
    rejected = (~track.accepted, "x", 3, STATED, "rejected")
    for rows, marker, size, colour, label in (used, rejected):
        if rows.any():
            at_m = track.east_m[rows], track.north_m[rows]
            axes.plot(*at_m, marker, markersize=size, color=colour, label=label)
    axes.set_aspect("equal", adjustable="datalim")
    axes.ticklabel_format(useOffset=False)
    axes.set(xlabel="east (m)", ylabel="north (m)", title="track")
    axes.legend(loc="best", fontsize="small")
    axes.grid(linewidth=0.3)
