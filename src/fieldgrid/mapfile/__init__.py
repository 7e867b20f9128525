"""The map file: one GeoPackage that holds a field, drive after drive.

A map keeps the evidence, each frame's local grid and pose, and the universal grid that follows
from it. QGIS and GDAL open the file as it is; `docs/map-format.md` says what is in it::

    with open_map("vineyard.gpkg", datum=trajectory.datum, cell_m=0.05) as universal:
        with universal.add_session("june-03", trajectory=trajectory) as session:
            session.add(local_grid, trajectory.at(time_ns), frame_id="000000")

    view = open_map("vineyard.gpkg").read(cell_m=0.25)
    view.density, view.observed, view.bounds

    with open_map("vineyard.gpkg", writable=True) as universal:
        universal.remove_session("june-03")  # and restore_session, repose, repair

A session is in the map when its block ends, or not at all; a new map appears when its own
block ends. One process adds a session at a time, any number read meanwhile.
"""

from fieldgrid.layers import LAYERS
from fieldgrid.mapfile.blocks import MapBlocks
from fieldgrid.mapfile.change import MEANING, Change, ChangeView
from fieldgrid.mapfile.database import Patience
from fieldgrid.mapfile.dataset import cf_dataset, masked
from fieldgrid.mapfile.history import in_drive_order
from fieldgrid.mapfile.map_file import MapFile
from fieldgrid.mapfile.marks import Mark, MarkKind
from fieldgrid.mapfile.merge import MergedSession, merge_maps
from fieldgrid.mapfile.metadata import SessionMetadata
from fieldgrid.mapfile.overviews import OverviewBlock
from fieldgrid.mapfile.provenance import Contribution, Provenance
from fieldgrid.mapfile.readable import DrivenMap, Readable
from fieldgrid.mapfile.records import FrameRecord, SessionInfo
from fieldgrid.mapfile.session import Session
from fieldgrid.mapfile.staging import (
    StagedFrame,
    StagedFrames,
    StageEntry,
    StageFile,
    read_staged,
    stage,
)
from fieldgrid.mapfile.store import create_map, open_map, read_datum
from fieldgrid.mapfile.transform import Transform
from fieldgrid.mapfile.verification import HealthReport
from fieldgrid.mapfile.view import DECISION_LAYERS, DROP_LAYERS, MapView

__all__ = [
    "DECISION_LAYERS",
    "DROP_LAYERS",
    "LAYERS",
    "MEANING",
    "Change",
    "ChangeView",
    "Contribution",
    "DrivenMap",
    "FrameRecord",
    "HealthReport",
    "MapBlocks",
    "MapFile",
    "MapView",
    "Mark",
    "MarkKind",
    "MergedSession",
    "OverviewBlock",
    "Patience",
    "Provenance",
    "Readable",
    "Session",
    "SessionInfo",
    "SessionMetadata",
    "StageEntry",
    "StageFile",
    "StagedFrame",
    "StagedFrames",
    "Transform",
    "cf_dataset",
    "create_map",
    "in_drive_order",
    "masked",
    "merge_maps",
    "open_map",
    "read_datum",
    "read_staged",
    "stage",
]
