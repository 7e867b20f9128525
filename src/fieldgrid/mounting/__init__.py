"""How a sensor is mounted on its vehicle, estimated from a drive and beside what was stated."""

from fieldgrid.measured import MeasuredValue
from fieldgrid.mounting.estimate import MountEstimate, estimate_mount
from fieldgrid.mounting.writing import write_estimate

__all__ = ["MeasuredValue", "MountEstimate", "estimate_mount", "write_estimate"]
