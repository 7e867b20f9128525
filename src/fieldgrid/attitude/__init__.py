"""Roll and pitch against gravity, from accelerometer, gyro, camera and the climb of the fixes."""

from fieldgrid.attitude.attitude import Attitude
from fieldgrid.attitude.axes import ORIENTATION, AxisTilt, axes_of_fixes, axes_of_orientation
from fieldgrid.attitude.estimate import estimate_attitude
from fieldgrid.attitude.measurements import AntennaTrack, KnownHeadings

__all__ = [
    "ORIENTATION",
    "AntennaTrack",
    "Attitude",
    "AxisTilt",
    "KnownHeadings",
    "axes_of_fixes",
    "axes_of_orientation",
    "estimate_attitude",
]
