"""What tests of every room share."""

from __future__ import annotations

import atexit
import csv
import gc
import os
import re
import select
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from datetime import datetime
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings

from fieldgrid.recordings import DriveOptions
from tests.once import RUN_FOLDER, made_once

if TYPE_CHECKING:
    from playwright.sync_api import Browser

    from fieldgrid.pipeline import SessionReport
    from tests.clusters import Cluster

# The first example of a kernel compiles it, and the machine has other work: time says nothing here.
# A property that names no number is tried with fewer examples with each change than by `make long`,
# which runs all properties, new examples of those that name one, and gives this profile.
settings.register_profile("long", deadline=None)
settings.register_profile("untimed", deadline=None, max_examples=40)
settings.load_profile("untimed")

ROOT = Path(__file__).resolve().parents[1]
SHARED_DATA = ROOT / ".." / "shared" / "data"
TWO_LANES = ROOT / "examples" / "two_lanes"
RTK_LOG = "gnss_rtk.nmea"
AROUND_S = 32.0
"""How long the log of a small drive goes on around its frames."""

MAP = "vineyard.gpkg"
HANGS_S = 900.0
"""A process that takes so long hangs. Compiling all kernels takes half a minute of a processor that
is free, and minutes of one that is not."""

# Beside other programs the threads of BLAS wait for each other longer than they work on bands as
# narrow as the smoother's. It is read when NumPy is imported, which comes after this.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# However pytest is started: compiling the tests takes three times as long as collecting them, and
# the hundreds of Pythons that they start would compile the whole package, each.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# The workers of xdist keep the memory of arrays instead of giving it back after each use: the
# tests of maps spent a quarter of their time on getting it anew. glibc reads this when a process
# starts, so the workers are given it, and what they start has its memory as everyone has it.
KEPT_MEMORY = {"MALLOC_MMAP_THRESHOLD_": str(64 << 20), "MALLOC_TRIM_THRESHOLD_": str(256 << 20)}
if "PYTEST_XDIST_WORKER" in os.environ:
    for name in KEPT_MEMORY:
        os.environ.pop(name, None)


def _remove(folder: str, owner: int) -> None:
    """At the end of the process that made a folder, and of no copy of it."""
    if os.getpid() == owner:
        shutil.rmtree(folder, ignore_errors=True)


# Files of tests lie in memory where there is room for them: a test waits for no disk when what it
# tests asks for its files to be kept, of which maps are many. Kills and cuts of power do not depend
# on what is below: the first lose nothing of a system that goes on, the second are modelled.
IN_MEMORY = Path("/dev/shm")
ROOM_BYTES = 3 << 30
if (
    "TMPDIR" not in os.environ
    and os.access(IN_MEMORY, os.W_OK)
    and shutil.disk_usage(IN_MEMORY).free >= ROOM_BYTES
):
    os.environ["PYTEST_DEBUG_TEMPROOT"] = str(IN_MEMORY)  # where folders of failed tests stay
    os.environ["TMPDIR"] = tempfile.mkdtemp(prefix="fieldgrid-tests-", dir=IN_MEMORY)
    os.environ[RUN_FOLDER] = os.environ["TMPDIR"]
    tempfile.tempdir = None  # asked for again
    # Programs that tests kill leave their folders. Processes of the run have inherited both.
    atexit.register(_remove, os.environ["TMPDIR"], os.getpid())


WHOLE_RUN = 1000
"""So many tests need most kernels."""


def _compile_a_share() -> None:
    """Two workers compile what frames need and what poses need, one each, before both need all."""
    from fieldgrid.core import BuildSettings
    from fieldgrid.live.pushed import warm_up
    from fieldgrid.live.warming import warm_up_poses
    from fieldgrid.perception import LocalGridder
    from tests.scenes import paper_rig

    worker = os.environ.get("PYTEST_XDIST_WORKER")
    if worker == "gw0":
        warm_up(LocalGridder(paper_rig()), odometry=True)
    elif worker == "gw1":
        warm_up_poses(paper_rig(), BuildSettings())


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_setupnodes() -> None:
    """Comes before the workers are started."""
    os.environ.update(KEPT_MEMORY)


def pytest_collectstart(collector: pytest.Collector) -> None:
    """The second worker imports the tests from the last to the first: on a fresh clone each then
    compiles about half of them, and loads what the other has compiled."""
    if (
        collector.path == ROOT / "tests"
        and os.environ.get("PYTEST_XDIST_WORKER") == "gw1"
        and [Path(one).resolve() for one in collector.config.args] == [ROOT / "tests"]
    ):
        for path in sorted((ROOT / "tests").rglob("test_*.py"), reverse=True):
            # What cannot be imported, or is skipped, is reported when it is collected.
            with suppress(Exception, pytest.skip.Exception):
                import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))


def pytest_collection_finish(session: pytest.Session) -> None:
    """Spares the collector of garbage the half million objects that stay until the end.

    It took 4 of 100 seconds of processor time.
    """
    if len(session.items) >= WHOLE_RUN:
        _compile_a_share()
    gc.collect()
    gc.freeze()
    gc.set_threshold(100_000, 20, 20)


def wait_for_end(process: int) -> None:
    """Waits for a process that may be another's child (on Linux)."""
    with suppress(ProcessLookupError):
        handle = os.pidfd_open(process)
        ended = select.poll()
        ended.register(handle, select.POLLIN)
        try:
            assert ended.poll(1000.0 * HANGS_S), f"process {process} hangs"
        finally:
            os.close(handle)


