"""What `import fieldgrid` offers to a script, and what it costs."""

from __future__ import annotations

import importlib
import importlib.metadata
import json
import pkgutil
import subprocess
import sys
import types
import warnings
from collections.abc import Callable
from pathlib import Path

import matplotlib.figure
import numpy as np
import pytest

import fieldgrid
import fieldgrid as fg
from fieldgrid.core import BuildSettings, resolve
from fieldgrid.pipeline import build_map, repose_map
from tests.conftest import TWO_LANES

pytestmark = pytest.mark.usefixtures("worked_out_once")

MakeDrive = Callable[..., Path]


def modules_after(code: str) -> set[str]:
    """The packages that a Python has loaded after running some code."""
    report = "import sys, json; print(json.dumps(sorted({m.split('.')[0] for m in sys.modules})))"
    done = subprocess.run(
        [sys.executable, "-c", f"{code}\n{report}"], capture_output=True, text=True, check=True
    )
    return set(json.loads(done.stdout.splitlines()[-1]))


def test_the_import_is_light() -> None:
    heavy = {"numpy", "cv2", "numba", "matplotlib", "pyproj", "scipy", "pydantic", "rasterio"}
    assert not heavy & modules_after("import fieldgrid")


def test_the_command_line_is_light_until_a_command_runs() -> None:
    heavy = {"cv2", "numba", "matplotlib", "pyproj", "scipy", "rasterio"}
    code = (
        "import fieldgrid.cli as c, sys; sys.argv = ['fieldgrid', 'build', '--help']\ntry: c.main()"
    )
    assert not heavy & modules_after(f"{code}\nexcept SystemExit: pass")


def test_reading_a_map_needs_no_stereo() -> None:
    loaded = modules_after("import fieldgrid as fg; fg.open_map; fg.Bounds")
    assert not {"cv2", "matplotlib", "rasterio"} & loaded


@pytest.mark.parametrize("name", fieldgrid.__all__)
def test_every_name_is_there(name: str) -> None:
    thing = getattr(fieldgrid, name)
    assert (thing.__doc__ or "").strip()
    assert getattr(thing, "__module__", thing.__name__).startswith("fieldgrid.")


@pytest.mark.parametrize(
    "name",
    [name for name in fieldgrid.__all__ if name != "figures"],
)
def test_a_name_stays_what_it_is_once_its_module_is_loaded(name: str) -> None:
    """A submodule of the same name would replace it in the package when it is imported."""
    for room in pkgutil.iter_modules(fieldgrid.__path__):
        importlib.import_module(f"fieldgrid.{room.name}")
    thing = getattr(fieldgrid, name)
    assert not isinstance(thing, types.ModuleType)
    assert thing.__name__ == name
    assert getattr(importlib.import_module(thing.__module__), name) is thing


def test_names_are_listed_once_and_in_order() -> None:
    assert list(fieldgrid.__all__) == sorted(set(fieldgrid.__all__))
    assert set(dir(fieldgrid)) >= set(fieldgrid.__all__)


def test_star_import_gives_all_of_them() -> None:
    names: dict[str, object] = {}
    exec("from fieldgrid import *", names)
    assert set(fieldgrid.__all__) <= names.keys()


def test_the_version_is_that_of_the_package() -> None:
    assert fieldgrid.__version__ == importlib.metadata.version("fieldgrid")


def test_a_name_that_is_none() -> None:
    with pytest.raises(AttributeError, match="module 'fieldgrid' has no attribute 'build_all'"):
        _ = fieldgrid.build_all
    assert not hasattr(fieldgrid, "__wrapped__")


