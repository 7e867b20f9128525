"""Recordings: what was on the vehicle's disk after a drive, whatever its format.

* `opening`: `open_drive` and `open_recording`, with `DriveOptions` of what users say.
* `readers`: a module a format (plain folder, KITTI, EuRoC, RTKLIB, ISO 11783-10).
* `bag`: bags of ROS as recordings; `ros`: their containers and messages.
* `tables`: columns, times and units of logs; `calibration`: cameras and mounting.
* `frames`: images, depths and clouds, read when asked for; `poses`: files of other programs.
* `remote`: copies of recordings at URLs.
* `drive`: `Drive` and `Recording`, what all of these give.

It estimates no poses and makes no grids.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fieldgrid.core.doors import door

if TYPE_CHECKING:
    from fieldgrid.recordings.bag.listeners import (
        Numbers as Numbers,
        lean_of as lean_of,
        sensed_by as sensed_by,
    )
    from fieldgrid.recordings.bag.motion import (
        LEAST_STEP_NS as LEAST_STEP_NS,
        ODOMETRY_FRAME_SIGMA_DEG as ODOMETRY_FRAME_SIGMA_DEG,
        TAKEN as TAKEN,
        Untold as Untold,
        axes_of as axes_of,
        felt_upward as felt_upward,
        orientation_of as orientation_of,
        rate_about as rate_about,
        stated_orientation as stated_orientation,
        turns_across as turns_across,
    )
    from fieldgrid.recordings.bag.order import MAX_APART_NS as MAX_APART_NS, is_utc as is_utc
    from fieldgrid.recordings.bag.sensors.clouds import MessageCloud as MessageCloud
    from fieldgrid.recordings.bag.sensors.frames import BagFrames as BagFrames, Taken as Taken
    from fieldgrid.recordings.bag.sensors.images import image_source as image_source
    from fieldgrid.recordings.bag.topic_names import (
        IMU as IMU,
        ODOMETRY as ODOMETRY,
        TF as TF,
        TF_STATIC as TF_STATIC,
    )
    from fieldgrid.recordings.bag.topics import (
        TYPES_OF_ROLES as TYPES_OF_ROLES,
        is_of_use as is_of_use,
        short as short,
    )
    from fieldgrid.recordings.bag.trajectories import pose_numbers as pose_numbers
    from fieldgrid.recordings.bag.transforms import (
        FrameTransform as FrameTransform,
        Transforms as Transforms,
        is_optical as is_optical,
        optical as optical,
        told as told,
    )
    from fieldgrid.recordings.calibration.mounting import (
        Mounting as Mounting,
        read_mounting as read_mounting,
        write_mounting as write_mounting,
    )
    from fieldgrid.recordings.drive import (
        Drive as Drive,
        Recording as Recording,
        Stream as Stream,
        as_recording as as_recording,
        no_fixes as no_fixes,
        with_frames as with_frames,
    )
    from fieldgrid.recordings.files import read_text as read_text
    from fieldgrid.recordings.format import (
        Format as Format,
        formats as formats,
        mounting_path as mounting_path,
        register_format as register_format,
        unregister_format as unregister_format,
    )
    from fieldgrid.recordings.frames.cloud_files import (
        CloudFile as CloudFile,
        CloudKind as CloudKind,
    )
    from fieldgrid.recordings.frames.depth_files import DepthFile as DepthFile
    from fieldgrid.recordings.frames.frames import (
        CloudFrame as CloudFrame,
        CloudSource as CloudSource,
        DepthFrame as DepthFrame,
        DepthSource as DepthSource,
        Frame as Frame,
        FrameReader as FrameReader,
        FrameSource as FrameSource,
        Image as Image,
        ImageSource as ImageSource,
        PairRectifier as PairRectifier,
        Source as Source,
        StereoFrame as StereoFrame,
    )
    from fieldgrid.recordings.frames.images import ImageFile as ImageFile
    from fieldgrid.recordings.frames.npy import parse_npy as parse_npy
    from fieldgrid.recordings.opening import (
        open_drive as open_drive,
        open_recording as open_recording,
    )
    from fieldgrid.recordings.options import (
        MAX_OFFSET_S as MAX_OFFSET_S,
        ROLES as ROLES,
        DriveOptions as DriveOptions,
    )
    from fieldgrid.recordings.poses.given_poses import (
        CAMERA_AXES as CAMERA_AXES,
        motion_of_body as motion_of_body,
        with_body_poses as with_body_poses,
    )
    from fieldgrid.recordings.poses.pose_files import (
        MOST_M as MOST_M,
        OFF_UNIT as OFF_UNIT,
        BodyPoses as BodyPoses,
        rotations as rotations,
    )
    from fieldgrid.recordings.poses.pose_source import (
        PoseBody as PoseBody,
        PoseSource as PoseSource,
    )
    from fieldgrid.recordings.readers.folder import folder_mounting_path as folder_mounting_path
    from fieldgrid.recordings.readers.growing import (
        GrowingFolder as GrowingFolder,
        open_growing as open_growing,
    )
    from fieldgrid.recordings.remote.copies import (
        cache_folder as cache_folder,
        copy_of as copy_of,
        in_cache as in_cache,
        is_url as is_url,
        read_manifest as read_manifest,
        url_of as url_of,
    )
    from fieldgrid.recordings.remote.fetched import fetch as fetch
    from fieldgrid.recordings.ros import (
        gnss_messages as gnss_messages,
        ros_messages as ros_messages,
    )
    from fieldgrid.recordings.ros.bag import as_utc as as_utc
    from fieldgrid.recordings.ros.definitions import (
        decode as decode,
        encoded as encoded,
        stamp_ns as stamp_ns,
    )
    from fieldgrid.recordings.ros.gnss_messages import (
        DATUM as DATUM,
        ORIENTATION as ORIENTATION,
        TILT as TILT,
        Tilts as Tilts,
        datum_message as datum_message,
        nav_sat_fix as nav_sat_fix,
        quality_of as quality_of,
    )
    from fieldgrid.recordings.ros.mcap_file import (
        UNNAMED as UNNAMED,
        connection_of as connection_of,
        named as named,
    )
    from fieldgrid.recordings.ros.model import (
        Connection as Connection,
        Message as Message,
    )
    from fieldgrid.recordings.ros.ros_messages import (
        ANTENNA as ANTENNA,
        BASE as BASE,
        EARTH as EARTH,
        MAP as MAP,
        NOT_SAID as NOT_SAID,
        camera_info as camera_info,
        cloud_message as cloud_message,
        compressed_image as compressed_image,
        header_of as header_of,
        image_message as image_message,
        new as new,
        path_message as path_message,
        pose as pose,
        text as text,
        time_of as time_of,
        transform as transform,
        transforms as transforms,
        turn_left as turn_left,
        vector as vector,
    )
    from fieldgrid.recordings.ros.writers import (
        BagFolderWriter as BagFolderWriter,
        McapWriter as McapWriter,
        Ros1BagWriter as Ros1BagWriter,
    )
    from fieldgrid.recordings.stored import (
        FrameKind as FrameKind,
        PairKind as PairKind,
        Shot as Shot,
        StoredFrames as StoredFrames,
    )
    from fieldgrid.recordings.tables.columns import (
        Columns as Columns,
        columns_from_text as columns_from_text,
        epoch_s as epoch_s,
        how_to_say as how_to_say,
    )
    from fieldgrid.recordings.tables.fix_log import FixLog as FixLog
    from fieldgrid.recordings.tables.gear_file import read_gear_spans as read_gear_spans
    from fieldgrid.recordings.tables.motion_files import (
        AXES as AXES,
        R_VEHICLE_FLU as R_VEHICLE_FLU,
        MotionFiles as MotionFiles,
        MotionSeries as MotionSeries,
        check_axes as check_axes,
        gravity_unit_mps2 as gravity_unit_mps2,
        inertial_of as inertial_of,
    )
    from fieldgrid.recordings.tables.stream_log import looks_like_stream as looks_like_stream
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
