"""Which drives a map had at a moment: the order of sessions is that of their drives."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

from fieldgrid.errors import ConfigError
from fieldgrid.mapfile.records import SessionInfo

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def drive_order(info: SessionInfo) -> tuple[int, str]:
    """Sorts sessions by the end of their drive, and by name where that is the same."""
    return (-1 if info.last_time_ns is None else info.last_time_ns), info.name


def moment_ns(at: str | int, sessions: Sequence[SessionInfo], path: Path) -> int:
    """UTC in nanoseconds: the end of the session of that name, or of a day or time as in ISO 8601.

    Raises ConfigError for what is neither, or a session that has no time.
    """
    if isinstance(at, int):
        return at
    named = next((info for info in sessions if info.name == at), None)
    if named is None:
        return _parsed_ns(at, sessions, path)
    if not named.active:
        raise ConfigError(
            f"Session {at!r} of {path} is removed; put it back with --restore, or give a date."
        )
    if named.last_time_ns is None:
        raise ConfigError(f"Session {at!r} of {path} has no frames, so it has no date; give one.")
    return named.last_time_ns


def until(sessions: Sequence[SessionInfo], moment: int) -> list[SessionInfo]:
    """The sessions whose drive had ended by a moment, in the order of their drives."""
    timed = [info for info in sessions if info.last_time_ns is not None]
    return sorted((info for info in timed if (info.last_time_ns or 0) <= moment), key=drive_order)


def date_of(time_ns: int | None) -> str:
    """The UTC day of a moment, as a user would give it."""
    if time_ns is None:
        return "-"
    try:
        return (_EPOCH + timedelta(microseconds=time_ns // 1000)).date().isoformat()
    except OverflowError:
        return "-"


def _parsed_ns(text: str, sessions: Sequence[SessionInfo], path: Path) -> int:
    try:
        if len(text) == len("2026-06-03"):
            start = datetime.combine(date.fromisoformat(text), datetime.min.time(), UTC)
            return _since_epoch_ns(start + timedelta(days=1)) - 1
        moment = datetime.fromisoformat(text)
        return _since_epoch_ns(moment if moment.tzinfo else moment.replace(tzinfo=UTC))
    except (ValueError, OverflowError) as error:
        names = ", ".join(repr(info.name) for info in sessions) or "none"
        raise ConfigError(
            f"{text!r} is neither a session of {path} ({names}) nor a date as in 2026-06-03."
        ) from error


def _since_epoch_ns(moment: datetime) -> int:
    return (moment - _EPOCH) // timedelta(microseconds=1) * 1000
