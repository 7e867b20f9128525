"""The rig: what looks at the field, how it is mounted, and where the antenna sits.

Vehicle frame: x right, y forward, z up, metres. Its origin is the *grid origin*: the point of
the ground right below the sensor, when the vehicle stands level. Of a stereo camera that is
the middle of its baseline, of a depth camera its optical centre, of a lidar the origin of its
points. Sensor frame (optical, of a lidar too): x right, y down, z forward.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal, Protocol, get_args

import numpy as np
import numpy.typing as npt

from fieldgrid.core import CalibrationError, Float64, quoted
from fieldgrid.geometry.angles import wrap_deg

HeadingConvention = Literal["cw_north", "ccw_east"]
"""What a recorded heading counts from, and which way."""


@dataclass(frozen=True, slots=True)
class StereoCamera:
    """A rectified pair: both images share rows, one focal length and one orientation.

    Depth is z = f·b / (d - d0), with the disparity d = u_left - u_right and
    d0 = cx - cx_right (0 in most rectifications). Pixel (0, 0) is the centre of the upper
    left pixel.
    """

    width_px: int
    height_px: int
    focal_px: float
    cx_px: float
    cy_px: float
    baseline_m: float
    cx_right_px: float | None = None

    def __post_init__(self) -> None:
        _check_size(self.width_px, self.height_px)
        _check_focal(self.focal_px, self.width_px)
        _check_baseline(self.baseline_m)
        _check_principal("cx", self.cx_px, self.width_px)
        right_px = self.cx_px if self.cx_right_px is None else self.cx_right_px
        _check_principal("cx of the right camera", right_px, self.width_px)
        _check_principal("cy", self.cy_px, self.height_px)

    @property
    def disparity_offset_px(self) -> float:
        """d0: the disparity of a point at infinity."""
        return 0.0 if self.cx_right_px is None else self.cx_px - self.cx_right_px

    @property
    def focal_baseline_px_m(self) -> float:
        """f·b, so that depth = f·b / disparity."""
        return self.focal_px * self.baseline_m

    def range_sigma_m(self, range_m: npt.ArrayLike, disparity_sigma_px: float) -> Float64:
        """1-sigma error of a range in metres: R²·sigma_d / (f·b)."""
        r = np.asarray(range_m, dtype=np.float64)
        return r * r * disparity_sigma_px / self.focal_baseline_px_m


@dataclass(frozen=True, slots=True)
class DepthCamera:
    """A camera that gives each pixel a depth along its optical axis, in metres.

    `baseline_m` is that of the pair that the depths come from, None where they come from
    something else or nobody says: then their error with range is not known. Pixel (0, 0) is
    the centre of the upper left pixel.
    """

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    baseline_m: float | None = None

    def __post_init__(self) -> None:
        _check_size(self.width_px, self.height_px)
        for focal_px in (self.fx_px, self.fy_px):
            _check_focal(focal_px, self.width_px)
        if self.baseline_m is not None:
            _check_baseline(self.baseline_m)
        _check_principal("cx", self.cx_px, self.width_px)
        _check_principal("cy", self.cy_px, self.height_px)


@dataclass(frozen=True, slots=True)
class Lidar:
    """A sensor that gives points; `points_per_sr` of them in a steradian of what it looks at."""

    points_per_sr: float

    def __post_init__(self) -> None:
        if not 1.0 <= self.points_per_sr <= 1e9:
            raise CalibrationError(
                f"A lidar with {self.points_per_sr} points in a steradian is outside 1..1e9; "
                "count the points of one sweep."
            )


Sensor = StereoCamera | DepthCamera | Lidar
"""What looks at the field."""


def _check_size(width_px: int, height_px: int) -> None:
    if not (16 <= width_px <= 20_000 and 16 <= height_px <= 20_000):
        raise CalibrationError(
            f"The calibration is for images of {width_px} x {height_px} px, which "
            "no camera makes; check image_width and image_height."
        )


def _check_focal(focal_px: float, width_px: int) -> None:
    if not (math.isfinite(focal_px) and 0.1 < focal_px / width_px < 100.0):
        raise CalibrationError(
            f"A focal length of {focal_px} px does not fit images {width_px} px "
            "wide; give it in pixels of the rectified image."
        )


def _check_baseline(baseline_m: float) -> None:
    if not (math.isfinite(baseline_m) and 0.005 <= baseline_m <= 10.0):
        raise CalibrationError(
            f"A stereo baseline of {baseline_m} m is outside 0.005..10 m; the right "
            "camera's P[3] is -f·b, so a wrong sign or unit there shows here."
        )


def _check_principal(name: str, value_px: float, size_px: int) -> None:
    if not (math.isfinite(value_px) and -size_px < value_px < 2 * size_px):
        raise CalibrationError(
            f"The principal point {name} = {value_px} px lies far outside the image of "
            f"{size_px} px; check the projection matrix."
        )


@dataclass(frozen=True, slots=True)
class Mount:
    """How the camera sits on the level vehicle.

    `height_m` above the ground; `tilt_deg` down from the horizon; `roll_deg` positive when the
    right side is down; `yaw_deg` positive when the camera looks to the right of the nose.
    """

    height_m: float
    tilt_deg: float
    roll_deg: float = 0.0
    yaw_deg: float = 0.0

    def __post_init__(self) -> None:
        if not 0.1 <= self.height_m <= 10.0:
            raise CalibrationError(
                f"A camera height of {self.height_m} m above ground is outside 0.1..10 m; "
                "correct the mounting."
            )
        if not -10.0 <= self.tilt_deg <= 75.0:
            raise CalibrationError(
                f"A camera tilt of {self.tilt_deg}° is outside -10..75° (down is positive); "
                "correct the mounting."
            )
        if not (abs(self.roll_deg) <= 20.0 and abs(self.yaw_deg) <= 45.0):
            raise CalibrationError(
                f"A camera roll of {self.roll_deg}° or yaw of {self.yaw_deg}° is beyond 20° "
                "or 45°; correct the mounting."
            )

    def rotation(self) -> Float64:
        """R_vehicle_camera, 3 x 3: a direction of the camera frame in the vehicle frame.

        For roll = yaw = 0: x = x_c; y = z_c·cos(tilt) - y_c·sin(tilt);
        z = -z_c·sin(tilt) - y_c·cos(tilt).
        """
        tilt, roll, yaw = (math.radians(v) for v in (self.tilt_deg, self.roll_deg, self.yaw_deg))
        tilted = np.array(
            [
                [1.0, 0.0, 0.0],
                [0.0, -math.sin(tilt), math.cos(tilt)],
                [0.0, -math.cos(tilt), -math.sin(tilt)],
            ]
        )
        # Roll about the forward axis (right side down), then yaw about the vertical (clockwise).
        rolled = np.array(
            [
                [math.cos(roll), 0.0, math.sin(roll)],
                [0.0, 1.0, 0.0],
                [-math.sin(roll), 0.0, math.cos(roll)],
            ]
        )
        yawed = np.array(
            [
                [math.cos(yaw), math.sin(yaw), 0.0],
                [-math.sin(yaw), math.cos(yaw), 0.0],
                [0.0, 0.0, 1.0],
            ]
        )
        rotation: Float64 = yawed @ rolled @ tilted
        return rotation


@dataclass(frozen=True, slots=True)
class LeverArm:
    """A point of the vehicle in the vehicle frame: metres right, forward, up of the grid origin."""

    right_m: float
    forward_m: float
    up_m: float

    def __post_init__(self) -> None:
        values = (self.right_m, self.forward_m, self.up_m)
        if not all(math.isfinite(v) and abs(v) <= 30.0 for v in values):
            raise CalibrationError(
                f"A lever arm of {values} m (right, forward, up) is beyond 30 m; give metres "
                "from the middle of the stereo baseline."
            )


class VehicleGeometry(Protocol):
    """What of a vehicle decides its poses: a :class:`Rig`, or a :class:`Carrier` without camera."""

    @property
    def antenna(self) -> LeverArm:
        """The phase centre of the GNSS antenna."""

    @property
    def rear_axle_forward_m(self) -> float | None:
        """Forward coordinate of the axle that does not steer; None when it is not known."""

    @property
    def heading_offset_deg(self) -> float | None:
        """What a recorded heading has more than the nose; None when nothing is said about it."""

    @property
    def heading_convention(self) -> HeadingConvention:
        """How a recorded heading is counted."""


def nose_heading_deg(vehicle: VehicleGeometry, recorded_deg: npt.ArrayLike) -> Float64:
    """Headings of the nose, by the declared convention and offset, of recorded ones."""
    recorded = np.asarray(recorded_deg, dtype=np.float64)
    clockwise = recorded if vehicle.heading_convention == "cw_north" else 90.0 - recorded
    return wrap_deg(clockwise - (vehicle.heading_offset_deg or 0.0))


@dataclass(frozen=True, slots=True)
class Carrier:
    """The vehicle of a log alone: its poses are those of the antenna, which is `ahead_m` of the
    axle that does not steer, None where nobody knows. Recorded headings as in :class:`Rig`."""

    ahead_m: float | None = None
    heading_offset_deg: float | None = None
    heading_convention: HeadingConvention = "cw_north"

    def __post_init__(self) -> None:
        if self.ahead_m is not None and not abs(self.ahead_m) <= 30.0:
            raise CalibrationError(
                f"An antenna {self.ahead_m} m ahead of the axle is beyond 30 m; give metres."
            )
        check_offset(self.heading_offset_deg)

    @property
    def antenna(self) -> LeverArm:
        """The origin, at no known height."""
        return LeverArm(0.0, 0.0, 0.0)

    @property
    def rear_axle_forward_m(self) -> float | None:
        """The axle lies behind the antenna."""
        return None if self.ahead_m is None else -self.ahead_m


def with_antenna_ahead(vehicle: VehicleGeometry | None, ahead_m: float) -> Rig | Carrier:
    """The vehicle with its axle `ahead_m` behind the antenna; None is a log alone."""
    if isinstance(vehicle, Rig):
        return replace(vehicle, rear_axle_forward_m=vehicle.antenna.forward_m - ahead_m)
    return replace(vehicle, ahead_m=ahead_m) if isinstance(vehicle, Carrier) else Carrier(ahead_m)


def check_offset(offset_deg: float | None) -> None:
    """Raise CalibrationError for an offset of a recorded heading that cannot be."""
    if offset_deg is not None and not abs(offset_deg) <= 360.0:
        raise CalibrationError(
            f"A heading offset of {offset_deg}° is beyond 360°; give degrees clockwise from the "
            "nose to what the receiver calls its heading."
        )


# Maps of stereo drives have always had "camera".
_SENSOR_KEYS: dict[str, type[StereoCamera] | type[DepthCamera] | type[Lidar]] = {
    "camera": StereoCamera,
    "depth_camera": DepthCamera,
    "lidar": Lidar,
}


@dataclass(frozen=True, slots=True)
class Rig:
    """Everything about the vehicle that does not change during a drive.

    `mount` is how the sensor sits, whatever it is. `antenna` is the phase centre of the GNSS
    antenna. `rear_axle_forward_m` is the forward coordinate of the axle that does not steer, where
    course and heading agree; None when it is not known. `image_time_offset_ns` is added to image
    time stamps to give GNSS time.

    `heading_offset_deg` is what a recorded heading has more than the nose, clockwise: 90 for a
    baseline from left to right antenna; None when nothing is said about it.
    `heading_convention` is that of the recorded heading, before the offset.
    """

    sensor: Sensor
    mount: Mount
    antenna: LeverArm
    rear_axle_forward_m: float | None = None
    image_time_offset_ns: int = 0
    heading_offset_deg: float | None = None
    heading_convention: HeadingConvention = "cw_north"

    def __post_init__(self) -> None:
        check_offset(self.heading_offset_deg)
        axle_m = self.rear_axle_forward_m
        if axle_m is not None and not abs(axle_m) <= 30.0:
            raise CalibrationError(
                f"An axle {axle_m} m ahead of the camera is beyond 30 m; give metres."
            )
        if self.heading_convention not in get_args(HeadingConvention):
            raise CalibrationError(
                f"The heading convention {quoted(self.heading_convention)} is not known; give one "
                f"of {', '.join(get_args(HeadingConvention))}."
            )

    def as_dict(self) -> dict[str, Any]:
        """Plain values; the sensor stands under a key that says which kind it is."""
        values = asdict(self)
        (kind,) = (key for key, sensor in _SENSOR_KEYS.items() if type(self.sensor) is sensor)
        return {kind: values.pop("sensor"), **values}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Rig:
        """The rig of such values; CalibrationError for what describes none."""
        try:
            rest = dict(values)
            (kind,) = rest.keys() & _SENSOR_KEYS.keys()
            sensor: Sensor = _SENSOR_KEYS[kind](**rest.pop(kind))
            return cls(sensor, Mount(**rest.pop("mount")), LeverArm(**rest.pop("antenna")), **rest)
        except (LookupError, TypeError, ValueError) as error:
            raise CalibrationError(f"This is no rig: {error}; give that of the drive.") from error

    @property
    def camera(self) -> StereoCamera:
        """The stereo camera; CalibrationError for a rig that has another sensor."""
        if isinstance(self.sensor, StereoCamera):
            return self.sensor
        raise self._other_sensor("a stereo pair")

    @property
    def depth_camera(self) -> DepthCamera:
        """The depth camera; CalibrationError for a rig that has another sensor."""
        if isinstance(self.sensor, DepthCamera):
            return self.sensor
        raise self._other_sensor("images of depths")

    def _other_sensor(self, wanted: str) -> CalibrationError:
        return CalibrationError(
            f"This needs {wanted}, and the rig has a {type(self.sensor).__name__}; leave it out "
            "for this drive."
        )
