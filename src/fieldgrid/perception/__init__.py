"""Perception: a frame becomes its local grid, its ground and its camera step; no pose is needed.

* `rectify`: raw pairs to rectified ones; `stereo`: `StereoMatcher`, pairs to disparities.
* `depth`, `cloud`, `sweep`: depth images, points, and lidar sweeps of a moving vehicle.
* `localgrid`: `LocalGridder`, the core step: match, ground, slice, count, scale to 0-255.
* `ground`, `edges`, `standing`, `frame_ground`: plane and heights, steps, what stands.
* `binning`: points to counts of cells; `vertical`: rows of a pair that do not match.
* `odometry`: `features` of a frame and the `step` from one frame to the next.

It reads no files, and places nothing on Earth.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fieldgrid.core.doors import door

if TYPE_CHECKING:
    from fieldgrid.perception.cloud import points_per_sr as points_per_sr
    from fieldgrid.perception.depth import CodedDepth as CodedDepth
    from fieldgrid.perception.frame_ground import FrameGround as FrameGround
    from fieldgrid.perception.ground import LOW_SHARE as LOW_SHARE, MIN_SAMPLES as MIN_SAMPLES
    from fieldgrid.perception.localgrid import (
        LocalGridder as LocalGridder,
        reliable_range_m as reliable_range_m,
    )
    from fieldgrid.perception.odometry.corners import Features as Features, features as features
    from fieldgrid.perception.odometry.rigid import RigidMotion as RigidMotion
    from fieldgrid.perception.odometry.steps import (
        CameraStep as CameraStep,
        Refusal as Refusal,
        camera_motion as camera_motion,
        step as step,
        steps_of as steps_of,
    )
    from fieldgrid.perception.rectify import (
        Rectification as Rectification,
        Rectifier as Rectifier,
        camera_from_projections as camera_from_projections,
        is_rotation as is_rotation,
        rectify_by_pose as rectify_by_pose,
        rectify_by_projections as rectify_by_projections,
    )
    from fieldgrid.perception.stereo import (
        EXPOSURE_RATIO as EXPOSURE_RATIO,
        SUBPIXELS as SUBPIXELS,
        StereoMatcher as StereoMatcher,
        whole_image as whole_image,
    )
    from fieldgrid.perception.sweep import (
        FEWEST_TIMES as FEWEST_TIMES,
        LONGEST_S as LONGEST_S,
        TIME_FIELDS as TIME_FIELDS,
        OriginTrack as OriginTrack,
        RawSweep as RawSweep,
        Sweep as Sweep,
        seconds_after as seconds_after,
    )
    from fieldgrid.perception.vertical import (
        SHIFT_ERROR_PX as SHIFT_ERROR_PX,
        Misalignment as Misalignment,
        drive_misalignment as drive_misalignment,
        shift_px as shift_px,
        vertical_shifts as vertical_shifts,
    )
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
