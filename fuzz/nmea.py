"""NMEA 0183 and Unicore's logs: no crash, no wild fix, no difference by how bytes arrive."""

from __future__ import annotations

import math
import re

from fieldgrid.geometry import Fix
from fieldgrid.poses import NmeaStream
from fieldgrid.poses.gnss.fields import checksums
from fieldgrid.poses.gnss.nmea import unicore_crc
from fuzz.target import Target, real_starts

_SENTENCES = b"""\
$GNGGA,235958.00,4139.0227370,N,00443.2141860,W,4,12,0.7,737.921,M,52.4,M,1.5,0138*00
$GNRMC,235958.00,A,4139.0227370,N,00443.2141860,W,3.0,12.5,150611,,,R*00
$GNVTG,12.5,T,,M,3.0,N,5.6,K,R*00
$GNGSA,A,3,01,02,03,04,05,06,07,08,09,10,11,12,1.2,0.7,1.0*00
$GNGST,235958.00,0.4,0.3,0.2,7.6,0.012,0.014,0.03*00
$GNZDA,235958.00,15,06,2011,00,00*00
$GNHDT,274.07,T*00
$GNTHS,274.07,A*00
$GNTRA,235958.00,101.78,1.19,-0.01,4,10,0.00,0004*00
$PASHR,235958.00,179.885,T,-0.624,0.245,,0.029,0.029,0.502,2,3*00
$PTNL,AVR,235958.00,+52.1531,Yaw,-0.0806,Tilt,,,12.575,3,1.4,16*00
$PTNL,GGK,235958.00,061511,4139.02273701,N,00443.21418601,W,3,09,1.9,EHT790.321,M*00
$KSXT,20110615235958.00,-4.72023643,41.65037895,737.92,299.22,1.03,190.28,0.022,,3,3,46,28,,,,,,,,*00
#UNIHEADINGA,93,GPS,FINE,1640,345613000,0,0,18,10;SOL_COMPUTED,NARROW_INT,1.5208,219.9783,2.6813,0.0000,0.4390,0.3287,"999",21,9,9,5,3,00,3,13*00000000
#BESTNAVA,97,GPS,FINE,1640,345613000,0,0,18,16;SOL_COMPUTED,NARROW_FLOAT,41.65037895,-4.72023643,737.92,52.4,WGS84,1.2221,1.1053,2.1970,"0",0.400,0.200,50,28,28,0,1,12,12,41,SOL_COMPUTED,DOPPLER_VELOCITY,0.000,0.000,0.0046,335.592288,0.0045,0.0194,0.0123*00000000
#PVTSLNA,79,GPS,FINE,1640,345613000,0,0,18,8;SINGLE,737.92,41.65037895,-4.72023643,7.5,4.3,3.4,0.000,SINGLE,737.92,41.65,-4.72,52.4,19,17,19,17,-0.09,-0.04,-0.15,NARROW_INT,1.5,182.25,0.1,28,25,12,8,2.8,1.6,0.8,2.4,2.3,5.0,17,3,4,9*00000000
"""
_NMEA = re.compile(rb"\$([^$#*]{1,256})\*([0-9A-Fa-f]{2})")
_LOG = re.compile(rb"#([^$#*]{1,1200})\*([0-9A-Fa-f]{8})")


def mend(data: bytes) -> bytes:
    """The data with the right checksum at every sentence."""
    data = _NMEA.sub(lambda m: b"$%b*%02X" % (m[1], *checksums([m[1]])), data)
    return _LOG.sub(lambda m: b"#%b*%08x" % (m[1], unicore_crc(m[1])), data)


def seeds() -> list[bytes]:
    epoch = mend(_SENTENCES)
    following = mend(_SENTENCES.replace(b"235958", b"235959").replace(b"345613", b"345614"))
    real = real_starts("gnss/gpsd_corpus/*.log", "gnss/nmea_misc/*")
    return [epoch + following, *epoch.splitlines(keepends=True), *real]


def check(data: bytes) -> None:
    whole = _fixes([data])
    for fix in whole:
        _check_fix(fix)
    step = 1 + checksums([data[:256]])[0] % 97
    pieces = [data[k : k + step] for k in range(0, len(data), step)]
    assert _fixes(pieces) == whole, f"fixes differ when they arrive {step} bytes at a time"


def _fixes(pieces: list[bytes]) -> list[Fix]:
    stream = NmeaStream()
    return [fix for piece in pieces for fix in stream.feed(piece)] + stream.finish()


def _check_fix(fix: Fix) -> None:
    assert all(math.isfinite(value) for value in fix if value is not None), fix
    assert abs(fix.lat_deg) <= 90.0, fix
    assert abs(fix.lon_deg) <= 180.0, fix
    assert abs(fix.height_m) <= 2e5, fix
    assert 0 < fix.time_ns < 1 << 63, fix
    for angle in (fix.heading_deg, fix.course_deg):
        assert angle is None or -180.0 < angle <= 180.0, fix
    assert fix.speed_mps is None or 0.0 <= fix.speed_mps <= 1e4, fix


TARGET = Target("nmea", check, seeds, mend)
