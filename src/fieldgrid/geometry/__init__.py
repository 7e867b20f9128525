"""Geometry: arithmetic on planes, lattices, angles and curves.

* `geodesy`: `Datum`, the plane in metres east, north and up; the only user of pyproj.
* `lattice`: `Lattice`, `Window` and `Bounds` of square cells; `grids`: `GridSpec`, `LocalGrid`.
* `rig`: `Rig` of camera, `Mount` and `LeverArm`; `lens`: calibrated cameras.
* `fixes`: `FixColumns` of a receiver; `motion`: `Motion` of gyro, wheels and camera.
* `trajectory`: `Trajectory` of `Pose`s, each with gear, sigma and verdict.
* `angles`, `rotations`: conventions of heading, roll and pitch; `lon_lat`: shapes in degrees.
* `shapes`: curves, polylines, planes through points; `vectors` writes features for any GIS.

It opens no recording and no map, and estimates nothing of a drive.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fieldgrid.core.doors import door

if TYPE_CHECKING:
    from fieldgrid.geometry.angles import (
        heading_deg as heading_deg,
        heading_from_yaw_rad as heading_from_yaw_rad,
        wrap_deg as wrap_deg,
        yaw_from_heading_rad as yaw_from_heading_rad,
    )
    from fieldgrid.geometry.fixes import (
        NOT_SAID as NOT_SAID,
        Fix as Fix,
        FixColumns as FixColumns,
        known_codes as known_codes,
        least_sigma_m as least_sigma_m,
        position_sigma_m as position_sigma_m,
        quality_by_sigma as quality_by_sigma,
    )
    from fieldgrid.geometry.geodesy import (
        MAX_DISTANCE_M as MAX_DISTANCE_M,
        Datum as Datum,
        check_area_of_use as check_area_of_use,
        continued_deg as continued_deg,
        ecef_to_geodetic as ecef_to_geodetic,
        geodetic_to_ecef as geodetic_to_ecef,
        unprojected as unprojected,
    )
    from fieldgrid.geometry.grids import (
        BEYOND_DROP as BEYOND_DROP,
        DROP_CHANNEL as DROP_CHANNEL,
        FOOT_CHANNEL as FOOT_CHANNEL,
        FREE_UP_TO as FREE_UP_TO,
        GROUND_BELOW as GROUND_BELOW,
        GROUND_CHANNEL as GROUND_CHANNEL,
        HIDDEN_FROM as HIDDEN_FROM,
        NO_DROP_TOLD as NO_DROP_TOLD,
        NO_GROUND_CM as NO_GROUND_CM,
        NO_STEP_KNOWN as NO_STEP_KNOWN,
        OBSTACLE_ABOVE as OBSTACLE_ABOVE,
        STEP_CHANNEL as STEP_CHANNEL,
        TOP_CHANNEL as TOP_CHANNEL,
        GridSpec as GridSpec,
        LocalGrid as LocalGrid,
    )
    from fieldgrid.geometry.lattice import (
        MAX_CELL_M as MAX_CELL_M,
        TILE_CELLS as TILE_CELLS,
        Bounds as Bounds,
        Lattice as Lattice,
        TileIndex as TileIndex,
        Window as Window,
        aligned_parts as aligned_parts,
        check_inside as check_inside,
        squares as squares,
        tile_window as tile_window,
    )
    from fieldgrid.geometry.lens import (
        MAX_NUMBER as MAX_NUMBER,
        SAME as SAME,
        LensModel as LensModel,
        RawCamera as RawCamera,
        lens_model as lens_model,
        raw_camera as raw_camera,
    )
    from fieldgrid.geometry.lon_lat import in_degrees as in_degrees
    from fieldgrid.geometry.motion import (
        GivenPoses as GivenPoses,
        Gyro as Gyro,
        Inertial as Inertial,
        Motion as Motion,
        Orientation as Orientation,
        RecordedTilt as RecordedTilt,
        Steps as Steps,
        WheelSpeed as WheelSpeed,
    )
    from fieldgrid.geometry.rig import (
        Carrier as Carrier,
        DepthCamera as DepthCamera,
        HeadingConvention as HeadingConvention,
        LeverArm as LeverArm,
        Lidar as Lidar,
        Mount as Mount,
        Rig as Rig,
        Sensor as Sensor,
        StereoCamera as StereoCamera,
        VehicleGeometry as VehicleGeometry,
        check_offset as check_offset,
        nose_heading_deg as nose_heading_deg,
        with_antenna_ahead as with_antenna_ahead,
    )
    from fieldgrid.geometry.rotations import (
        R_enu_level as R_enu_level,
        R_level_vehicle as R_level_vehicle,
        Tilt as Tilt,
        cross_matrices as cross_matrices,
        from_vectors as from_vectors,
        heading_rad as heading_rad,
        roll_pitch_deg as roll_pitch_deg,
        to_vectors as to_vectors,
    )
    from fieldgrid.geometry.shapes.curves import Word as Word, words as words
    from fieldgrid.geometry.shapes.plane_fit import (
        narrowing as narrowing,
        robust_plane as robust_plane,
    )
    from fieldgrid.geometry.shapes.polyline import (
        extended as extended,
        first_beyond as first_beyond,
        lengths as lengths,
        normals as normals,
        part as part,
        project as project,
        resampled as resampled,
    )
    from fieldgrid.geometry.shapes.vectors import (
        FEATURE_SUFFIXES as FEATURE_SUFFIXES,
        Feature as Feature,
        FeatureLayer as FeatureLayer,
        add_placemarks as add_placemarks,
        plain_properties as plain_properties,
        read_shapes as read_shapes,
        write_features as write_features,
        write_layer as write_layer,
    )
    from fieldgrid.geometry.trajectory import (
        HEIGHT_SHARE as HEIGHT_SHARE,
        MAX_GAP_NS as MAX_GAP_NS,
        Pose as Pose,
        Status as Status,
        Trajectory as Trajectory,
        thinned as thinned,
    )
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
