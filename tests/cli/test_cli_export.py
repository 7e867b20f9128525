"""`fieldgrid export`, for all formats."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
import rasterio

from fieldgrid.core import ConfigError, Flag, Settings, replacing, setting
from fieldgrid.export import (
    Exported,
    ExportFormat,
    Selection,
    export_map,
    formats,
    register_export_format,
    unregister_export_format,
)
from fieldgrid.maps import LAYERS, MapFile, open_map
from tests.cli.conftest import Run
from tests.export.asymmetric import write_asymmetric_map
from tests.export.placed import faults, faults_at_centres, opened


@pytest.fixture(scope="module")
def f_map(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_asymmetric_map(tmp_path_factory.mktemp("map") / "f.gpkg")


def test_a_part_of_a_real_map(fieldgrid: Run, two_lanes_map: Path, tmp_path: Path) -> None:
    out = tmp_path / "x.tif"
    flags = ["--cell", "0.25", "--bounds", "-10", "50", "0", "60"]
    lines = fieldgrid("export", two_lanes_map, out, *flags).output().splitlines()
    table = dict(re.split(r" {2,}", line.strip(), maxsplit=1) for line in lines)
    assert table["format"] == "geotiff"
    assert table["cells"] == "40 x 40 of 0.25 m"
    assert table["west south east north"] == "-10.000 50.000 0.000 60.000 m"
    assert table["x.tif"].endswith(("bytes", "MB"))
    with open_map(two_lanes_map) as universal, rasterio.open(out) as raster:
        assert table["datum"] == universal.datum.described()
        view = universal.read(cell_m=0.25)
        assert tuple(raster.bounds) == pytest.approx((-10.0, 50.0, 0.0, 60.0))
        assert raster.res == (0.25, 0.25)
        for east_m, north_m in [(-5.1, 55.3), (-2.2, 58.9), (-9.9, 50.1)]:
            i, j = view.lattice.index(east_m, north_m)
            place = j - view.window.j0, i - view.window.i0
            (value, seen) = next(raster.sample([(east_m, north_m)]))
            assert value == view.density[place]
            assert (seen == 255) == view.observed[place]


def test_the_ending_says_the_format(fieldgrid: Run, f_map: Path, tmp_path: Path) -> None:
    for ending, name in ((".TIF", "geotiff"), (".png", "png"), (".kmz", "kmz"), (".npz", "npz")):
        answer = json.loads(fieldgrid("export", f_map, tmp_path / f"x{ending}", "--json").output())
        assert answer["format"] == name
        assert answer["map"] == str(f_map)
        for file in answer["files"]:
            assert file["bytes"] == Path(file["path"]).stat().st_size > 0
        with open_map(f_map) as universal:
            assert answer["about"]["cell_m"] == universal.cell_m
            assert answer["about"]["datum"]["lat_deg"] == universal.datum.lat_deg
            assert answer["about"]["bounds_m"]["west"] == universal.bounds.west_m
    named = fieldgrid("export", f_map, tmp_path / "odd.name", "--format", "geotiff")
    assert named.output().splitlines()[0].split() == ["format", "geotiff"]
    assert faults(opened(tmp_path / "odd.name")) == []


def test_a_layer_as_of_a_session_in_another_system(
    fieldgrid: Run, f_map: Path, tmp_path: Path
) -> None:
    out = tmp_path / "x.tif"
    fieldgrid("export", f_map, out, "--layer", "max", "--epsg", "25830").output()
    assert faults_at_centres(opened(out), "max") == []
    fieldgrid("export", f_map, out, "--at", "spring", "--layer", "sessions", "--overwrite").output()
    with rasterio.open(out) as raster:
        assert set(np.unique(raster.read(1))) == {0, 1}


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ("OUT/x.foo", r"x\.foo ends in none of \.tif, .*; choose one of them, or give --format"),
        ("OUT/x.tif --format maps", "'maps' is no format; known are geotiff, png, mbtiles"),
        ("OUT/x.tif --layer depth", "There is no layer 'depth'; there are density, count"),
        ("OUT/x.tif --format png", "x.tif is the name of a file of format geotiff, not png"),
        ("OUT/x.zip --format isoxml", "x.zip is the name of a file, and the format isoxml is a"),
        ("OUT/x.tif --epsg 99999", "EPSG:99999 is not known"),
        ("OUT/not/x.tif", "its folder does not exist; make it first"),
        ("OUT/not/x.png", "its folder does not exist; make it first"),
        ("OUT/not/x.kmz", "its folder does not exist; make it first"),
        ("OUT", "is a folder; give the name of a file"),
        ("/dev/null", "is a pipe or a device; give the name of a file"),
        ("OUT/x.tif --cell 0.02", r"0\.02 m are smaller than the local cells"),
        ("OUT/x.tif --cell -1", r"A cell of -1\.0 m is outside"),
        ("OUT/x.tif --cell nan", "A cell of nan m is outside"),
        ("OUT/x.tif --bounds 1 1 1 1", "are empty; give west south east north"),
        ("OUT/x.kmz --bounds 1 1 0 0", "are empty; give west south east north"),
        ("OUT/x.tif --bounds nan 0 1 1", "are empty; give west south east north"),
        ("OUT/x.tif --bounds 900 0 999 9", "hold nothing of the map, which lies between -10 -7"),
        ("OUT/x.tif --bounds 0 0 9e9 99", "over 10 thousand million; give smaller bounds"),
        ("OUT/x.tif --bounds 0 0 1e300 1e300", r"^2e\+301 x 2e\+301 cells of"),
        ("OUT/x.png --bounds 0 0 9e3 9", "A PNG of 180000 x 180 pixels is more than"),
        ("OUT/x.kmz --bounds 0 0 9e3 99", r"88 pictures, .* or cells of 0\.1 m"),
        (
            "OUT/x.png --layer count",
            "cannot hold the layer 'count', only layers of .* 0 to 255; leave --layer",
        ),
        ("OUT/x.tif --at winter", "'winter' is neither a session of .* nor a date"),
        ("OUT/x.tif --at 2019-01-01", "has no session up to 2019-01-01"),
    ],
)
def test_exports_that_cannot_be(
    flags: str, message: str, fieldgrid: Run, f_map: Path, tmp_path: Path
) -> None:
    words = flags.replace("OUT", str(tmp_path)).split()
    if words[0] in (str(tmp_path), "/dev/null"):
        words += ["--format", "geotiff"]
    sentence = fieldgrid("export", f_map, *words).sentence()
    assert re.search(message, sentence), sentence
    assert list(tmp_path.iterdir()) == []


def test_an_export_has_a_name(
    fieldgrid: Run, f_map: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    told = fieldgrid("export", f_map, "-", "--format", "csv").usage()
    assert "it is the name of a file or a folder" in " ".join(told.split())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["x.tif", "x.png", "x.kmz"])
def test_an_existing_export(name: str, fieldgrid: Run, f_map: Path, tmp_path: Path) -> None:
    out = tmp_path / name
    fieldgrid("export", f_map, out, "--cell", "2").output()
    before = {file: file.read_bytes() for file in tmp_path.iterdir()}
    sentence = fieldgrid("export", f_map, out).sentence()
    assert "exists already; give another name, or --overwrite to replace it" in sentence
    assert {file: file.read_bytes() for file in tmp_path.iterdir()} == before
    fieldgrid("export", f_map, out, "--overwrite").output()
    assert set(tmp_path.iterdir()) == set(before)
    assert out.stat().st_size > len(before[out])


def test_the_map_itself_is_safe(fieldgrid: Run, f_map: Path) -> None:
    before = f_map.read_bytes()
    for name in formats():
        words = ("--format", name, "--overwrite")
        sentence = fieldgrid("export", f_map, f_map, *words).sentence()
        assert "which no export replaces" in sentence or f"format gpkg, not {name}" in sentence
    assert f_map.read_bytes() == before


@pytest.mark.parametrize(
    ("name", "limit"),
    [
        ("x.tif", 524_600),
        ("x.png", 500),
        ("x.kmz", 500),
        *(
            pytest.param(name, limit, marks=pytest.mark.long)
            for name in ("x.tif", "x.png", "x.kmz")
            for limit in (0, 500, 5_000, 100_000, 524_600, 600_000)
            if (name, limit) not in (("x.tif", 524_600), ("x.png", 500), ("x.kmz", 500))
        ),
    ],
)
def test_a_full_disk_leaves_the_older_file_or_a_whole_new_one(
    name: str, limit: int, fieldgrid_process: Run, f_map: Path, tmp_path: Path
) -> None:
    """Every file may grow to `limit` bytes and no further, as where a quota is used up."""
    out = tmp_path / name
    out.write_bytes(b"")
    before = (
        "import resource, signal\nsignal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        f"resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))"
    )
    done = fieldgrid_process("export", f_map, out, "--overwrite", before=before)
    if done.status == 0:
        assert name == "x.kmz" or limit == 600_000
        if name != "x.kmz":
            assert faults(opened(out)) == []
        return
    assert (done.status, limit < 600_000) == (1, True)
    assert "Traceback" not in done.err
    # What libraries print themselves comes before.
    assert done.err.splitlines()[-1].startswith("fieldgrid: ")
    assert "disk" in done.err.splitlines()[-1]
    assert [(file.name, file.read_bytes()) for file in tmp_path.iterdir()] == [(name, b"")]


@pytest.mark.parametrize(
    ("flags", "message"),
    [
        ("x.tif --mode raw", "value for --mode: the format geotiff does not take it, but --epsg"),
        ("x.kmz --epsg 4326", "value for --epsg: the format kmz does not take it"),
        (
            "x.yaml --min-area 3",
            "the format nav2 does not take it, but --free-up-to, ",
        ),
    ],
)
def test_options_of_other_formats(
    flags: str, message: str, fieldgrid: Run, f_map: Path, tmp_path: Path
) -> None:
    name, *words = flags.split()
    usage = fieldgrid("export", f_map, tmp_path / name, *words).usage()
    assert message in " ".join(usage.split())
    assert list(tmp_path.iterdir()) == []


def test_every_option_of_every_format_counts_or_is_refused(
    fieldgrid: Run, f_map: Path, tmp_path: Path
) -> None:
    """No option is ignored: a format that does not declare one refuses it."""
    flags = {
        one.flag.name: one.flag
        for known in formats().values()
        for one in known.declared()
        if one.flag is not None
    }
    for name, known in formats().items():
        taken = {one.flag.name for one in known.declared() if one.flag is not None}
        for flag in flags:
            words = [flag, "1"]
            result = fieldgrid("export", f_map, tmp_path / "no" / f"x{known.endings[0]}", *words)
            assert result.status == (1 if flag in taken else 2), (name, flag, result)
    assert list(tmp_path.iterdir()) == []


def test_the_help_lists_what_there_is(fieldgrid: Run) -> None:
    text = fieldgrid("export", "--help-all").output()
    for name, known in formats().items():
        (line,) = (line for line in text.splitlines() if line.split()[:1] == [name])
        assert all(ending in line for ending in known.endings)
        assert known.says in line
        for one in known.declared():
            assert one.flag is not None
            (told,) = re.findall(rf"^  {one.flag.name} .*?(?=\n  -|\n\n)", text, re.DOTALL | re.M)
            assert name in told
    listed = text.partition("Layers of a map")[2].partition("Examples:")[0]
    assert set(LAYERS) < set(listed.split())


def test_a_selection_is_the_same_in_python(f_map: Path) -> None:
    with open_map(f_map) as universal:
        assert Selection(layer="max").names(universal) == ["spring", "summer"]
        assert Selection(at="spring").names(universal) == ["spring"]


# --- formats of others


def test_a_format_of_another_module(f_map: Path, tmp_path: Path, fieldgrid: Run) -> None:
    """All that a format needs stands in one place: the options, the help line, the writer."""

    class CountOptions(Settings):
        above: int = setting(100, "density above which cells count", flag=Flag("--above", "N"))

    def write_count(
        universal: MapFile,
        path: Path,
        selection: Selection,
        options: CountOptions,
        *,
        overwrite: bool,
    ) -> Exported:
        """Write how many cells are above a density."""
        view = selection.view(universal)
        count = int(np.count_nonzero(view.observed & (view.density > options.above)))
        with replacing(path, overwrite=overwrite) as file:
            file.write_text(f"{count}\n")
        return Exported((path,), (("cells", str(count)),))

    before = dict(formats())
    try:
        register_export_format(
            ExportFormat("count", (".count",), "how many cells", write_count, CountOptions)
        )
        assert list(formats()) == [*before, "count"]
        with open_map(f_map) as universal:
            export_map(universal, tmp_path / "a.count", options={"above": 254})
            with pytest.raises(ConfigError, match="count has no option 'mode'; it takes above"):
                export_map(universal, tmp_path / "b.count", options={"mode": 1})
        text = fieldgrid("export", "--help-all").output()
        assert re.search(r"^ +count +\.count +how many cells$", text, re.MULTILINE)
        told = "--above N Density above which cells count (count) [default: 100]."
        assert told in " ".join(text.split())
        told = fieldgrid("export", f_map, tmp_path / "c.count", "--above", "0").output()
        assert int((tmp_path / "c.count").read_text()) > int((tmp_path / "a.count").read_text())
        assert re.search(r"^format +count$", told, re.MULTILINE)
        refused = fieldgrid("export", f_map, tmp_path / "d.count", "--epsg", "25830")
        assert "the format count does not take it, but --above" in refused.usage()
        for name, ending in (("count", ".other"), ("other", ".COUNT".lower()), ("tiff", ".tif")):
            with pytest.raises(ConfigError, match="registered already"):
                register_export_format(ExportFormat(name, (ending,), "again", write_count))
    finally:
        unregister_export_format("count")
    assert dict(formats()) == before
