"""The paper's figures from any map: universal grid, trajectory, heading against time.

Bright is traversable, dark is an obstacle, tinted was never seen. Figures are made without
pyplot, so that no window system and no global state is involved.
"""

from fieldgrid.figures.drive import draw_heading, draw_trajectory, heading, sheet, trajectory
from fieldgrid.figures.grid import UNSEEN, change, draw_grid, universal_grid
from fieldgrid.figures.page import save
from fieldgrid.figures.track import MOST_POINTS, track_figure

__all__ = [
    "MOST_POINTS",
    "UNSEEN",
    "change",
    "draw_grid",
    "draw_heading",
    "draw_trajectory",
    "heading",
    "save",
    "sheet",
    "track_figure",
    "trajectory",
    "universal_grid",
]
