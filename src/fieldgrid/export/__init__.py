"""Export: a map becomes files of other programs, and figures.

* `registry`: `export_map` finds the `ExportFormat` by its suffix; `register_export_format`.
* `cells`: GeoTIFF, PNG, KMZ, MBTiles, arrays, tables and points of cells.
* `shapes`: features for a GIS, ISO 11783-10 task data and guidance, QGIS projects.
* `robots`: Nav2 maps and masks, bags for ROS, messages of Foxglove.
* `figures`: the paper's figures; `stac`: a farm as a STAC catalogue.

Each file appears whole or not at all. The styles of QGIS are in `maps`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fieldgrid.core.doors import door

if TYPE_CHECKING:
    from fieldgrid.export import figures as figures
    from fieldgrid.export.cells.geotiff import export_change as export_change
    from fieldgrid.export.registry import (
        Exported as Exported,
        ExportFormat as ExportFormat,
        Holds as Holds,
        export_map as export_map,
        format_of as format_of,
        formats as formats,
        register_export_format as register_export_format,
        unregister_export_format as unregister_export_format,
    )
    from fieldgrid.export.robots import foxglove_messages as foxglove_messages
    from fieldgrid.export.robots.bag_content import (
        BagContent as BagContent,
        standing_messages as standing_messages,
    )
    from fieldgrid.export.robots.ros_messages import (
        occupancy_grid as occupancy_grid,
        variances as variances,
    )
    from fieldgrid.export.robots.speed import (
        SPEED_FILTER as SPEED_FILTER,
        SpeedOptions as SpeedOptions,
        speed_mask as speed_mask,
    )
    from fieldgrid.export.shapes.guidance import TaskdataOptions as TaskdataOptions
    from fieldgrid.export.shapes.taskdata import export_taskdata as export_taskdata
    from fieldgrid.export.stac import write_stac as write_stac
    from fieldgrid.maps import Selection as Selection
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
