"""recording.toml: what it can say, and the sentence for what it cannot."""

from __future__ import annotations

from pathlib import Path

import pytest

from fieldgrid.errors import RecordingError
from fieldgrid.geodesy import Datum
from fieldgrid.recording.settings_file import Settings, Start, read_settings

ALL = """
name = "june-03"
image_time_offset_s = 0.000000001
frames = "tables/raw.csv"
calibration = "raw.yaml"
[datum]
lat_deg = 41.65
lon_deg = -4.72
height_m = 787.4
[gnss.columns]
lat = "Lat"
[images]
rectified = false
bayer = "grbg"
bits = 12
[start]
utc_s = 1317384506.123456789
heading_deg = -90
"""


def test_everything_can_be_said(tmp_path: Path) -> None:
    (tmp_path / "recording.toml").write_text(ALL)
    settings = read_settings(tmp_path / "recording.toml")
    assert settings.columns is not None
    assert settings.columns.names["lat"] == "Lat"
    assert settings == Settings(
        name="june-03",
        image_time_offset_ns=1,
        datum=Datum(41.65, -4.72, 787.4),
        columns=settings.columns,
        frames="tables/raw.csv",
        calibration="raw.yaml",
        rectified=False,
        bayer="grbg",
        bits=12,
        start=Start(1317384506123456789, -90.0),
    )


def test_nothing_need_be_said(tmp_path: Path) -> None:
    assert read_settings(tmp_path / "recording.toml") == Settings()
    (tmp_path / "recording.toml").write_text("")
    assert read_settings(tmp_path / "recording.toml") == Settings()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("frames = 3", "frames is 3; give a text in quotes"),
        ("frames = '/etc/passwd'", "leads out of the recording; give a path inside"),
        ("calibration = '../raw.yaml'", "leads out of the recording; give a path inside"),
        ("calibration = ''", "leads out of the recording; give a path inside"),
        ("images = 3", r"images is 3; give a table \[images\]"),
        ("[images]\nraw = true", "'raw' is not a setting; known are rectified, bayer, bits"),
        ("[images]\nrectified = 'no'", "rectified is 'no'; give true or false"),
        ("[images]\nrectified = 0", "rectified is 0; give true or false"),
        ("[images]\nbayer = 'RGGB'", "bayer is 'RGGB'; give one of rggb, bggr, gbrg, grbg"),
        ("[images]\nbayer = ['rggb']", r"bayer is \['rggb'\]; give one of"),
        ("[images]\nbits = 7", "bits is 7; give how many of 16 bits the camera fills, 8 to 16"),
        ("[images]\nbits = 17", "bits is 17; give how many"),
        ("[images]\nbits = true", "bits is True; give how many"),
        ("[images]\nbits = '12'", "bits is '12'; give how many"),
        ("[start]\nheading_deg = 3", "utc_s holds None; give a number"),
        ("[start]\nutc_s = 1e300", "utc_s holds Decimal.*; give a number"),
        ("[start]\nutc_s = 1\n", "utc_s = 1 is no time after 1980"),
        ("[start]\nutc_s = 1317384506\nheading_deg = nan", "heading_deg holds .*; give a number"),
        ("[start]\nutc = 3", "'utc' is not a setting; known are utc_s, heading_deg"),
    ],
)
def test_what_cannot_be_is_said(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "recording.toml").write_text(text)
    with pytest.raises(RecordingError, match=rf"recording\.toml: .*{message}") as caught:
        read_settings(tmp_path / "recording.toml")
    assert "\n" not in str(caught.value)
