"""The picture of an estimated mount: what each frame said, and the line through the ways."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from fieldgrid.core import GEARS, MEASURED, STATED, Float64, MeasuredValue
from fieldgrid.pipeline.mounting.estimate import HEIGHT, ROLL, TILT, YAW, MountEstimate

_POINT = "0.45"


def mount_figure(estimate: MountEstimate) -> Figure:
    """Tilt, roll and height by frame with their means, and direction of travel by curvature."""
    figure = Figure(figsize=(10.0, 7.0), layout="constrained")
    FigureCanvasAgg(figure)
    stated = {one.key: one.stated for one in estimate.compared()}
    stood = estimate.mount_samples
    if len(estimate.time_ns):
        time_s = (estimate.time_ns[stood.frame] - estimate.time_ns[0]) / 1e9
    else:
        time_s = np.zeros(0)
    panels = figure.subplots(2, 2).ravel()
    for axes, values, mean, key, label in zip(
        panels[:3],
        (stood.tilt_deg, stood.roll_deg, stood.height_m),
        (estimate.tilt_deg, estimate.roll_deg, estimate.height_m),
        (TILT, ROLL, HEIGHT),
        ("tilt down (°)", "roll, right side down (°)", "height above ground (m)"),
        strict=True,
    ):
        _draw_series(axes, time_s, values, mean, stated.get(key), label)
    _draw_ways(panels[3], estimate, stated.get(YAW))
    figure.suptitle(f"{estimate.name}: mount by {estimate.method}")
    return figure


def _draw_series(
    axes: Axes,
    time_s: Float64,
    values: Float64,
    mean: MeasuredValue,
    stated: float | None,
    label: str,
) -> None:
    axes.plot(time_s, values, ".", color=_POINT, label="frames")
    text = f"{mean.value:.3f} ± {mean.sigma:.3f}"
    axes.axhline(mean.value, color=MEASURED, label=text)
    axes.axhspan(mean.value - mean.sigma, mean.value + mean.sigma, color=MEASURED, alpha=0.2)
    if stated is not None:
        axes.axhline(stated, color=STATED, linestyle="--", label=f"stated {stated:.3f}")
    axes.set_xlabel("time (s)")
    axes.set_ylabel(label)
    axes.legend(loc="best", fontsize=8)


def _draw_ways(axes: Axes, estimate: MountEstimate, stated_deg: float | None) -> None:
    steps, yaw = estimate.ways, estimate.yaw_deg
    for mask, colour, label in (
        (steps.forward_m >= 0.0, _POINT, "forward"),
        (steps.forward_m < 0.0, GEARS[-1], "reverse"),
    ):
        if mask.any():
            axes.plot(
                steps.curvature_per_m[mask], steps.direction_deg[mask], ".", color=colour,
                label=label,
            )  # fmt: skip
    if yaw is not None and len(steps.stop):
        ahead_m = 0.0 if estimate.axle_ahead_m is None else estimate.axle_ahead_m.value
        ends = np.array([steps.curvature_per_m.min(), steps.curvature_per_m.max()])
        line = -yaw.value + np.degrees(ahead_m * ends)
        axes.plot(ends, line, color=MEASURED, label=f"yaw {yaw.value:.3f} ± {yaw.sigma:.3f}")
    if stated_deg is not None:
        axes.axhline(-stated_deg, color=STATED, linestyle="--", label=f"stated {stated_deg:.3f}")
    axes.set_xlabel("curvature, to the right (1/m)")
    axes.set_ylabel("direction of travel,\nto the right of the camera (°)")
    if axes.get_legend_handles_labels()[0]:
        axes.legend(loc="best", fontsize=8)
