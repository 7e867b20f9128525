"""An inspection on one page: streams, fixes, images and the track."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fieldgrid.core import MEASURED, OTHER, SHARE, STATED
from fieldgrid.geometry import Trajectory
from fieldgrid.pipeline.inspection.report import Inspection

MOST_STREAMS = 12


def inspection_figure(found: Inspection) -> Figure:
    """When each stream was recorded, how good fixes and images are over time, and the track."""
    figure = Figure(figsize=(11.0, 8.0), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 2)
    _draw_streams(axes[0, 0], found)
    _draw_fixes(axes[0, 1], found)
    _draw_images(axes[1, 0], found)
    _draw_track(axes[1, 1], found)
    figure.suptitle(f"{found.name}: {'builds' if found.builds else 'does not build'}")
    return figure


def _empty(axes: Axes, text: str) -> None:
    axes.text(0.5, 0.5, text, ha="center", va="center", transform=axes.transAxes)
    axes.set_axis_off()


def _draw_streams(axes: Axes, found: Inspection) -> None:
    known = [one for one in found.streams if one.start_ns is not None and one.stop_ns is not None]
    known = known[:MOST_STREAMS]
    if not known:
        _empty(axes, "no stream has stamps")
        return
    start_ns = min(one.start_ns for one in known if one.start_ns is not None)
    for row, one in enumerate(known):
        first_s, last_s = ((at_ns or start_ns) - start_ns for at_ns in (one.start_ns, one.stop_ns))
        colour = MEASURED if one.role else OTHER
        axes.plot([first_s / 1e9, last_s / 1e9], [row, row], color=colour, linewidth=6)
    axes.set_yticks(range(len(known)), [one.name[-28:] for one in known])
    axes.invert_yaxis()
    axes.set(xlabel="time since the first stamp (s)", title="streams (grey: not used)")
    axes.grid(axis="x", linewidth=0.3)


def _draw_fixes(axes: Axes, found: Inspection) -> None:
    if found.fixes is None or not found.fixes.stretches:
        _empty(axes, "no fixes")
        return
    parts = found.fixes.stretches
    length_s = parts[1].start_s - parts[0].start_s if len(parts) > 1 else 1.0
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
    sigmas_m = [np.nan if part.sigma_m is None else part.sigma_m for part in parts]
    sigma.plot(middle_s, sigmas_m, ".-", color=STATED)
    sigma.set_ylabel("sigma of a fix (m)", color=STATED)
    sigma.set_ylim(bottom=0.0)


def _draw_images(axes: Axes, found: Inspection) -> None:
    looks = found.looks
    if not looks:
        _empty(axes, "no pairs were looked at")
        return
    time_s = np.array([look.time_ns - looks[0].time_ns for look in looks]) / 1e9
    left, right = np.array([look.images.brightness for look in looks]).T / 255.0
    axes.plot(time_s, left, ".-", label="brightness left")
    axes.plot(time_s, right, ".-", label="right")
    axes.plot(time_s, [look.images.blur for look in looks], ".-", label="blur")
    shifts = [np.nan if look.shift_px is None else look.shift_px for look in looks]
    axes.plot(time_s, shifts, ".-", color=STATED, label="rows off (px)")
    known = [shift for shift in shifts if np.isfinite(shift)]
    axes.set(
        ylim=(min([-0.4, *known]) - 0.2, max([0.8, *known]) + 0.2),
        xlabel="time since the first image (s)",
        title=f"{len(looks)} pairs of {found.frames}",
    )
    axes.legend(loc="best", fontsize="small")
    axes.grid(linewidth=0.3)


def _draw_track(axes: Axes, found: Inspection) -> None:
    track: Trajectory | None = found.trajectory
    if track is None or not track.accepted.any():
        _empty(axes, "no track")
        return
    ok = track.accepted
    axes.plot(
        track.east_m[ok], track.north_m[ok], ".", markersize=1.5, color=MEASURED, label="used"
    )
    if (~ok).any():
        axes.plot(
            *(track.east_m[~ok], track.north_m[~ok]),
            "x", markersize=3, color=STATED, label="rejected",
        )  # fmt: skip
    axes.set_aspect("equal", adjustable="datalim")
    axes.ticklabel_format(useOffset=False)
    axes.set(xlabel="east (m)", ylabel="north (m)", title="track")
    axes.legend(loc="best", fontsize="small")
    axes.grid(linewidth=0.3)
