"""Maps as a web page: for looking, asking why, comparing, and marking; complete without a network.

`view_maps` serves the page; `page/` in the source tree is what it is built from.
"""

from fieldgrid.view.server import view_maps

__all__ = ["view_maps"]
