"""The transform of a session: where its drive is put in the map, apart from the poses as driven."""

from __future__ import annotations

import json
import math
import struct
import sys
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from hashlib import sha256
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fieldgrid.core import ConfigError, Float64, Int64, MapError, parse_json, shortened
from fieldgrid.geometry import Bounds, Pose, Trajectory, wrap_deg
from fieldgrid.maps.writing.corrections import MOST_M, HeightCorrection, Wander

_RIGID, _WANDER, _HEIGHTS, _ALIGNED = "rigid", "wander", "heights", "aligned"

MOST_DEG = 180.0


WORSE_TIMES = 2.0
"""A pose that states more than `WORSE_TIMES` the usual error of its drive keeps that error when the
drive is aligned: the one error of the whole drive does not hold for it."""

_ROUNDING_M = 1e-6


class RelativeError(NamedTuple):
    """How sure a session lies beside another one, which may be surer than where either lies: the
    1-sigma error of the shift between them, as long as the other is where it was (`placing`)."""

    name: str
    sigma_m: float
    placing: str


@dataclass(frozen=True, slots=True)
class AlignmentRecord:
    """What a transform that was estimated rests on: its 1-sigma errors, the sessions that it was
    aligned to, and the transform that the session had before, as it was stored. The errors are None
    where the poses have been estimated anew since: it was found for others. `beside` has those of
    the sessions it was compared with. `stated_m` is the error that poses of the drive usually
    state, the median; None where it is not known."""

    sigma_m: float | None
    turn_sigma_deg: float | None
    to: tuple[str, ...]
    before: str | None = None
    beside: tuple[RelativeError, ...] = ()
    stated_m: float | None = None

    def __post_init__(self) -> None:
        own = self.sigma_m, self.turn_sigma_deg, self.stated_m
        errors = *own, *(one.sigma_m for one in self.beside)
        if not all(error is None or error >= 0.0 for error in errors):
            raise ConfigError(
                f"An alignment with the errors {self.sigma_m} m and {self.turn_sigma_deg}°, beside "
                f"others {[one.sigma_m for one in self.beside]} m, cannot be; they are numbers "
                "from 0."
            )


