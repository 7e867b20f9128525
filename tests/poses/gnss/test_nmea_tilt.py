"""How the axis of a recorded heading leans, by what sentences say beside the heading."""

from __future__ import annotations

import pytest

from fieldgrid.poses.gnss.nmea import unicore_crc
from tests.poses.gnss.sentences import gga, parse, rmc, sentence

SECONDS = 3 * 86_400 + 43_200 + 18


def tilt(body: str) -> tuple[float | None, ...]:
    (fix,) = parse(gga("120000"), rmc("120000"), sentence(body))
    return fix.pitch_deg, fix.roll_deg, fix.tilt_sigma_deg


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("GNTRA,120000,101.78,1.19,-0.01,4,10,0.00,0004", (1.19, None, None)),
        ("GNTRA,120000,101.78,1.19,-0.01,1,10,0.00,0004", (None, None, None)),
        ("GNHPR,120000,320.961,-6.1,000.0,4,47,0.00,0999", (-6.1, None, None)),
        ("PTNL,AVR,120000,+52.1,Yaw,-0.0806,Tilt,,,12.575,3,1.4,16", (-0.0806, None, None)),
        ("PTNL,AVR,120000,+52.1,Yaw,-0.0806,Tilt,,,12.575,1,1.4,16", (None, None, None)),
        ("PTNL,AVR,120000,+52.1,Yaw,-0.08,Roll,,,12.575,3,1.4,16", (None, None, None)),
        ("PASHR,120000,181.0,T,-0.6,0.2,,0.029,0.031,0.502,2,3", (0.2, -0.6, 0.031)),
        ("PASHR,120000,181.0,T,-0.6,0.2,,,,,2,3", (0.2, -0.6, None)),
        ("PASHR,120000,181.0,T,-0.6,0.2,,0.029,0.031,0.502,0,3", (None, None, None)),
    ],
)
def test_sentences_tell_pitch_and_roll(body: str, expected: tuple[float | None, ...]) -> None:
    assert tilt(body) == expected


def test_a_pitch_that_cannot_be_read_leaves_the_heading() -> None:
    (fix,) = parse(
        gga("120000"), rmc("120000"), sentence("GNTRA,120000,101.78,999,-0.01,4,10,0.00,0004")
    )
    assert (fix.heading_deg, fix.pitch_deg) == (101.78, None)


def test_ksxt_tells_the_pitch() -> None:
    body = "KSXT,20110615120000.00,116.3,39.9,49.5,223.57,-11.32,330.19,0.024,,{},{},36,38,,,,,,,,"
    (fix,) = parse(sentence(body.format(3, 3)))
    assert (fix.heading_deg, fix.pitch_deg, fix.roll_deg) == (223.57 - 360.0, -11.32, None)
    (fix,) = parse(sentence(body.format(3, 1)))
    assert (fix.heading_deg, fix.pitch_deg) == (None, None)


@pytest.mark.parametrize(
    ("header", "unit"),
    [
        ("UNIHEADINGA,78,GPS,FINE,2428,{},0,0,18,11", 1000),
        ("HEADINGA,COM1,0,60.5,FINESTEERING,2428,{},00000000,0000,0", 1),
        ("HEADING2A,COM1,0,60.5,FINESTEERING,2428,{},00000000,0000,0", 1),
        ("DUALANTENNAHEADINGA,COM1,0,60.5,FINESTEERING,2428,{},00000000,0000,0", 1),
    ],
)
def test_logs_of_two_antennas_tell_the_pitch_and_its_sigma(header: str, unit: int) -> None:
    raw = header.format(SECONDS * unit) + (
        ';SOL_COMPUTED,NARROW_INT,1.4773,179.0284,-2.5178,0.0000,0.8259,0.4130,"999",30,23,23,'
        "10,3,01,3,f3"
    )
    log = f"#{raw}*{unicore_crc(raw.encode()):08x}\r\n".encode()
    (fix,) = parse(gga("120000"), rmc("120000", "220726"), log)
    assert (fix.heading_deg, fix.heading_sigma_deg) == (179.0284, 0.8259)
    assert (fix.pitch_deg, fix.roll_deg, fix.tilt_sigma_deg) == (-2.5178, None, 0.413)
