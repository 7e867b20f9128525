"""The colours of every picture of a map: page, figures, QGIS styles.

They hold for colour-blind eyes and grey print: obstacles differ from free ground by hue and by
lightness, continuous values have cividis, sessions have the colours of Okabe and Ito.
"""

from __future__ import annotations

from typing import NamedTuple

UNSEEN = "#cfdbe6"
"""Cells that no frame has seen: a tint that no value has."""


class Stop(NamedTuple):
    """A colour at a share (0..1) of a scale; between two stops colours are mixed."""

    share: float
    colour: str


Ramp = tuple[Stop, ...]

_OBSTACLE = 100.5 / 255.0

DENSITY: Ramp = (
    Stop(0.0, "#fdf8e7"),
    Stop(50.0 / 255.0, "#f3dfa8"),
    Stop(_OBSTACLE, "#d9ab4a"),
    Stop(_OBSTACLE, "#c23b2e"),
    Stop(1.0, "#4a0a1c"),
)
"""3D density 0..255: pale is free, red to black is an obstacle, with an edge between them."""

OCCUPANCY: Ramp = (
    Stop(0.0, "#fdf8e7"),
    Stop(0.5, "#d9ab4a"),
    Stop(0.5, "#c23b2e"),
    Stop(1.0, "#4a0a1c"),
)
"""Probabilities: the same colours, with the edge at one half."""

COST: Ramp = (
    Stop(0.0, "#fdf8e7"),
    Stop(252.5 / 255.0, "#d9ab4a"),
    Stop(252.5 / 255.0, "#c23b2e"),
    Stop(1.0, "#4a0a1c"),
)
"""Costs 0..255 as Nav2 has them: the same colours, with the edge before 253."""

VALUES: Ramp = (
    Stop(0.0, "#00224e"),
    Stop(0.125, "#123570"),
    Stop(0.25, "#3b496c"),
    Stop(0.375, "#575d6d"),
    Stop(0.5, "#707173"),
    Stop(0.625, "#8a8678"),
    Stop(0.75, "#a59c74"),
    Stop(0.875, "#c3b369"),
    Stop(1.0, "#fee838"),
)
"""Cividis, for what has no threshold: low is dark blue, high is yellow."""


SESSIONS = (
    "#0072b2",
    "#d55e00",
    "#009e73",
    "#cc79a7",
    "#7a5195",
    "#e69f00",
    "#56b4e9",
    "#5c5c5c",
)
"""Colours of sessions in the order in which they were added; they begin again after eight."""

GEARS = {1: "#1f4e9c", -1: "#f28e2b", 0: "#000000"}
"""Forward, reverse and at rest."""

REJECTED = "#8c8c8c"

MEASURED, STATED, OTHER = "#1f4e9c", "#c1121f", "#8c8c8c"
"""What a drive shows or uses; what is said against it, or is bad; what plays no part."""

SHARE, BAND = "#a9c4e6", "#d5d5d5"
"""Bars of a share, and the band of some sigma about a line."""

ROUTE = "#00857c"

CHANGED = {
    "appeared": "#c1121f",
    "vanished": "#1d6fd1",
    "moved": "#7a5195",
    "grown": "#006b2f",
    "cut_back": "#8d5a34",
}
"""What became of an object between two moments."""

MARKS = {"keepout": "#8e0152", "free": "#1d6fd1", "obstacle": "#d02020", "place": "#222222"}
"""What people said of places."""

FEATURES = {
    "row": "#006b2f",
    "lane": "#ffc800",
    "gap": "#ff0000",
    "headland": "#ffa500",
    "block": "#808080",
    "trajectory": "#ffa500",
    "route": ROUTE,
    **CHANGED,
    **MARKS,
}
"""By kinds of features, on pictures from above."""

FOUND = {
    "row": "#006b2f",
    "lane": "#1f5fbf",
    "gap": "#00a0c8",
    "headland": "#e8a33d",
    "obstacle": "#a01fa0",
}
"""What was found in a map, on its cells, which are pale to red."""

TERRAIN = ("#1b5e3b", "#a3b18a", "#f2e8cf", "#8d5a34", "#ffffff")
"""Heights of ground, from low to high."""

CONTOUR = "#3a2c1a"

UNSURE = ("#ffffff", "#b2182b")
"""Sigmas, from small to large."""

STEEP = ("#ffffcc", "#fd8d3c", "#800026")
"""Slopes, from level to steep."""

DROPS = ("#f7f4ff", "#8073ac", "#2d004b")
"""How far ground falls away: violet, as no obstacle and no slope is."""

GOODNESS = ("#7f0000", "#f2c14e", "#fdf8e7")
"""How well a vehicle can drive: dark, as obstacles are, where it cannot."""

CHANGES = {
    "unknown": UNSEEN,
    "free": "#ffffff",
    "stayed": "#404040",
    "appeared": "#c1121f",
    "vanished": "#1d6fd1",
    "new_obstacle": "#e08e45",
    "new_free": "#f2ecd8",
    "not_seen_again": "#a9b4bd",
}
"""What became of a cell between two moments, by the lower-case names of `maps.Change`."""


def session_colour(number: int) -> str:
    """The colour of the n-th session of a map, from 0."""
    return SESSIONS[number % len(SESSIONS)]


def kml(colour: str, alpha: str = "ff") -> str:
    """`#rrggbb` as KML has it: alpha, blue, green, red."""
    return f"{alpha}{colour[5:7]}{colour[3:5]}{colour[1:3]}"


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue, 0..255, of `#rrggbb`."""
    return int(colour[1:3], 16), int(colour[3:5], 16), int(colour[5:7], 16)
