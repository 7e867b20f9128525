"""Every error that fieldgrid raises on purpose.

The message of each is one sentence that says what is wrong, quotes the value, and says
what to do next::

    FieldgridError
    ├── ConfigError        (ValueError)   a setting that cannot be
    ├── RecordingError     (ValueError)   a recording that is missing something or unreadable
    │   ├── CalibrationError              a rig that cannot be, or does not fit the images
    │   │   └── LackingError              several of these at once, in the order to mend them
    │   ├── NoFramesError                 a drive without frames where they are needed
    │   └── LimitError                    an input that unfolds to more than it may
    ├── GnssError          (ValueError)   no usable fix, or no fix where the images are
    ├── ClusterError       (RuntimeError) a Dask cluster that is not there, or cannot do the work
    ├── NoRouteError                      no way from start to goal, and where it is blocked
    ├── DatumError         (ValueError)   a position that does not belong to this datum
    ├── MapError           (ValueError)   a map file that is foreign, damaged or too new
    │   ├── MapExistsError (FileExistsError)
    │   └── MapWriteError  (OSError)      disk full, read-only, locked
    └── TruthError         (ValueError)   a truth folder that cannot be evaluated against
"""

from __future__ import annotations


class FieldgridError(Exception):
    """The root: catching it catches everything that fieldgrid raises on purpose."""


class ConfigError(FieldgridError, ValueError):
    """A setting that cannot be: unknown, out of range, or in conflict with another."""


class RecordingError(FieldgridError, ValueError):
    """A recording that is missing something, or holds something unreadable."""


class CalibrationError(RecordingError):
    """A calibration or mounting that cannot be, or does not fit the images."""


class LackingError(CalibrationError):
    """Several things that a recording lacks, each an error of its own in `problems`, in the order
    in which a user can mend them."""

    def __init__(self, *problems: FieldgridError) -> None:
        parts = [one.problems if isinstance(one, LackingError) else (one,) for one in problems]
        self.problems: tuple[FieldgridError, ...] = tuple(one for part in parts for one in part)
        super().__init__(*self.problems)

    def __str__(self) -> str:
        return " Also: ".join(map(str, self.problems))


class NoFramesError(RecordingError):
    """A drive that has no frames, where they are needed."""


class LimitError(RecordingError):
    """An input that unfolds to more than it may; see `core.input_limits`."""


class GnssError(FieldgridError, ValueError):
    """No usable fix, or none at the time of the images."""


class ClusterError(FieldgridError, RuntimeError):
    """A Dask cluster that cannot be reached, or whose workers cannot do the work."""


class NoRouteError(FieldgridError):
    """There is no way that the vehicle can drive; `east_m` and `north_m` say where it is blocked,
    metres of the map."""

    def __init__(self, reason: str, east_m: float, north_m: float, remedy: str) -> None:
        super().__init__(f"{reason} at {east_m:.2f},{north_m:.2f}; {remedy}.")
        self.reason = reason
        self.east_m = east_m
        self.north_m = north_m


class DatumError(FieldgridError, ValueError):
    """A datum that cannot be, or a position that does not belong to it."""


class MapError(FieldgridError, ValueError):
    """A map file that is foreign, damaged, or of a newer format."""


class MapExistsError(MapError, FileExistsError):
    """The output exists already, and nothing said that it may be replaced."""


class MapWriteError(MapError, OSError):
    """The map could not be written: disk full, read-only, or locked by another writer."""


class TruthError(FieldgridError, ValueError):
    """A truth folder that a map cannot be evaluated against."""


def counted(number: int, noun: str) -> str:
    """The number and the noun, in the plural where that is right."""
    ending = "" if number == 1 else "es" if noun.endswith("x") else "s"
    return f"{number} {noun}{ending}"


def printable(text: str) -> str:
    """A text with escapes for what is not to be printed, and what XML cannot hold, as in names of
    files."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


def shortened(value: object, most: int = 200) -> str:
    """What a library says, on one line, of bounded length and with escapes for what is not to be
    printed."""
    text = " ".join(str(value).split())
    text = text if len(text) <= most else f"{text[:most]}..."
    return printable(text)


def quoted(value: object, most: int = 60) -> str:
    """A value of an input as messages quote it: short, and with escapes for what is not to be
    printed, like control characters and bytes that are no text."""
    text = str(value)
    return repr(text if len(text) <= most else f"{text[:most]}...")
