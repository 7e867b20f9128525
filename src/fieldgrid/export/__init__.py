"""A map for programs that do not read GeoPackages: one module a format.

`export_map` is the way in; each module registers the formats that it writes with `registry`. Every
export carries the datum, tells unknown from empty, and is written whole or not at all.
"""

from fieldgrid.export.geotiff import export_change
from fieldgrid.export.registry import (
    Exported,
    ExportFormat,
    Holds,
    export_map,
    format_of,
    formats,
    register_export_format,
    unregister_export_format,
)
from fieldgrid.export.selection import Selection

__all__ = [
    "ExportFormat",
    "Exported",
    "Holds",
    "Selection",
    "export_change",
    "export_map",
    "format_of",
    "formats",
    "register_export_format",
    "unregister_export_format",
]
