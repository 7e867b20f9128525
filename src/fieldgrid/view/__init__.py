"""Maps as a web page: for looking, asking why, comparing; complete without a network.

`view_maps` serves the page, `write_report` makes one file of it; its sources are in `page/`.
"""

from fieldgrid.view.report import Report, write_report
from fieldgrid.view.server import view_maps

__all__ = ["Report", "view_maps", "write_report"]
