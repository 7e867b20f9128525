"""The fixes of a log as columns, and one of them as a row."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple, Self, overload

import numpy as np
import numpy.typing as npt

from fieldgrid.core import CENTIMETRES_M, AnyArray, Bool, Float64, GnssError, Int64, Quality

# How sure fixes are, by their quality and by what the receiver states.


_LEAST_SIGMA_M = 0.01
_USUAL_SHARE = 0.1
_LEAST_SHARE, _LEAST_FIXED_M = 0.5, 0.015
_SIGMA_OF_CODE = np.array([q.usual_sigma_m for q in sorted(Quality)])


def position_sigma_m(quality: npt.ArrayLike, sigma_m: npt.ArrayLike) -> Float64:
    """1-sigma error along one horizontal axis, metres, of fixes by their quality and the sigma
    that the receiver states (NaN, 0 or less: none); shapes broadcast.

    The stated figure when there is one, else what is usual for the quality. The stated one is not
    believed below a tenth of the usual (of a quality that is known), nor below 1 cm: drivers that
    write millimetres for metres exist. A large figure is always believed.
    """
    code = np.asarray(quality, dtype=np.int64)
    stated = np.asarray(sigma_m, dtype=np.float64)
    usual = _SIGMA_OF_CODE[code - Quality.UNKNOWN]
    floor = np.where(code == Quality.UNKNOWN, 0.0, _USUAL_SHARE * usual)
    known = np.isfinite(stated) & (stated > 0.0)
    believed = np.maximum(np.where(known, stated, 0.0), np.maximum(floor, _LEAST_SIGMA_M))
    return np.where(known, believed, usual)


def least_sigma_m(quality: npt.ArrayLike) -> Float64:
    """The least 1-sigma error along one horizontal axis, metres, that positions of each quality
    have, whatever was stated: half of what is usual for it, 1.5 cm of RTK with fixed ambiguities
    (8 to 10 mm and 1 ppm of the way to the base, which is what data sheets promise of an antenna
    under open sky, and echoes from trees and machine), 0 of unknown quality.

    A receiver computes its figure from the scatter of what it measures, which the slow errors of
    orbits, clocks, air, echoes and of a float solution's waves do not enter.
    """
    code = np.asarray(quality, dtype=np.int64)
    least = _LEAST_SHARE * _SIGMA_OF_CODE[code - Quality.UNKNOWN]
    least = np.where(code == Quality.RTK_FIXED, _LEAST_FIXED_M, least)
    return np.where(code == Quality.UNKNOWN, 0.0, least)


def known_codes(codes: npt.ArrayLike) -> Int64:
    """Codes of GGA, those that the standard does not have as `UNKNOWN`."""
    given = np.asarray(codes, dtype=np.int64)
    possible = (given >= Quality.NONE) & (given <= Quality.SBAS)
    return np.where(possible, given, np.int64(Quality.UNKNOWN))


def quality_by_sigma(sigma_m: npt.ArrayLike) -> Int64:
    """Quality codes of fixes of which only the stated error is known: centimetres need carrier
    phases, and nothing else follows from a figure."""
    sigma = np.asarray(sigma_m, dtype=np.float64)
    fixed = (sigma > 0.0) & (sigma <= CENTIMETRES_M)
    return np.where(fixed, Quality.RTK_FIXED, Quality.UNKNOWN).astype(np.int64)


NOT_SAID = -1
"""Stands among integers, which have no NaN, for what a source does not say."""


class Fix(NamedTuple):
    """One recorded position of the antenna; what the receiver did not say is None.

    The fields are those of :class:`FixColumns`.
    """

    time_ns: int
    lat_deg: float
    lon_deg: float
    height_m: float
    quality: Quality = Quality.UNKNOWN
    satellites: int | None = None
    hdop: float | None = None
    age_s: float | None = None
    sigma_m: float | None = None
    speed_mps: float | None = None
    heading_deg: float | None = None
    heading_sigma_deg: float | None = None
    heading_quality: Quality | None = None
    course_deg: float | None = None
    pitch_deg: float | None = None
    roll_deg: float | None = None
    tilt_sigma_deg: float | None = None
    stamp_sigma_s: float | None = None

    @property
    def position_sigma_m(self) -> float:
        """See :func:`position_sigma_m`."""
        stated = np.nan if self.sigma_m is None else self.sigma_m
        return float(position_sigma_m(self.quality, stated))


_INTEGERS = frozenset({"time_ns", "quality", "satellites", "heading_quality"})
_QUALITIES = frozenset({"quality", "heading_quality"})
_CODES = np.array(list(Quality))
_REQUIRED = Fix._fields[:4]


@dataclass(frozen=True, slots=True, eq=False)
class FixColumns:
    """n positions of the antenna in the order of their log: what readers make of a log, and what
    poses are estimated from.

    `time_ns` is UTC. `height_m` is ellipsoidal (altitude + geoid separation). `quality` are codes
    of :class:`Quality`. `age_s` is that of the differential correction. `sigma_m` is the
    receiver's own 1-sigma error along one horizontal axis. `heading_deg` is a recorded heading of
    the vehicle (two antennas, INS), never the course; `heading_quality` is that of the baseline
    between the antennas. `course_deg` is where the antenna moves, as the receiver says it. These
    angles are degrees clockwise from north, (-180, 180]. `pitch_deg` is by how much the axis that
    `heading_deg` is of rises (of two antennas the way from the first to the second), `roll_deg` by
    how much its right side is down, `tilt_sigma_deg` the 1-sigma error of both. `stamp_sigma_s` is
    how far the stamp may be off the clock of the gyro: 0 of a receiver and a gyro in one unit.

    What a source does not say is NaN, or `NOT_SAID` (-1) among integers. Columns are not to be
    written to. An integer as index gives a row (:class:`Fix`); a slice, a mask or an array of
    indices gives columns. To make columns: :meth:`of` (arrays), :meth:`of_rows` (records).
    """

    time_ns: Int64
    lat_deg: Float64
    lon_deg: Float64
    height_m: Float64
    quality: Int64
    satellites: Int64
    hdop: Float64
    age_s: Float64
    sigma_m: Float64
    speed_mps: Float64
    heading_deg: Float64
    heading_sigma_deg: Float64
    heading_quality: Int64
    course_deg: Float64
    pitch_deg: Float64
    roll_deg: Float64
    tilt_sigma_deg: Float64
    stamp_sigma_s: Float64

    def __post_init__(self) -> None:
        for name, column in self.columns().items():
            if column.shape != (len(self.time_ns),):
                raise GnssError(
                    f"The column {name} of {len(self.time_ns)} fixes has the shape "
                    f"{column.shape}; give each column a value a fix."
                )
            if name in _QUALITIES and not np.isin(column, _CODES).all():
                raise GnssError(f"The column {name} of fixes holds a code that Quality has not.")

    @classmethod
    def of(cls, time_ns: npt.ArrayLike, **columns: npt.ArrayLike) -> Self:
        """Columns of arrays or single values; those left out are not said, heights are 0."""
        times = np.asarray(time_ns, dtype=np.int64)
        made: dict[str, AnyArray] = {"time_ns": times}
        for name in Fix._fields[1:]:
            kind, unsaid = _kind(name)
            value = columns.pop(name, 0.0 if name == "height_m" else unsaid)
            made[name] = np.array(np.broadcast_to(np.asarray(value, dtype=kind), times.shape))
        if columns:
            raise TypeError(f"fixes have no column {', '.join(columns)}")
        return cls(**made)

    @classmethod
    def of_rows(cls, rows: Iterable[Fix]) -> Self:
        """Columns of records, in their order."""
        values = list(zip(*rows, strict=True)) or [()] * len(Fix._fields)
        made: dict[str, AnyArray] = {}
        for name, column in zip(Fix._fields, values, strict=True):
            kind, unsaid = _kind(name)
            filled = [unsaid if value is None else value for value in column]
            made[name] = np.array(filled, dtype=kind)
        return cls(**made)

    @classmethod
    def joined(cls, parts: Iterable[FixColumns]) -> Self:
        """The fixes of several logs, one log after the other."""
        tables = [part.columns() for part in parts] or [cls.of([]).columns()]
        return cls(**{name: np.concatenate([t[name] for t in tables]) for name in Fix._fields})

    def __len__(self) -> int:
        return len(self.time_ns)

    def __iter__(self) -> Iterator[Fix]:
        """The rows, in the order of the log."""
        columns = (_as_said(name, column) for name, column in self.columns().items())
        return map(Fix._make, zip(*columns, strict=True))

    @overload
    def __getitem__(self, rows: int) -> Fix: ...
    @overload
    def __getitem__(self, rows: slice | Bool | Int64) -> Self: ...
    def __getitem__(self, rows: int | slice | Bool | Int64) -> Fix | Self:
        if isinstance(rows, int):
            k = range(len(self))[rows]
            return next(iter(self[k : k + 1]))
        return type(self)(**{name: column[rows] for name, column in self.columns().items()})

    def __eq__(self, other: object) -> bool:
        """Whether the values are the same; what is not said is the same as itself."""
        if not isinstance(other, FixColumns):
            return NotImplemented
        theirs = other.columns()
        return all(
            np.array_equal(column, theirs[name], equal_nan=name not in _INTEGERS)
            for name, column in self.columns().items()
        )

    def columns(self) -> dict[str, AnyArray]:
        """The columns by their names, in the order of the fields."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    def replace(self, **columns: AnyArray) -> Self:
        """These fixes with other values in some columns."""
        return replace(self, **columns)

    def in_order(self) -> Self:
        """The fixes in order of time; those of equal times stay as they are."""
        if np.all(self.time_ns[1:] >= self.time_ns[:-1]):
            return self
        return self[np.argsort(self.time_ns, kind="stable")]

    def position_sigma_m(self) -> Float64:
        """1-sigma error of each fix along one horizontal axis, metres: what the receiver states,
        else what is usual for its quality (`position_sigma_m`)."""
        return position_sigma_m(self.quality, self.sigma_m)


def _as_said(name: str, column: AnyArray) -> list[Any]:
    """The values of a column as a row has them."""
    values: list[Any] = column.tolist()
    if name in _QUALITIES:
        values = [Quality(value) for value in values]
    if name in _REQUIRED or name == "quality":
        return values
    if name in _INTEGERS:
        return [None if value == NOT_SAID else value for value in values]
    return [None if value != value else value for value in values]  # NaN is not itself


def _kind(name: str) -> tuple[type[np.generic], float | int]:
    return (np.int64, NOT_SAID) if name in _INTEGERS else (np.float64, np.nan)
