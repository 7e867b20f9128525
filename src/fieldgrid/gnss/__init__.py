"""GNSS: logs to fixes, and a verdict with a written reason on every fix."""

from fieldgrid.gnss.conditioning import COUNTED_TWICE, condition
from fieldgrid.gnss.counted_twice import CountedTwice, counted_twice
from fieldgrid.gnss.gps_time import leap_seconds
from fieldgrid.gnss.nmea import NmeaLog, NmeaStream, parse_nmea
from fieldgrid.gnss.scatter import FixNoise, fix_noise, quantum_m, short_term_sigma_m
from fieldgrid.gnss.summary import ConditioningSummary, summarise
from fieldgrid.gnss.ubx import UbxParser, parse_ubx
from fieldgrid.gnss.verdict import DEFAULT_LIMITS, Gate, Verdicts

__all__ = [
    "COUNTED_TWICE",
    "DEFAULT_LIMITS",
    "ConditioningSummary",
    "CountedTwice",
    "FixNoise",
    "Gate",
    "NmeaLog",
    "NmeaStream",
    "UbxParser",
    "Verdicts",
    "condition",
    "counted_twice",
    "fix_noise",
    "leap_seconds",
    "parse_nmea",
    "parse_ubx",
    "quantum_m",
    "short_term_sigma_m",
    "summarise",
]
