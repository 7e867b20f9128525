"""Which files a receiver's log may go on in."""

from __future__ import annotations

import gzip
import io
import sqlite3
import zipfile
from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import pytest

from fieldgrid.core import ConfigError
from fieldgrid.live import Receiver
from tests.conftest import TWO_LANES

NMEA = (TWO_LANES / "gnss" / "gnss_rtk.nmea").read_bytes()[:2000]
SENTENCE = NMEA[: NMEA.index(b"\n") + 1]
RTCM = (
    b"\xd3\x00\x13\x3e\xd0\x00\x03\x8a\x0e\xde\xef\x34\xb4\xbd\x62\xac\x09\x41\x98\x6f\x33\x36\x0b"
)


def zipped() -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("log.nmea", NMEA)  # stored, so that sentences are seen in it
    return file.getvalue()


@pytest.mark.parametrize(
    "left",
    [
        b"",
        b"$GPGGA,1234",
        b"$",
        b"$GPG",
        b"1.65,N,00443.2,W,4,1",  # begun within a sentence, and cut
        SENTENCE[20:],
        SENTENCE[20:] + b"$GPRMC",
        bytes(4096),
        SENTENCE + bytes(4096),
        bytes(600) + b"$GPGGA,12",
        RTCM,
        20 * RTCM,
        b"\xb5\x62",
        bytes(np.random.default_rng(3).integers(0, 256, 3000, dtype=np.uint8)),  # another baud rate
        b"\r\n",
        b"\xff\xfe\xf8\x80\xff",  # line noise
        b'{"class":"DEVICES","devices":[]}\r\n{"class":"WATCH"}\r\n',
    ],
)
def test_what_a_crash_leaves_goes_on(left: bytes, tmp_path: Path) -> None:
    log = tmp_path / "log.nmea"
    log.write_bytes(left)
    Receiver("-", log)
    assert log.read_bytes() == left


@pytest.mark.parametrize(
    "other",
    [
        b"time,lat,lon\n1,41.65,-4.72\n2,41.66,-4.73\n",
        "\ufeffzeit;höhe\n1;2\n".encode(),
        "zeit;höhe\n1;2\n".encode("latin-1"),
        "time\tlat\n1\t2\n".encode("utf-16"),
        b"[images]\nbits = 12\n",
        b'{"session": "june-03"}',
        b"<?xml version='1.0'?>\n<gpx/>\n",
        b"Notes of the field, not to be lost!",
        zipped(),
        gzip.compress(NMEA),
        cv2.imencode(".png", np.zeros((4, 4), np.uint8))[1].tobytes(),
        cv2.imencode(".jpg", np.zeros((4, 4), np.uint8))[1].tobytes(),
        cv2.imencode(".tif", np.zeros((4, 4), np.uint8))[1].tobytes(),
    ],
)
def test_something_else_is_refused_and_left_as_it_is(other: bytes, tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.write_bytes(other)
    with pytest.raises(ConfigError, match="is no log of a receiver to append to"):
        Receiver("-", log)
    assert log.read_bytes() == other


def test_a_database_with_sentences_is_refused(tmp_path: Path) -> None:
    log = tmp_path / "bag.db3"
    with closing(sqlite3.connect(log, isolation_level=None)) as connection:
        connection.execute("CREATE TABLE messages (data BLOB)")
        connection.execute("INSERT INTO messages VALUES (?)", (NMEA,))
    with pytest.raises(ConfigError, match="is no log of a receiver to append to"):
        Receiver("-", log)
