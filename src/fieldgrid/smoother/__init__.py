"""The batch estimate of a drive: position, heading, signed speed and gyro bias, with sigmas."""

from fieldgrid.smoother.batch import Sightings, Smoothed, smooth
from fieldgrid.smoother.model import STATES

__all__ = ["STATES", "Sightings", "Smoothed", "smooth"]
