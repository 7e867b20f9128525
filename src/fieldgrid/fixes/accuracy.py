"""How sure fixes are, by their quality and by what the receiver states."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from fieldgrid.array_types import Float64, Int64
from fieldgrid.quality import CENTIMETRES_M, Quality

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
