"""The picture of an estimated mount: what each frame said, and the line through the ways."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fieldgrid.core import GEARS, MEASURED, STATED
from fieldgrid.pipeline.mounting.estimate import HEIGHT, ROLL, TILT, YAW, MountEstimate

_POINT = "0.45"


def mount_figure(estimate: MountEstimate) -> Figure:
    """Tilt, roll and height by frame with their means, and direction of travel by curvature."""
    figure = Figure(figsize=(10.0, 7.0), layout="constrained")
    FigureCanvasAgg(figure)
    stated = {one.key: one.stated for one in estimate.compared()}
    stood, time_ns = estimate.mount_samples, estimate.time_ns
    time_s = (time_ns[stood.frame] - time_ns[:1]) / 1e9
    panels = figure.subplots(2, 2).ravel()
    for axes, values, mean, key, label in zip(
        panels[:3],
        (stood.tilt_deg, stood.roll_deg, stood.height_m),
        (estimate.tilt_deg, estimate.roll_deg, estimate.height_m),
        (TILT, ROLL, HEIGHT),
        ("tilt down (°)", "roll, right side down (°)", "height above ground (m)"),
        strict=True,
    ):
        low, high = mean.value - mean.sigma, mean.value + mean.sigma
        axes.plot(time_s, values, ".", color=_POINT, label="frames")
        axes.axhline(mean.value, color=MEASURED, label=f"{mean.value:.3f} ± {mean.sigma:.3f}")
        axes.axhspan(low, high, color=MEASURED, alpha=0.2)
        axes.set(xlabel="time (s)", ylabel=label)
        _finish(axes, stated.get(key), 1.0)
    _draw_ways(panels[3], estimate)
    _finish(panels[3], stated.get(YAW), -1.0)
    figure.suptitle(f"{estimate.name}: mount by {estimate.method}")
    return figure


def _draw_ways(axes: Axes, estimate: MountEstimate) -> None:
    steps, yaw = estimate.ways, estimate.yaw_deg
    for mask, colour, label in (
        (steps.forward_m >= 0.0, _POINT, "forward"),
        (steps.forward_m < 0.0, GEARS[-1], "reverse"),
    ):
        if mask.any():
            at = steps.curvature_per_m[mask], steps.direction_deg[mask]
            axes.plot(*at, ".", color=colour, label=label)
    if yaw is not None and len(steps.stop):
        ahead_m = 0.0 if estimate.axle_ahead_m is None else estimate.axle_ahead_m.value
        ends = np.array([steps.curvature_per_m.min(), steps.curvature_per_m.max()])
        line = -yaw.value + np.degrees(ahead_m * ends)
        axes.plot(ends, line, color=MEASURED, label=f"yaw {yaw.value:.3f} ± {yaw.sigma:.3f}")
    axes.set(
        xlabel="curvature, to the right (1/m)",
        ylabel="direction of travel,\nto the right of the camera (°)",
    )


def _finish(axes: Axes, stated: float | None, sign: float) -> None:
    """Draw what was stated, on an axis of this sign, and say what is drawn."""
    if stated is not None:
        axes.axhline(sign * stated, color=STATED, linestyle="--", label=f"stated {stated:.3f}")
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="best", fontsize=8)