@pytest.fixture
def shared_data() -> Callable[[str], Path]:
    """Finds real data by its path below the shared folder, or skips the test."""

    def find(name: str) -> Path:
        path = SHARED_DATA / name
        if not path.exists():
            pytest.skip(f"real data {name} is not beside the repository, in ../shared/data")
        return path

    return find


@pytest.fixture(scope="session")
def built_two_lanes(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, SessionReport]:
    """The map of the whole example, with its RTK log, and the report of the build.

    It is made once, for all processes of the run: read it, or copy it.
    """
    from fieldgrid.core import BuildSettings
    from fieldgrid.pipeline import build_map
    from tests.remembered import worked_out_once

    def build(folder: Path) -> SessionReport:
        out = folder / MAP
        with worked_out_once():  # for the others that look at all its frames
            (report,) = build_map([TWO_LANES], out, BuildSettings(), DriveOptions("gnss_rtk.nmea"))
        return report

    folder, report = made_once(tmp_path_factory, "two_lanes", build)
    return folder / MAP, report


@pytest.fixture(scope="session")
def two_lanes_map(built_two_lanes: tuple[Path, SessionReport]) -> Path:
    """The path of the map of the whole example; read it, or copy it."""
    return built_two_lanes[0]


def make_small_drive(folder: Path, frames: Iterable[int]) -> Path:
    """A small recording out of frames of the example; images are links, to be replaced.

    Its log begins and ends `AROUND_S` before and after the frames: most of the time of a build of
    few frames would go to the poses of a minute in which there are none.
    """
    for side in ("left", "right", "gnss"):
        (folder / side).mkdir(parents=True)
    shutil.copytree(TWO_LANES / "calibration", folder / "calibration")
    shutil.copy(TWO_LANES / "session.json", folder)
    with (TWO_LANES / "frames.csv").open(newline="") as table:
        rows = list(csv.DictReader(table))
    kept = [rows[k] for k in frames]
    with (folder / "frames.csv").open("w", newline="") as table:
        writer = csv.DictWriter(table, rows[0].keys())
        writer.writeheader()
        writer.writerows(kept)
    log = (TWO_LANES / "gnss" / RTK_LOG).read_text(encoding="ascii")
    (folder / "gnss" / RTK_LOG).write_text(_log_of(log, kept), encoding="ascii")
    for row in kept:
        for side in ("left", "right"):
            (folder / row[side]).symlink_to(TWO_LANES / row[side])
    return folder


def _log_of(log: str, frames: Sequence[dict[str, str]]) -> str:
    """The sentences of a log around frames, all of them where there are no frames.

    The sentences of an epoch follow its GGA, whose second field is the time of the day.
    """
    if not frames:
        return log
    days = [datetime.fromisoformat(row["timestamp_iso"]) for row in frames]
    from_s, to_s = (_day_s(f"{day:%H%M%S.%f}") for day in (min(days), max(days)))
    epochs = re.split(r"(?=^\$GPGGA,)", log, flags=re.MULTILINE)
    return "".join(
        epoch
        for epoch in epochs
        if epoch and from_s - AROUND_S <= _day_s(epoch.split(",", 2)[1]) <= to_s + AROUND_S
    )


def _day_s(clock: str) -> float:
    """Seconds of the day of hhmmss.ss."""
    return 3600.0 * int(clock[:2]) + 60.0 * int(clock[2:4]) + float(clock[4:])


@pytest.fixture
def make_drive(tmp_path: Path) -> Callable[..., Path]:
    """Makes small recordings out of frames of the example; images are links, to be replaced."""

    def make(name: str = "drive", frames: Iterable[int] = range(3, 6)) -> Path:
        return make_small_drive(tmp_path / name, frames)

    return make


@pytest.fixture
def worked_out_once() -> Iterator[None]:
    """For tests that are about neither what pairs show nor where drives went: this process works
    each of that out once."""
    from tests.remembered import worked_out_once

    with worked_out_once():
        yield


@pytest.fixture
def worked_out_afresh() -> None:
    """For tests of threads, processes and memory in a folder where the others share what was worked
    out: nothing is remembered for them."""


@pytest.fixture(scope="session")
def _one_cluster() -> Iterator[Cluster]:
    pytest.importorskip("distributed")
    from tests.clusters import started

    with started() as one:
        yield one


@pytest.fixture
def cluster(_one_cluster: Cluster) -> Cluster:
    """A Dask cluster with all its workers: that of this process, for what needs no other."""
    _one_cluster.complete()
    return _one_cluster


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """Debian's Chromium, headless; the test is skipped where it or Playwright is not there."""
    from tests.view.browsing import CHROMIUM_FLAGS, chromium

    program = chromium()
    if program is None:
        pytest.skip("there is no Chromium for tests in a browser (Debian's package chromium)")
    driver = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    # Nothing is fetched: not by Playwright, and not by the browser at its start.
    os.environ["PLAYWRIGHT_SKIP_BROWSER_DOWNLOAD"] = "1"
    with driver.sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=program, args=CHROMIUM_FLAGS)
        yield started
        started.close()


@pytest.fixture
def look(browser: Browser, request: pytest.FixtureRequest) -> Iterator[Any]:
    """Opens pages that are watched; in the end nothing may have gone wrong in any of them."""
    from tests.view.browsing import Watched

    opened: list[Watched] = []

    def open_page(link: str, **options: Any) -> Watched:
        page = Watched.open(browser, link, **options)
        opened.append(page)
        return page

    yield open_page
    for page in opened:
        page.close()
