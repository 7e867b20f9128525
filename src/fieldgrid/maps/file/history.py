"""Which drives a map had at a moment: the order of sessions is that of their drives."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, date, datetime, timedelta
from pathlib import Path

from fieldgrid.core import ConfigError, quoted
from fieldgrid.maps.file.records import SessionInfo

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)


def in_drive_order(sessions: Sequence[SessionInfo]) -> list[SessionInfo]:
    """The active sessions by the end of their drives; as they were added where that is alike."""
    active = [info for info in sessions if info.active]
    return sorted(active, key=lambda info: -1 if info.last_time_ns is None else info.last_time_ns)


def until(at: str | int, sessions: Sequence[SessionInfo], path: Path) -> list[SessionInfo]:
    """The active sessions as of a moment, in the order of their drives; there may be none.

    `at` is a session, which is the last of them; a day or time as in ISO 8601 (UTC); or UTC in
    nanoseconds. Raises ConfigError for what is neither, or a session that has no time.
    """
    ordered = in_drive_order(sessions)
    named = next((info for info in sessions if info.name == at), None)
    if named is None:
        _, moment = (at, at) if isinstance(at, int) else _parsed_ns(at, sessions, path)
        return [
            info
            for info in ordered
            if info.last_time_ns is not None and info.last_time_ns <= moment
        ]
    if not named.active:
        raise ConfigError(
            f"Session {quoted(at)} of {path} is removed; put it back with --restore, or give a "
            "date."
        )
    if named.last_time_ns is None:
        raise ConfigError(
            f"Session {quoted(at)} of {path} has no frames, so it has no date; give one."
        )
    return ordered[: ordered.index(named) + 1]


def during(at: str | int, sessions: Sequence[SessionInfo], path: Path) -> list[SessionInfo]:
    """`until`, or for `FROM..TO` the active sessions from one moment to another: from the drive, or
    the beginning of the day, up to the other drive, or the end of its day. Either may be empty."""
    if not isinstance(at, str) or ".." not in at or any(info.name == at for info in sessions):
        return until(at, sessions, path)
    first, last = at.split("..", 1)
    found = until(last, sessions, path) if last else in_drive_order(sessions)
    if not first:
        return found
    if any(info.name == first for info in sessions):
        earlier = [info.name for info in until(first, sessions, path)][:-1]
        return [info for info in found if info.name not in earlier]
    start_ns, _ = _parsed_ns(first, sessions, path)
    return [
        info for info in found if info.last_time_ns is not None and info.last_time_ns >= start_ns
    ]


def _parsed_ns(text: str, sessions: Sequence[SessionInfo], path: Path) -> tuple[int, int]:
    """The first and the last moment of a day; of a time, the same."""
    try:
        if len(text) == len("2026-06-03"):
            start = datetime.combine(date.fromisoformat(text), datetime.min.time(), UTC)
            return _since_epoch_ns(start), _since_epoch_ns(start + timedelta(days=1)) - 1
        moment = datetime.fromisoformat(text)
        at_ns = _since_epoch_ns(moment if moment.tzinfo else moment.replace(tzinfo=UTC))
        return at_ns, at_ns
    except (ValueError, OverflowError) as error:
        names = ", ".join(repr(info.name) for info in sessions) or "none"
        raise ConfigError(
            f"{quoted(text)} is neither a session of {path} ({names}) nor a date as in 2026-06-03."
        ) from error


def _since_epoch_ns(moment: datetime) -> int:
    return (moment - _EPOCH) // timedelta(microseconds=1) * 1000
