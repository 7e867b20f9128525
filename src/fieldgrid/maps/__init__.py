"""Maps: one GeoPackage that holds a field, drive after drive, and is read as cells.

* `file`: `open_map`, `create_map`, `MapFile`; tables, records and the root digest.
* `writing`: `Session` adds a drive, all or nothing; `staging` encodes frames, `placing` folds
  them, `revision` removes, restores and moves sessions. A slow commit: here and in `tiles`.
* `tiles`: `pyramid`, the map over all sessions at every zoom level.
* `layers`: `Layer`, `ChannelGroup`, `register_layer`; one module a layer in `built_in`.
* `views`: `MapView`, its blocks and sources, and what cells count as (`decision`, `deciding`).
* `vector`: `Mark`s, features for a GIS, and the styles of QGIS (`qgis`, `styles`).
* `health`: `verify` and `repair`; `farm`: `Farm`, maps as one; `quadtree`; `costmap`.

It makes no grids and estimates no poses.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fieldgrid.core.doors import door

if TYPE_CHECKING:
    from fieldgrid.maps.cost import (
        DENSITIES as DENSITIES,
        INSCRIBED as INSCRIBED,
        LEAST_DROP_M as LEAST_DROP_M,
        LEAST_SEEN as LEAST_SEEN,
        LETHAL as LETHAL,
        OCCUPIED as OCCUPIED,
        UNKNOWN_COST as UNKNOWN_COST,
        UNKNOWN_OCCUPANCY as UNKNOWN_OCCUPANCY,
        CostCurve as CostCurve,
    )
    from fieldgrid.maps.costmap import Costmap as Costmap, Inflation as Inflation
    from fieldgrid.maps.evidence import (
        FREE as FREE,
        OBSTACLE as OBSTACLE,
        UNSEEN as UNSEEN,
        Evidence as Evidence,
        Strip as Strip,
        fill_pinholes as fill_pinholes,
    )
    from fieldgrid.maps.farm.catalogue import (
        FarmBlock as FarmBlock,
        Health as Health,
        map_files as map_files,
    )
    from fieldgrid.maps.farm.farm import Farm as Farm
    from fieldgrid.maps.file import schema as schema
    from fieldgrid.maps.file.database import (
        Patience as Patience,
        connect as connect,
        reading as reading,
    )
    from fieldgrid.maps.file.history import in_drive_order as in_drive_order
    from fieldgrid.maps.file.map_file import MapFile as MapFile
    from fieldgrid.maps.file.metadata import check_name as check_name
    from fieldgrid.maps.file.records import FrameRecord as FrameRecord, SessionInfo as SessionInfo
    from fieldgrid.maps.file.schema import GEOMETRIES as GEOMETRIES
    from fieldgrid.maps.file.store import (
        create_map as create_map,
        open_map as open_map,
        read_datum as read_datum,
    )
    from fieldgrid.maps.layers.built_in.density import GROUP as GROUP
    from fieldgrid.maps.layers.built_in.traversability import (
        Mobility as Mobility,
        traversability as traversability,
    )
    from fieldgrid.maps.layers.declaration import (
        Cells as Cells,
        Channel as Channel,
        ChannelGroup as ChannelGroup,
        Colours as Colours,
        Combine as Combine,
        Fold as Fold,
        Layer as Layer,
        OverviewChannel as OverviewChannel,
        Surroundings as Surroundings,
        has_any as has_any,
        is_nothing as is_nothing,
        nothing as nothing,
    )
    from fieldgrid.maps.layers.frame import FrameCells as FrameCells, FrameInPlace as FrameInPlace
    from fieldgrid.maps.layers.registry import (
        GROUPS as GROUPS,
        LAYERS as LAYERS,
        channel_names as channel_names,
        check_layers as check_layers,
        groups_of as groups_of,
        kept_groups as kept_groups,
        layers_by_subject as layers_by_subject,
        register_group as register_group,
        register_layer as register_layer,
        unregister as unregister,
    )
    from fieldgrid.maps.layers.sight import hidden as hidden, sight_lines as sight_lines
    from fieldgrid.maps.layers.window import WindowFold as WindowFold
    from fieldgrid.maps.quadtree.rule import LOSS as LOSS, Near as Near
    from fieldgrid.maps.quadtree.split import Squares as Squares, State as State
    from fieldgrid.maps.quadtree.tree import Quadtree as Quadtree
    from fieldgrid.maps.tiles.png import encode_png as encode_png
    from fieldgrid.maps.transfer import (
        Averaging as Averaging,
        Transfer as Transfer,
        check_cell_sizes as check_cell_sizes,
        footprint as footprint,
        land as land,
        mean_density as mean_density,
        to_local as to_local,
        to_universal as to_universal,
    )
    from fieldgrid.maps.vector import qgis as qgis
    from fieldgrid.maps.vector.marks import (
        MAX_CORNERS as MAX_CORNERS,
        MAX_TEXT as MAX_TEXT,
        Mark as Mark,
        MarkKind as MarkKind,
        features as features,
        marks_of_geojson as marks_of_geojson,
    )
    from fieldgrid.maps.vector.stored_features import FOUND_PREFIX as FOUND_PREFIX
    from fieldgrid.maps.views import decision as decision
    from fieldgrid.maps.views.blocks import MapBlocks as MapBlocks
    from fieldgrid.maps.views.change import (
        MEANING as MEANING,
        Change as Change,
        ChangeView as ChangeView,
    )
    from fieldgrid.maps.views.provenance import Provenance as Provenance
    from fieldgrid.maps.views.readable import (
        DrivenMap as DrivenMap,
        Readable as Readable,
        Selection as Selection,
    )
    from fieldgrid.maps.views.view import (
        MapView as MapView,
        cf_dataset as cf_dataset,
        empty_view as empty_view,
        masked as masked,
    )
    from fieldgrid.maps.writing.corrections import (
        HeightCorrection as HeightCorrection,
        Wander as Wander,
    )
    from fieldgrid.maps.writing.merge import merge_maps as merge_maps
    from fieldgrid.maps.writing.session import Session as Session
    from fieldgrid.maps.writing.staging import (
        StagedFrame as StagedFrame,
        StagedFrames as StagedFrames,
        StageEntry as StageEntry,
        StageFile as StageFile,
        damaged_frame as damaged_frame,
        frame_of_record as frame_of_record,
        frame_record as frame_record,
        stage as stage,
        unwritable as unwritable,
    )
    from fieldgrid.maps.writing.transform import (
        WORSE_TIMES as WORSE_TIMES,
        AlignmentRecord as AlignmentRecord,
        RelativeError as RelativeError,
        Transform as Transform,
        placing as placing,
        transform_of as transform_of,
    )
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
