"""Roll and pitch against gravity, from accelerometer, gyro, camera and the climb of the fixes."""

from fieldgrid.attitude.estimate import Attitude, estimate_attitude
from fieldgrid.attitude.measurements import Track

__all__ = ["Attitude", "Track", "estimate_attitude"]
