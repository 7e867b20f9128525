"""Forward or reverse, from the track."""

from fieldgrid.gear.legs import GearEvidence, Gears, gears, turning_deg

__all__ = ["GearEvidence", "Gears", "gears", "turning_deg"]