def test_the_example_in_python(
    make_drive: MakeDrive, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    make_drive("june-03", range(4, 9))
    monkeypatch.chdir(tmp_path)

    with fg.open_recording("june-03") as recording:
        steps = fg.visual_odometry(recording)
        trajectory = fg.estimate_trajectory(recording, steps=steps)
        with (
            fg.open_map("vineyard.gpkg", datum=trajectory.datum, cell_m=0.05) as universal,
            universal.add_session(recording.name, trajectory=trajectory) as session,
        ):
            for frame in recording.frames():
                grid = fg.local_grid(frame, recording.rig)
                session.add(grid, trajectory.at(frame.time_ns), frame_id=frame.frame_id)

    with warnings.catch_warnings():
        # The example leaves the map that it reads to the garbage collector.
        warnings.simplefilter("ignore", ResourceWarning)
        view = fg.open_map("vineyard.gpkg").read(cell_m=0.25)
    fg.figures.universal_grid(view).savefig("vineyard.png")

    assert view.lattice.cell_m == 0.25
    assert (view.density[view.observed] > 100).mean() > 0.02
    assert (view.density[view.observed] <= 50).mean() > 0.5
    assert Path("vineyard.png").stat().st_size > 5000
    # It says the same as the command does.
    build_map([Path("june-03")], Path("built.gpkg"), BuildSettings())
    with fg.open_map("built.gpkg") as built, fg.open_map("vineyard.gpkg") as by_hand:
        assert by_hand.sessions()[0].name == built.sessions()[0].name == "june-03"
        one, other = built.read(), by_hand.read()
    np.testing.assert_array_equal(one.density, other.density)
    np.testing.assert_array_equal(one.observed, other.observed)


def test_a_script_that_stops_half_way_leaves_no_map(make_drive: MakeDrive, tmp_path: Path) -> None:
    drive, out = make_drive(), tmp_path / "out" / "vineyard.gpkg"
    out.parent.mkdir()

    def add_one_and_stop() -> None:
        with fg.open_recording(drive) as recording:
            trajectory = fg.estimate_trajectory(recording)
            with (
                fg.open_map(out, datum=trajectory.datum) as universal,
                universal.add_session("x") as session,
            ):
                frame = next(iter(recording.frames()))
                session.add(fg.local_grid(frame, recording.rig), trajectory.at(frame.time_ns))
                raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        add_one_and_stop()
    assert list(out.parent.iterdir()) == []


def test_everything_raised_on_purpose_has_one_root(tmp_path: Path) -> None:
    for attempt in (
        lambda: fg.open_map(tmp_path / "nowhere.gpkg"),
        lambda: fg.open_recording(tmp_path),
        lambda: fg.read_truth(tmp_path),
        lambda: fg.Datum(99.0, 0.0, 0.0),
        lambda: fg.GridSpec(cell_m=-1.0),
    ):
        with pytest.raises(fg.FieldgridError):
            attempt()


def test_a_script_can_evaluate_more_than_one_map(two_lanes_map: Path) -> None:
    code = (
        "import sys, fieldgrid as fg\n"
        "from pathlib import Path\n"
        "truth = fg.read_truth(Path(sys.argv[2]))\n"
        "for _ in range(2):\n"
        "    with fg.open_map(sys.argv[1]) as universal:\n"
        "        print(fg.evaluate(universal, truth).cell_m)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(two_lanes_map), str(TWO_LANES / "truth")],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.split() == ["0.05", "0.05"], done.stderr


def test_paths_may_be_text(two_lanes_map: Path, make_drive: MakeDrive, tmp_path: Path) -> None:
    drive, out = make_drive("june-03", range(4, 6)), tmp_path / "map.gpkg"
    (tmp_path / "settings.toml").write_text("[map]\ncell_m = 0.2\n")
    settings = resolve(str(tmp_path / "settings.toml"), {})
    options = fg.DriveOptions(mounting=str(drive / "calibration" / "mounting.json"))
    build_map([str(drive)], str(out), settings, options)
    assert repose_map(str(out))[0].session == "june-03"
    assert fg.merge_maps([str(out)], str(tmp_path / "copy.gpkg"))[0].name == "june-03"
    with fg.open_map(str(tmp_path / "copy.gpkg")) as universal:
        assert universal.cell_m == 0.2
        assert fg.export_map(universal, str(tmp_path / "map.tif")).paths[0].is_file()
    fg.open_recording(str(TWO_LANES), gnss="gnss_rtk.nmea").close()
    assert len(fg.read_truth(str(TWO_LANES / "truth")).poses) == 50


def test_figures_is_the_module() -> None:
    assert fg.figures is importlib.import_module("fieldgrid.export.figures")
    assert isinstance(fg.figures.heading([]), matplotlib.figure.Figure)


@pytest.mark.parametrize(
    "shown",
    [
        "build.build_map",
        "build.repose.attitudes_of",
        "build.sensor_yaw",
        "evaluation.read_survey",
        "export.register_export_format",
        "fixes.FixColumns",
        "layers.register_layer",
        "live.LiveEvent",
        "live_servers.FoxgloveServer",
        "publish.replacing",
        "recording.columns_from_text",
        "recording.growing.open_growing",
        "rectify.camera_from_projections",
        "rig.LeverArm",
        "ros.gnss.quality_of",
        "trajectory.Status",
        "transfer.to_universal",
    ],
)
def test_import_paths_that_were_shown_keep_working(shown: str) -> None:
    module, _, name = f"fieldgrid.{shown}".rpartition(".")
    found: dict[str, object] = {}
    exec(f"from {module} import {name}", found)
    assert found[name] is getattr(importlib.import_module(module), name)
    assert not hasattr(importlib.import_module(module), "nothing_of_this_name")
