"""recording.toml: what it can say, and the sentence for what it cannot."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path

import pytest

from fieldgrid.core import RecordingError
from fieldgrid.geometry import Datum
from fieldgrid.recordings.readers.settings_file import RecordingSettings, Start, read_settings

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
    assert settings == RecordingSettings(
        name="june-03",
        image_time_offset_ns=1,
        datum=Datum(41.65, -4.72, 787.4),
        columns=settings.columns,
        frames="tables/raw.csv",
        calibration="raw.yaml",
        rectified=False,
        bayer="grbg",
        bits=12,
        start=Start(utc_s=Decimal("1317384506.123456789"), heading_deg=-90.0),
    )


def test_nothing_need_be_said(tmp_path: Path) -> None:
    assert read_settings(tmp_path / "recording.toml") == RecordingSettings()
    (tmp_path / "recording.toml").write_text("")
    assert read_settings(tmp_path / "recording.toml") == RecordingSettings()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("frames = 3", "frames is 3; give a path inside its folder, in quotes"),
        ("frames = '/etc/passwd'", "leads out of the recording; give a path inside"),
        ("calibration = '../raw.yaml'", "leads out of the recording; give a path inside"),
        ("calibration = ''", "leads out of the recording; give a path inside"),
        ("gnss = 3", r"gnss is 3; give a table \[gnss\]"),
        ("[gnss]\nlog = 'a'", "'log' is not a setting; known are columns"),
        ("[gnss.columns]\nlatitude = 'a'", "Columns: 'latitude' cannot be mapped"),
        ("name = 3", "name is 3; give a text in quotes"),
        ("sensor = 'radar'", "sensor is 'radar'; give one of stereo, depth, disparity, cloud"),
        ("image_time_offset_s = 1e10", "image_time_offset_s is 1E.10; give the seconds that"),
        ("image_time_offset_s = true", "image_time_offset_s is True, which is no number"),
        ("[datum]\nlat_deg = 3", "lacks lon_deg; give the longitude in degrees"),
        ("[datum]\nlat_deg = 99\nlon_deg = 0\nheight_m = 0", "99"),
        ("datum = 3", r"datum is 3; give a table \[datum\]"),
        ("[depth]\nscale_m = 0", "scale_m is 0; give a number above 0"),
        ("[depth]\nscale_px = 1", "'scale_px' is not a setting; known are scale_m, baseline_m"),
        ("[depth]\n[disparity]", r"has both \[depth\] and \[disparity\]"),
        ("[cloud]\nscale_m = 0", "scale_m is 0; give a number above 0"),
        ("[cloud]\naxes = 'fru'", "axes is 'fru'.*; give where x, y and z of the clouds point"),
        (f"name = '{'x' * 9999}'\nnam = 3", "'nam' is not a setting; known are name, image_time"),
        (f"frames = ['{'x' * 9999}']", r"frames is \['xxx.*\.\.\..*\]; give a path"),
        ("a" + ".b" * 40_000 + " = 1", "is not TOML: it is nested too deeply; correct it"),
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
        ("[start]\nheading_deg = 3", "lacks utc_s; give the UTC of the first frame"),
        ("[start]\nutc_s = 1e300", r"utc_s is 1E\+300, which is no number; give the UTC"),
        (
            "[start]\nutc_s = 1\n",
            "utc_s is 1; give the UTC of .* since 1970, a time after 1980",
        ),
        (
            "[start]\nutc_s = 1317384506\nheading_deg = nan",
            "heading_deg is NaN, .* no number; give",
        ),
        ("[start]\nutc = 3", "'utc' is not a setting; known are utc_s, heading_deg"),
    ],
)
def test_what_cannot_be_is_said(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "recording.toml").write_text(text)
    with pytest.raises(RecordingError, match=rf"recording\.toml(: | ).*{message}") as caught:
        read_settings(tmp_path / "recording.toml")
    assert "\n" not in str(caught.value)
