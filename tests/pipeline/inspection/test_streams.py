"""Stamps that lie, told from stamps that do not."""

from __future__ import annotations

import numpy as np
import pytest

from fieldgrid.pipeline.inspection.streams import stream_findings, summarise_stream
from fieldgrid.recordings import Stream

START_NS = 1_700_000_000_000_000_000
RATE_HZ = 10.0


def stream(
    stamps_s: np.ndarray, delays_s: np.ndarray | None = None, role: str = "left", name: str = "/a"
) -> Stream:
    """A stream with stamps in seconds, and delays until each is written down."""
    stamp_ns = START_NS + np.round(stamps_s * 1e9).astype(np.int64)
    received = None if delays_s is None else stamp_ns + np.round(delays_s * 1e9).astype(np.int64)
    return Stream(name, "image", role, len(stamp_ns), stamp_ns, received)


def even(seconds: float = 120.0) -> np.ndarray:
    return np.arange(0.0, seconds, 1.0 / RATE_HZ)


def jitter(n: int, most_s: float = 0.02) -> np.ndarray:
    return np.random.default_rng(0).uniform(0.002, most_s, n)


def codes(*streams: Stream) -> list[str]:
    return [finding.code for finding in stream_findings(streams)]


def test_a_sound_stream_in_numbers() -> None:
    stamps = even()
    found = summarise_stream(stream(stamps, jitter(len(stamps))))
    assert found.rate_hz == pytest.approx(RATE_HZ)
    assert found.longest_gap_s == pytest.approx(0.1)
    assert found.jitter_s == pytest.approx(0.0, abs=1e-6)
    assert found.delay_s == pytest.approx(0.011, abs=0.002)
    assert abs(found.drift_ppm or 0.0) < 20.0
    assert (found.backward, found.repeated, found.unstamped) == (0, 0, 0)
    assert codes(stream(stamps, jitter(len(stamps)))) == []


@pytest.mark.parametrize("count", [0, 1, 2])
def test_streams_too_short_to_tell_anything(count: int) -> None:
    one = stream(even()[:count], jitter(count))
    assert summarise_stream(one).messages == count
    assert codes(one) == []


def test_a_stream_that_is_not_used_is_not_judged() -> None:
    stamps = even()[::-1]
    assert codes(stream(stamps, role="")) == []
    assert "backward-stamps" in codes(stream(stamps))


def test_backward_and_repeated_stamps() -> None:
    stamps = even()
    stamps[50], stamps[51] = stamps[51], stamps[50]
    (finding,) = stream_findings([stream(stamps)])
    assert finding.code == "backward-stamps"
    assert finding.message.startswith("1 stamps of /a are earlier")
    assert "0.100 s" in finding.message
    stamps = even()
    stamps[100:150] = stamps[100]
    assert codes(stream(stamps))[0] == "repeated-stamps"
    few = even()
    few[100] = few[101]
    assert codes(stream(few)) == []


def test_messages_without_stamps() -> None:
    one = stream(even())
    one.stamp_ns[:30] = 0
    assert codes(one) == ["no-stamps"]
    assert summarise_stream(one).unstamped == 30


def test_gaps_of_a_steady_stream_alone() -> None:
    stamps = np.concatenate([even(20.0), 23.5 + even(20.0)])
    (finding,) = stream_findings([stream(stamps)])
    assert finding.code == "gap"
    assert "longest of 3.6 s" in finding.message
    by_way = np.cumsum(np.random.default_rng(1).exponential(1.0, 100))
    assert codes(stream(by_way)) == []
    # Those of fixes are told when they have been judged.
    assert codes(stream(stamps, role="fix")) == []


@pytest.mark.parametrize(("ppm", "found"), [(20.0, []), (800.0, ["clock-drift"])])
def test_drift(ppm: float, found: list[str]) -> None:
    stamps = even(300.0)
    one = stream(stamps, jitter(len(stamps)) + ppm * 1e-6 * stamps)
    assert codes(one) == found
    assert summarise_stream(one).drift_ppm == pytest.approx(ppm, abs=15.0)


def test_a_clock_that_was_set() -> None:
    stamps = even()
    delays = jitter(len(stamps)) + np.where(stamps > 60.0, 2.0, 0.0)
    (finding,) = stream_findings([stream(stamps, delays)])
    assert finding.code == "clock-jump"
    assert "jump by -2.0" in finding.message
    # A message that waited is none.
    delays = jitter(len(stamps))
    delays[300] = 3.0
    assert codes(stream(stamps, delays)) == []


def test_clocks_that_differ_by_their_receipt() -> None:
    stamps = even()
    images = stream(stamps, jitter(len(stamps)) + 0.35)
    fixes = stream(stamps, jitter(len(stamps)), role="fix", name="/fix")
    (finding,) = stream_findings([images, fixes])
    assert finding.code == "stamp-delays"
    assert "--time-offset 0.350" in finding.remedy
    assert codes(stream(stamps, jitter(len(stamps))), fixes) == []
    # Stamps that count from the start of the sensor are mended by no offset.
    assert codes(stream(stamps, jitter(len(stamps)) + 1.3e9), fixes) == []
