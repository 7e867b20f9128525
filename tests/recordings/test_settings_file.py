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
        ("name = ", "is not TOML"),
        ("a" + ".b" * 40_000 + " = 1", "is not TOML: it is nested too deeply; correct it"),
        (f"name = '{'x' * 9999}'\nnam = 3", "'nam' is not a setting; known are name, image_time"),
        ("name = 3", "name is 3; give a text in quotes"),
        ("frames = 3", "frames is 3; give a path inside its folder, in quotes"),
        (f"frames = ['{'x' * 9999}']", r"frames is \['xxx.*\.\.\..*\]; give a path"),
        ("frames = '/etc/passwd'", "leads out of the recording; give a path inside"),
        ("calibration = '../raw.yaml'", "leads out of the recording; give a path inside"),
        ("calibration = ''", "leads out of the recording; give a path inside"),
        ("sensor = 'radar'", "sensor is 'radar'; give one of stereo, depth, disparity, cloud"),
        ("image_time_offset_s = '1'", "image_time_offset_s is '1', which is no number; give"),
        ("image_time_offset_s = nan", "image_time_offset_s is NaN, which is no number; give"),
        ("image_time_offset_s = true", "image_time_offset_s is True, which is no number"),
        ("image_time_offset_s = 1300000000", "offset_s is 1300000000; give .* at most 40 years"),
        ("image_time_offset_s = 1e10", r"image_time_offset_s is 1E\+10; give the seconds that"),
        ("gnss = 3", r"gnss is 3; give a table \[gnss\]"),
        ("[gnss]\ncolumns = 3", r"columns is 3; give a table \[gnss\.columns\]"),
        ("[gnss]\nlog = 'a'", "'log' is not a setting; known are columns"),
        ("[gnss.columns]\nlat = 3", "Columns: lat is 3; give a column name"),
        ("[gnss.columns]\nlatt = 'a'", "Columns: 'latt' cannot be mapped; known are time, lat"),
        ("datum = 3", r"datum is 3; give a table \[datum\]"),
        ("[datum]\nlat_deg = 3", "lacks lon_deg; give the longitude in degrees"),
        ("[datum]\nlat_deg=1\nlon_deg=2\nheight_m=3\nh=1", "'h' is not a setting"),
        ("[datum]\nlat_deg=99\nlon_deg=2\nheight_m=3", "99.0 and longitude 2.0 are not on Earth"),
        ("[datum]\nlat_deg='a'\nlon_deg=2\nheight_m=3", "lat_deg is 'a', which is no number"),
        ("[depth]\nscale_m = 0", "scale_m is 0; give a number above 0"),
        ("[depth]\nscale_px = 1", "'scale_px' is not a setting; known are scale_m, baseline_m"),
        ("[depth]\n[disparity]", r"has both \[depth\] and \[disparity\]"),
        ("[cloud]\naxes = 'fru'", "axes is 'fru'.*; give where x, y and z of the clouds point"),
        ("images = 3", r"images is 3; give a table \[images\]"),
        ("[images]\nraw = true", "'raw' is not a setting; known are rectified, bayer, bits"),
        ("[images]\nrectified = 0", "rectified is 0; give true or false"),
        ("[images]\nbayer = 'RGGB'", "bayer is 'RGGB'; give one of rggb, bggr, gbrg, grbg"),
        ("[images]\nbits = 7", "bits is 7; give how many of 16 bits the camera fills, 8 to 16"),
        ("[images]\nbits = 17", "bits is 17; give how many"),
        ("[images]\nbits = true", "bits is True; give how many"),
        ("[start]\nheading_deg = 3", "lacks utc_s; give the UTC of the first frame"),
        ("[start]\nutc_s = 1e300", r"utc_s is 1E\+300, which is no number; give the UTC"),
        ("[start]\nutc_s = 1", "utc_s is 1; give the UTC of .* since 1970, a time after 1980"),
        ("[start]\nutc_s = 1317384506\nheading_deg = nan", "heading_deg is NaN, .* number; give"),
        ("[start]\nutc_s = 1317384506\nheading_deg = 1e9", "heading_deg is 1E.9; give"),
    ],
)
def test_what_cannot_be_is_said(text: str, message: str, tmp_path: Path) -> None:
    (tmp_path / "recording.toml").write_text(text)
    with pytest.raises(RecordingError, match=rf"recording\.toml(: | ).*{message}") as caught:
        read_settings(tmp_path / "recording.toml")
    assert "\n" not in str(caught.value)
