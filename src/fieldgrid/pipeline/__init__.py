"""Pipeline: recordings become a map; the only room that wires perception, poses and maps.

* `drives`: `build_map`, from paths and settings to sessions of a map.
* `staging`: frames to staged frames on all cores or a cluster, kept for `--resume`.
* `poses`: `estimate_drive` and `estimate_trajectory`; `tracking`: the same of a log alone.
* `session`: `add_recording`, one drive into a map; `repose`: its poses estimated again.
* `checks`: whether images, clocks and mounting fit the drive.
* `inspection`: `inspect_recording`; `mounting`: `estimate_mount`; `convert`:
  `convert_recording`, a drive as one MCAP.
* `report`: `SessionReport` and `Progress`, what a build says.

It knows no file format of its own, neither of recordings nor of exports.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fieldgrid.core.doors import door

if TYPE_CHECKING:
    from fieldgrid.pipeline.checks.sensor_yaw import sensor_yaw as sensor_yaw
    from fieldgrid.pipeline.checks.stuck import REPEATED as REPEATED, StuckCamera as StuckCamera
    from fieldgrid.pipeline.convert.frames import Images as Images
    from fieldgrid.pipeline.convert.writing import convert_recording as convert_recording
    from fieldgrid.pipeline.drives import build_map as build_map
    from fieldgrid.pipeline.inspection.figure import inspection_figure as inspection_figure
    from fieldgrid.pipeline.inspection.inspector import inspect_recording as inspect_recording
    from fieldgrid.pipeline.inspection.report import Inspection as Inspection
    from fieldgrid.pipeline.inspection.rigs import describe_sensor as describe_sensor
    from fieldgrid.pipeline.inspection.streams import StreamSummary as StreamSummary
    from fieldgrid.pipeline.mounting.estimate import (
        MountComparison as MountComparison,
        MountEstimate as MountEstimate,
        estimate_mount as estimate_mount,
    )
    from fieldgrid.pipeline.mounting.figure import mount_figure as mount_figure
    from fieldgrid.pipeline.mounting.writing import write_estimate as write_estimate
    from fieldgrid.pipeline.poses import (
        cell_budget as cell_budget,
        estimate_drive as estimate_drive,
        estimate_trajectory as estimate_trajectory,
        no_ground as no_ground,
    )
    from fieldgrid.pipeline.report import (
        BadFrame as BadFrame,
        PartlyBuiltError as PartlyBuiltError,
        Progress as Progress,
        SessionReport as SessionReport,
        StageTimes as StageTimes,
    )
    from fieldgrid.pipeline.repose import (
        Attitudes as Attitudes,
        attitudes_of as attitudes_of,
        repose_map as repose_map,
    )
    from fieldgrid.pipeline.session import (
        NewSession as NewSession,
        add_recording as add_recording,
    )
    from fieldgrid.pipeline.staging.drive_start import DriveStart as DriveStart
    from fieldgrid.pipeline.staging.journal import (
        DAMAGED as DAMAGED,
        Blob as Blob,
        Journal as Journal,
        JournalRecord as JournalRecord,
        read_journal as read_journal,
    )
    from fieldgrid.pipeline.staging.kept_frames import (
        BAD as BAD,
        BEGIN as BEGIN,
        FRAME as FRAME,
        KeptDrive as KeptDrive,
        KeptFrame as KeptFrame,
        KeptFrames as KeptFrames,
        Store as Store,
        drop_journal as drop_journal,
        work_folder as work_folder,
    )
    from fieldgrid.pipeline.staging.parts import left_behind as left_behind
    from fieldgrid.pipeline.staging.perception import (
        GridInput as GridInput,
        Perception as Perception,
        StepOutcome as StepOutcome,
        follows_camera as follows_camera,
        grid_of as grid_of,
        local_grid as local_grid,
        perceive_frame as perceive_frame,
        side_by_side as side_by_side,
        visual_odometry as visual_odometry,
    )
    from fieldgrid.pipeline.staging.shares import (
        FrameStager as FrameStager,
        encoded as encoded,
    )
    from fieldgrid.pipeline.targets import (
        check_names as check_names,
        check_output as check_output,
        exists_already as exists_already,
        made_map as made_map,
        opened_map as opened_map,
    )
    from fieldgrid.pipeline.tracking import TrackedDrive as TrackedDrive, track_drive as track_drive
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
