"""The paper's figures from any map: universal grid, trajectory, heading against time.

Pale is traversable, dark red is an obstacle, tinted was never seen, and each session has its
colour; the same as in `fieldgrid view`. Figures are made without pyplot, so that no window system
and no global state is involved.
"""

from fieldgrid.core import UNSEEN
from fieldgrid.export.figures.alignment import alignment_scores
from fieldgrid.export.figures.drives import (
    DrawnDrive,
    draw_heading,
    draw_trajectory,
    drives_of,
    heading,
    trajectory,
)
from fieldgrid.export.figures.grid import change, draw_grid, universal_grid
from fieldgrid.export.figures.page import new_figure, save
from fieldgrid.export.figures.route import read_route
from fieldgrid.export.figures.sheet import sheet
from fieldgrid.export.figures.track import MOST_POINTS, track_figure

__all__ = [
    "MOST_POINTS",
    "UNSEEN",
    "DrawnDrive",
    "alignment_scores",
    "change",
    "draw_grid",
    "draw_heading",
    "draw_trajectory",
    "drives_of",
    "heading",
    "new_figure",
    "read_route",
    "save",
    "sheet",
    "track_figure",
    "trajectory",
    "universal_grid",
]
