"""GNSS: logs to fixes, and a verdict with a written reason on every fix."""

from fieldgrid.gnss.conditioning import DEFAULT_LIMITS, GateLimits, Verdict, condition
from fieldgrid.gnss.fix import QUALITY_NAMES, Fix, position_sigma_m
from fieldgrid.gnss.nmea import NmeaLog, parse_nmea

__all__ = [
    "DEFAULT_LIMITS",
    "QUALITY_NAMES",
    "Fix",
    "GateLimits",
    "NmeaLog",
    "Verdict",
    "condition",
    "parse_nmea",
    "position_sigma_m",
]
