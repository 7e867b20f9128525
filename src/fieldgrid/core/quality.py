"""The quality of a fix: one enumeration, its names, and the error that is usual for each."""

from __future__ import annotations

import re
from enum import IntEnum

from fieldgrid.core.errors import ConfigError, quoted


class Quality(IntEnum):
    """How a position was solved: the codes of the NMEA sentence GGA (9 is NovAtel's).

    `UNKNOWN` is not a code of GGA. It stands for a source that does not say: no column, an empty
    cell, a status that is "not available". A fix of unknown quality is used; one of quality
    `NONE`, which says that there is no position, is not.
    """

    UNKNOWN = -1
    NONE = 0
    GPS = 1
    DIFFERENTIAL = 2
    PPS = 3
    RTK_FIXED = 4
    RTK_FLOAT = 5
    ESTIMATED = 6
    MANUAL = 7
    SIMULATED = 8
    SBAS = 9

    @classmethod
    def of_code(cls, code: int) -> Quality:
        """The quality of a code of GGA, `UNKNOWN` for one that the standard does not have."""
        return _OF_CODE.get(code, _UNKNOWN)

    @classmethod
    def named(cls, text: str) -> Quality:
        """The quality of a name or code that a user wrote: ``rtk-fixed``, ``RTK fixed``, ``4``."""
        wanted = re.sub(r"[\s_-]+", " ", text.strip().lower())
        for quality, (label, _) in _TABLE.items():
            if wanted in (label.lower(), str(int(quality))):
                return quality
        names = ", ".join(map(str, cls))
        raise ConfigError(f"There is no quality {quoted(text)} of a fix; give one of {names}.")

    def __str__(self) -> str:
        return self.label.lower().replace(" ", "-")

    @property
    def label(self) -> str:
        """The name for people: ``RTK fixed``."""
        return _TABLE[self][0]

    @property
    def usual_sigma_m(self) -> float:
        """The 1-sigma error along one horizontal axis that such a fix usually has, metres."""
        return _TABLE[self][1]


# The name for people, and the usual 1-sigma error, metres.
_TABLE = {
    Quality.UNKNOWN: ("unknown", 1.5),  # as for GPS: nothing says that it is better
    Quality.NONE: ("none", 5.0),
    Quality.GPS: ("GPS", 1.5),
    Quality.DIFFERENTIAL: ("differential", 0.5),
    Quality.PPS: ("PPS", 0.5),
    Quality.RTK_FIXED: ("RTK fixed", 0.02),
    Quality.RTK_FLOAT: ("RTK float", 0.25),
    Quality.ESTIMATED: ("estimated", 5.0),
    Quality.MANUAL: ("manual", 5.0),
    Quality.SIMULATED: ("simulated", 5.0),
    Quality.SBAS: ("SBAS", 0.5),
}

# A log has a code a fix, and calling an enumeration takes longer than reading the field.
_UNKNOWN = Quality.UNKNOWN
_OF_CODE = {int(quality): quality for quality in Quality if quality >= 0}

CARRIER = frozenset({Quality.RTK_FIXED, Quality.RTK_FLOAT})
"""Qualities whose corrections are of the carrier phase."""

CODE = frozenset({Quality.DIFFERENTIAL, Quality.SBAS})
"""Qualities whose corrections are of the code."""

NOT_FROM_SATELLITES = frozenset(
    {Quality.NONE, Quality.ESTIMATED, Quality.MANUAL, Quality.SIMULATED}
)
"""Positions that satellites did not give, or none at all."""

CENTIMETRES_M = 0.05
"""Only carrier phases give positions as good as this."""