@dataclass(frozen=True, slots=True)
class Transform:
    """A turn about a pivot, then a shift, and what the shift wandered by meanwhile:
    placed = pivot + R(turn) · (driven - pivot) + shift + wander(time).

    Shifts are metres east and north. The turn is in degrees, clockwise seen from above like a
    heading, to which it is added. The pivot is in metres of the map, as driven. `aligned` is
    None where it was set by hand. `heights` is what is added to heights.
    """

    shift_east_m: float = 0.0
    shift_north_m: float = 0.0
    turn_deg: float = 0.0
    pivot_east_m: float = 0.0
    pivot_north_m: float = 0.0
    wander: Wander | None = None
    aligned: AlignmentRecord | None = None
    heights: HeightCorrection | None = None

    def __post_init__(self) -> None:
        for name, value in self._rigid().items():
            most = {"shift": MOST_M, "turn_": MOST_DEG}.get(name[:5], math.inf)
            if not math.isfinite(value) or abs(value) > most:
                raise ConfigError(
                    f"A transform with {name} {value} cannot be; shifts are up to {MOST_M:.0f} m, "
                    f"turns up to {MOST_DEG:.0f} degrees."
                )

    def _rigid(self) -> dict[str, float]:
        return {name: getattr(self, name) for name in _RIGID_FIELDS}

    @property
    def is_identity(self) -> bool:
        """Whether it leaves every pose as it is, bit for bit."""
        is_rigid = self.shift_east_m == self.shift_north_m == self.turn_deg == 0.0
        return is_rigid and self.wander is None and self.heights is None

    def pose(self, driven: Pose) -> Pose:
        """A pose as it is placed in the map. Only its place has another error when aligned."""
        if self.is_identity:
            return driven
        placed: dict[str, Any] = {
            name: float(value) for name, value in self._placed(driven).items()
        }
        least_sigma_m = 0.0 if self.heights is None else self.heights.least_sigma_m
        return replace(driven, **placed, up_sigma_m=max(driven.up_sigma_m, least_sigma_m))

    def trajectory(self, driven: Trajectory) -> Trajectory:
        """A trajectory as it is placed in the map."""
        return driven if self.is_identity else replace(driven, **self._placed(driven))

    def _placed(self, driven: Pose | Trajectory) -> dict[str, Any]:
        """What is another one of a pose or of poses that are placed."""
        east_m, north_m = self.points(driven.east_m, driven.north_m, driven.time_ns)
        turned, up_m = driven.heading_deg, driven.up_m
        if self.turn_deg:
            turned = wrap_deg(turned + self.turn_deg)
        if self.heights is not None:
            up_m = up_m + self.heights.at(driven.time_ns)
        return {
            "east_m": east_m,
            "north_m": north_m,
            "up_m": up_m,
            "heading_deg": turned,
            "position_sigma_m": self._sigma_m(driven.position_sigma_m),
        }

    def _sigma_m(self, driven_m: npt.ArrayLike) -> Float64:
        """The errors of places: those of the receiver, or of the alignment, which may have shown
        that the receiver states too little."""
        stated = np.asarray(driven_m, np.float64)
        aligned = self.aligned
        if aligned is None or aligned.sigma_m is None:
            return stated
        if aligned.stated_m is None:
            # So the trajectories of maps were stored that were aligned before this was known.
            return np.asarray(np.fmin(stated, aligned.sigma_m))
        is_worse = stated > max(WORSE_TIMES * aligned.stated_m, aligned.sigma_m)
        return np.where(is_worse, stated, aligned.sigma_m)

    def points(
        self, east_m: npt.ArrayLike, north_m: npt.ArrayLike, time_ns: int | Int64
    ) -> tuple[Float64, Float64]:
        """Points as driven, seen at times, as they are placed; shapes broadcast."""
        turn = math.radians(self.turn_deg)
        x = np.asarray(east_m, np.float64) - self.pivot_east_m
        y = np.asarray(north_m, np.float64) - self.pivot_north_m
        east = self.pivot_east_m + x * math.cos(turn) + y * math.sin(turn) + self.shift_east_m
        north = self.pivot_north_m - x * math.sin(turn) + y * math.cos(turn) + self.shift_north_m
        if self.wander is None:
            return east, north
        wander_east, wander_north = self.wander.at(time_ns)
        return east + wander_east, north + wander_north

    def driven(self, placed: Bounds) -> Bounds:
        """A rectangle that holds every place, as driven, that is placed in this one."""
        if self.is_identity:
            return placed
        wander = self.wander or Wander((0,), (0.0,), (0.0,))
        turn = math.radians(self.turn_deg)
        origin_east_m = self.pivot_east_m + self.shift_east_m
        origin_north_m = self.pivot_north_m + self.shift_north_m
        corners = [
            (x * math.cos(turn) - y * math.sin(turn), x * math.sin(turn) + y * math.cos(turn))
            for x in (
                placed.west_m - max(wander.east_m) - origin_east_m,
                placed.east_m - min(wander.east_m) - origin_east_m,
            )
            for y in (
                placed.south_m - max(wander.north_m) - origin_north_m,
                placed.north_m - min(wander.north_m) - origin_north_m,
            )
        ]
        east, north = zip(*corners, strict=True)
        return Bounds(
            self.pivot_east_m + min(east) - _ROUNDING_M,
            self.pivot_north_m + min(north) - _ROUNDING_M,
            self.pivot_east_m + max(east) + _ROUNDING_M,
            self.pivot_north_m + max(north) + _ROUNDING_M,
        )

    def speaking_of(
        self, names: Mapping[str, str], placings: Mapping[str, str] | None = None
    ) -> Transform:
        """The transform with new names of the other sessions that it names, and with new digests of
        where they lie, which change with the plane."""
        if self.aligned is None:
            return self
        others = tuple(names.get(one, one) for one in self.aligned.to)
        beside = tuple(
            one._replace(
                name=names.get(one.name, one.name),
                placing=(placings or {}).get(one.placing, one.placing),
            )
            for one in self.aligned.beside
        )
        return replace(self, aligned=replace(self.aligned, to=others, beside=beside))

    def to_text(self) -> str | None:
        """As it is stored: None for the identity, else a JSON object by the kind of transform."""
        if self.is_identity and self.aligned is None:
            return None
        kinds: dict[str, object] = {_RIGID: self._rigid()}
        for name, part in ((_WANDER, self.wander), (_HEIGHTS, self.heights)):
            if part is not None:
                kinds[name] = asdict(part)
        if self.aligned is not None:
            beside = [one._asdict() for one in self.aligned.beside]
            kinds[_ALIGNED] = asdict(self.aligned) | {"beside": beside}
        return json.dumps(kinds)


