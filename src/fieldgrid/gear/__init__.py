"""Forward or reverse, from the track."""

from fieldgrid.gear.legs import Gears, Track, gears, turning_deg

__all__ = ["Gears", "Track", "gears", "turning_deg"]
