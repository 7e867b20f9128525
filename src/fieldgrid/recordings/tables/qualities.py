"""The quality of a fix as loggers write it, in words and numbers."""

from __future__ import annotations

import re

from fieldgrid.core import Quality

# The first that occurs in the text decides, so that "RTK float" is not "RTK".
_WORDS: tuple[tuple[str, Quality], ...] = (
    (
        r"no[ _-]?(gps|gnss)?[ _-]?(fix|solution|position)|invalid|unavailable",
        Quality.NONE,
    ),
    (r"^unknown$|not[ _]available|^n/?a$|^nan$|^null$", Quality.UNKNOWN),
    (r"float|narrow_float|l1_float", Quality.RTK_FLOAT),
    (r"dgps|dgnss|differential|diff|psrdiff", Quality.DIFFERENTIAL),
    (r"sbas|waas|egnos|omnistar", Quality.SBAS),
    (r"ppp|converg", Quality.DIFFERENTIAL),
    (r"dead|estimat|extrapolat|\bdr\b", Quality.ESTIMATED),
    (r"simul", Quality.SIMULATED),
    (r"manual", Quality.MANUAL),
    (r"pps|precise", Quality.PPS),
    (r"[23] ?d", Quality.GPS),
    (r"gps[ _-]?fix|gnss[ _-]?fix|^gps$|^gnss$", Quality.GPS),
    (r"single|autonomous|\bsps\b|stand-?alone", Quality.GPS),
    (r"fix|rtk|integer|narrow_int|\bint\b|^r$", Quality.RTK_FIXED),
    (r"^none$|^0$|^no$", Quality.NONE),
)
_PATTERNS = tuple((re.compile(pattern), quality) for pattern, quality in _WORDS)
_NUMBER = re.compile(r"\d{1,2}(?:\.0*)?", re.ASCII)

_WORST_FIRST = (
    Quality.NONE,
    Quality.MANUAL,
    Quality.SIMULATED,
    Quality.ESTIMATED,
    Quality.UNKNOWN,
    Quality.GPS,
    Quality.SBAS,
    Quality.DIFFERENTIAL,
    Quality.PPS,
    Quality.RTK_FLOAT,
    Quality.RTK_FIXED,
)
_POSITION_STATUS_NOT_AVAILABLE = 15  # ISO 11783-10: the receiver does not say


def read_quality(cell: str, *, numbers_are_gga: bool) -> Quality | None:
    """The quality of a number or of words like "RTK Fixed", None for what cannot be understood. Of
    a list it is the worst that it names; of an empty cell, which says nothing, `UNKNOWN`.

    `numbers_are_gga` is false for columns whose numbers mean something else everywhere.
    """
    text = cell.strip().lower()
    items = [item.strip(" '\"") for item in text.strip("[]()").split(",")]
    if len(items) > 1:
        found = [read_quality(item, numbers_are_gga=numbers_are_gga) for item in items if item]
        return min((q for q in found if q is not None), key=_WORST_FIRST.index, default=None)
    text = items[0]
    if not text:
        return Quality.UNKNOWN
    if _NUMBER.fullmatch(text):
        quality = Quality.of_code(int(float(text))) if numbers_are_gga else Quality.UNKNOWN
        return None if quality is Quality.UNKNOWN else quality
    return next((quality for pattern, quality in _PATTERNS if pattern.search(text)), None)


def from_position_status(status: int) -> Quality:
    """The quality of an ISO 11783-10 position status."""
    if status == _POSITION_STATUS_NOT_AVAILABLE:
        return Quality.UNKNOWN
    return Quality(status) if status <= Quality.SIMULATED else Quality.NONE
