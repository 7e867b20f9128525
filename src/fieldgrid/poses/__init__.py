"""Poses: fixes and motion become a trajectory with gear, sigma and verdict.

* `gnss`: bytes of receivers to fixes: NMEA (`nmea_sentences`: a row a sentence) and UBX.
* `gates`: `condition`, which fixes are accepted, and the reasons of the others.
* `gears`: forward or reverse; `attitude`: roll and pitch against gravity.
* `smoother`: `smooth`, the banded least-squares estimate of a whole drive; `declared`, the evidence
  of what may be wrong; `slow_error`, how a receiver wanders.
* `faults`: what is told of that, and what one step does not show: clocks, gyros, leaps.
* `estimate`: `estimate_poses` runs these steps; `verdict` judges each pose, `report` says why.
* `external`: poses of another program; `track`: a trajectory as `track.csv`, GPX or GeoJSON.

It opens no recording, and knows no images and no map.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from fieldgrid.core.doors import door

if TYPE_CHECKING:
    from fieldgrid.poses.attitude.attitude import Attitude as Attitude
    from fieldgrid.poses.estimate import estimate_poses as estimate_poses
    from fieldgrid.poses.external.given import GIVEN as GIVEN
    from fieldgrid.poses.faults.camera_yaw import ASKEW_DEG as ASKEW_DEG
    from fieldgrid.poses.faults.clock.search import ClockOffset as ClockOffset
    from fieldgrid.poses.faults.clock.shifts import (
        Span as Span,
        explanation as explanation,
        shift_to_overlap as shift_to_overlap,
    )
    from fieldgrid.poses.gates.summary import ConditioningSummary as ConditioningSummary
    from fieldgrid.poses.gates.verdict import Gate as Gate
    from fieldgrid.poses.gnss.gps_time import (
        GPS_EPOCH_UNIX_S as GPS_EPOCH_UNIX_S,
        leap_seconds as leap_seconds,
        unix_ns as unix_ns,
    )
    from fieldgrid.poses.gnss.nmea import NmeaStream as NmeaStream
    from fieldgrid.poses.gnss.nmea_epochs import NmeaCounts as NmeaCounts
    from fieldgrid.poses.gnss.ubx import UbxCounts as UbxCounts, UbxParser as UbxParser
    from fieldgrid.poses.levelled import (
        levelling_attitude as levelling_attitude,
        tells_attitude as tells_attitude,
    )
    from fieldgrid.poses.report import Estimate as Estimate
    from fieldgrid.poses.track.formats import gpx_track as gpx_track
    from fieldgrid.poses.track.table import (
        Spread as Spread,
        TrackSummary as TrackSummary,
        check_target as check_target,
        summarise_track as summarise_track,
        write_track as write_track,
    )
    from fieldgrid.poses.travel_direction import (
        LEAST_STEP_M as LEAST_STEP_M,
        LEAST_WAY_M as LEAST_WAY_M,
        MOST_TURN_DEG as MOST_TURN_DEG,
        Travel as Travel,
        Ways as Ways,
        travel as travel,
    )
    from fieldgrid.poses.verdict import ErrorBudget as ErrorBudget
else:
    __getattr__, __dir__, __all__ = door(__name__, __file__)
