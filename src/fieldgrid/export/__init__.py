"""A map for programs that do not read GeoPackages: one module a format.

`export_map` is the way in; `formats` says which module writes what. Every export carries the datum,
tells unknown from empty, and is written whole or not at all.
"""

from fieldgrid.export.formats import FORMATS, Exported, export_map, format_of
from fieldgrid.export.geotiff import export_change, export_geotiff
from fieldgrid.export.selection import Selection

__all__ = [
    "FORMATS",
    "Exported",
    "Selection",
    "export_change",
    "export_geotiff",
    "export_map",
    "format_of",
]
