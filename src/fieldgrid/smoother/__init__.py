"""The batch estimate of a drive: position, heading, signed speed and slow errors, with sigmas."""

from fieldgrid.smoother.batch import SmoothedDrive, refine, smooth
from fieldgrid.smoother.declared import AHEAD, LATE, MOST_MISFIT, Constant, DeclaredCorrection
from fieldgrid.smoother.envelope import STATES
from fieldgrid.smoother.measurements import Measurements
from fieldgrid.smoother.slow_drift import SlowDrift, slow_drift
from fieldgrid.smoother.wander import unstated_wander, wander

__all__ = [
    "AHEAD",
    "LATE",
    "MOST_MISFIT",
    "STATES",
    "Constant",
    "DeclaredCorrection",
    "Measurements",
    "SlowDrift",
    "SmoothedDrive",
    "refine",
    "slow_drift",
    "smooth",
    "unstated_wander",
    "wander",
]