def placing(transform: Transform, driven: Iterable[Pose]) -> str:
    """Tells whether a session still lies where it did: a digest of its accepted poses as driven and
    of where the transform puts them."""
    found = sha256((replace(transform, aligned=None).to_text() or "").encode())
    for pose in driven:
        found.update(struct.pack("<q3d", pose.time_ns, pose.east_m, pose.north_m, pose.heading_deg))
    return found.hexdigest()[:16]


_RIGID_FIELDS = (
    "shift_east_m", "shift_north_m", "turn_deg", "pivot_east_m", "pivot_north_m",
)  # fmt: skip

IDENTITY = Transform()


@lru_cache(maxsize=64)
def transform_of(text: str | None) -> Transform:
    """A transform as it was stored; MapError for one that this version does not know."""
    if text is None:
        return IDENTITY
    try:
        kinds = parse_json(text)
        unknown = sorted(set(kinds) - {_RIGID, _WANDER, _HEIGHTS, _ALIGNED})
        if unknown or _RIGID not in kinds:
            raise MapError(
                f"A session's transform has {shortened(', '.join(unknown)) or 'no rigid part'}, "
                f"and this fieldgrid knows {_RIGID}, {_WANDER}, {_HEIGHTS} and {_ALIGNED}; update "
                "fieldgrid to read it."
            )
        rigid, wander, heights, aligned = (
            kinds.get(name) for name in (_RIGID, _WANDER, _HEIGHTS, _ALIGNED)
        )
        if set(rigid) != set(_RIGID_FIELDS):
            raise TypeError(f"it says {shortened(rigid)}")
        parts: dict[str, Any] = {name: _number(value) for name, value in rigid.items()}
        if wander is not None:
            parts["wander"] = Wander(*_series(wander, "east_m", "north_m"))
        if heights is not None:
            times, up_m = _series(heights, "up_m")
            parts["heights"] = HeightCorrection(times, up_m, _number(heights["least_sigma_m"]))
        if aligned is not None:
            parts["aligned"] = _aligned(aligned)
        return Transform(**parts)
    except (TypeError, ValueError, KeyError, AttributeError, ConfigError) as error:
        if isinstance(error, MapError):
            raise
        raise MapError(f"A session's transform is damaged: {str(error).rstrip('.')}.") from error


def _number(value: Any) -> Any:
    """A number, as it is stored; TypeError for anything else."""
    # JSON has truth values, which are whole numbers, and whole numbers beyond what floats can be.
    if not isinstance(value, int | float) or value is True or value is False:
        raise TypeError(f"{shortened(value)} is no number")
    if not abs(value) <= sys.float_info.max:
        raise TypeError(f"{shortened(value)} is no number that can be")
    return value


def _series(stored: Mapping[str, Any], *names: str) -> list[tuple[Any, ...]]:
    """The times of a correction, and what it says of them."""
    times = tuple(stored["time_ns"])
    if not all(type(time) is int for time in times):
        raise TypeError("its times are no whole numbers")
    return [times, *(tuple(map(_number, stored[name])) for name in names)]


def _aligned(stored: Mapping[str, Any]) -> AlignmentRecord:
    # Maps that were aligned before these were kept have no errors beside others, and none stated.
    sigma_m, turn_sigma_deg, stated_m = (
        None if stored.get(name) is None else _number(stored[name])
        for name in ("sigma_m", "turn_sigma_deg", "stated_m")
    )
    beside = tuple(
        RelativeError(str(one["name"]), _number(one["sigma_m"]), str(one["placing"]))
        for one in stored.get("beside", ())
    )
    if not isinstance(stored["before"], str | None):
        raise TypeError("what it was before is no text")
    to = tuple(str(name) for name in stored["to"])
    return AlignmentRecord(sigma_m, turn_sigma_deg, to, stored["before"], beside, stated_m)
