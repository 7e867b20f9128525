"""The paper's figures from any map: universal grid, trajectory, heading against time.

Pale is traversable, dark red is an obstacle, tinted was never seen, and each session has its
colour; the same as in `fieldgrid view`. Figures are made without pyplot, so that no window system
and no global state is involved.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fieldgrid.core.doors import door

if TYPE_CHECKING:
    from fieldgrid.core import UNSEEN as UNSEEN
    from fieldgrid.export.figures.alignment import alignment_scores as alignment_scores
    from fieldgrid.export.figures.drives import (
        DrawnDrive as DrawnDrive,
        draw_heading as draw_heading,
        draw_trajectory as draw_trajectory,
        drives_of as drives_of,
        heading as heading,
        trajectory as trajectory,
    )
    from fieldgrid.export.figures.grid import (
        change as change,
        draw_grid as draw_grid,
        universal_grid as universal_grid,
    )
    from fieldgrid.export.figures.overview import sheet as sheet
    from fieldgrid.export.figures.page import new_figure as new_figure, save as save
    from fieldgrid.export.figures.track import (
        MOST_POINTS as MOST_POINTS,
        track_figure as track_figure,
    )
    from fieldgrid.export.route_file import read_route as read_route
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
