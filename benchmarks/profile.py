"""Where the processor time goes of what takes longer than was asked.

    python -m benchmarks.profile start      # a build of two frames: imports, kernels, work
    python -m benchmarks.profile session    # durable sessions of ten grids into one map
    python -m benchmarks.profile health     # verify --deep and repair of four sessions
    python -m benchmarks.profile fold       # local grids of 133 x 280 into one window

All of it in one thread, where a profiler sees it, so that the interpreter's own share is up to a
third too large: the shares are for the order of things. What runs outside the interpreter's lock is
what a second core can take over.
"""

from __future__ import annotations

import cProfile
import os
import pstats
import re
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import fieldgrid
from benchmarks import EXAMPLE
from benchmarks.lasting import Line, add
from benchmarks.synthetic import DATUM, full_grid, real_grids, rows
from fieldgrid.geometry import GridSpec, Lattice, Pose
from fieldgrid.maps import create_map, footprint, open_map
from fieldgrid.maps.transfer import MeanFold

SESSIONS, PROFILED = 200, 30
SOURCE = os.path.join(os.path.dirname(fieldgrid.__file__), "")

BUILT_IN = (
    (r"sqlite3", "SQLite"),
    (r"isal|zlib|[Dd]ecompress", "DEFLATE"),
    (r"_hashlib|_sha2", "SHA-256"),
    (r"numpy|ufunc", "NumPy"),
)
LOCK_FREE = ("compiled kernels", "SQLite", "DEFLATE", "SHA-256")
"""Subjects that run outside the interpreter's lock, SQLite one call at a time."""

STEPS = {
    "staging.stage": "  staged",
    "window.add": "  folded frame by frame",
    "placing.encoded_of_session": "  encoded for the session",
    "pyramid._changed": "  added to the tiles of the map",
    "pyramid._raise_levels": "  the density of the levels above",
    "tiles.put": "  rows of tiles and pictures",
    "derived.show_features": "  features for a GIS",
    "row_sums._count": "  sums of rows",
    "row_sums._watch": "  triggers that find the rows",
    "styles.refresh_styles": "  QGIS styles, which name all sessions",
    "root.read_root": "  root digest, which is of all sessions",
}
"""Functions that stand for a step of a session, with all that they call; some call others."""


def main() -> None:
    """Print the shares of what is named."""
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    work: dict[str, Callable[[], Iterator[Line]]] = {
        "start": profile_start,
        "session": profile_session,
        "health": profile_health,
        "fold": profile_fold,
    }
    for name in sys.argv[1:] or work:
        print(name)
        for line in work[name]():
            print(f"  {line.what:<58} {line.value:>16}  {line.asked}", flush=True)


def profile_session() -> Iterator[Line]:
    """As `benchmarks.lasting` measures them, early ones beside late ones."""
    grids, early, late = real_grids(6.65, 14.0), _Profile(), _Profile()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.gpkg"
        for k in range(SESSIONS):
            profile = (
                early if 10 <= k < 10 + PROFILED else late if k >= SESSIONS - PROFILED else None
            )
            with open_map(path, datum=DATUM) as universal:
                row, along = divmod(k, 5)
                with profile or _Profile(), universal.add_session(f"{k:03d}") as session:
                    for n, pose in enumerate(rows(10, 21.0, 2.0, 3.0, 3.0 * row, 20.0 * along)):
                        session.add(grids[(k + n) % len(grids)], pose)
    ratio = late.seconds() / early.seconds()
    yield Line(f"the last {PROFILED} beside the {PROFILED} from the tenth on", f"{ratio:.2f} x")
    for what, function in (
        ("tiles of the map's own cells", "pyramid._changed"),
        ("tiles of all levels", "pyramid._encoded"),
    ):
        before, after = early.calls(function) / PROFILED, late.calls(function) / PROFILED
        yield Line(f"  {what}, each session", f"{before:.1f} and {after:.1f}")
    yield from late.lines("a session")
    for function, what in STEPS.items():
        yield Line(what, f"{100 * late.share(function):.0f} %", "with what it calls")


def profile_health() -> Iterator[Line]:
    """Of a map of four sessions of 200 frames over one field."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.gpkg"
        with create_map(path, DATUM) as universal:
            for k in range(4):
                add(universal, str(k), 3.7 * k, 2.9 * k)
        with open_map(path, writable=True) as universal:
            for what, work in (
                ("verify --deep", lambda: universal.verify(1, deep=True)),
                ("repair", lambda: universal.repair(1)),
            ):
                work()  # what is compiled is not its doing
                with _Profile() as profile:
                    work()
                yield from profile.lines(what)


def profile_fold() -> Iterator[Line]:
    """Full grids into cells as large as theirs, and larger."""
    grid = full_grid(GridSpec(6.65, 14.0), 1)
    for cell_m in (0.05, 0.25):
        lattice, pose = Lattice(cell_m), Pose(0, 12.34, -45.67, 0.0, 37.0, 0.02, 0.3, 1.0)
        fold = MeanFold(lattice, footprint(grid.spec, pose, lattice))
        fold.add(grid, pose)
        with _Profile() as profile:
            for _ in range(2000):
                fold.add(grid, pose)
        yield from profile.lines(f"2000 grids, cells of {100 * cell_m:.0f} cm")
        for kernel in ("transfer.locate", "transfer.add_values"):
            yield Line(f"  {kernel}", f"{100 * profile.share(kernel):.0f} %")


def profile_start() -> Iterator[Line]:
    """Of a process of its own, by what Python says of its imports."""
    program = (
        "import time; start = time.perf_counter(); import fieldgrid.cli.commands.build; "
        "import fieldgrid.pipeline.drives; "
        "imported = time.perf_counter(); import fieldgrid.cli; fieldgrid.cli.app({words}, "
        "standalone_mode=False); print('took', imported - start, time.perf_counter() - imported)"
    )
    with tempfile.TemporaryDirectory() as folder:
        words = ["build", str(EXAMPLE), "-o", f"{folder}/map.gpkg", "--gnss", "gnss_rtk.nmea"]
        words += ["--every", "25", "--overwrite"]
        command = [sys.executable, "-c", program.format(words=words)]
        subprocess.run(command, check=True, capture_output=True)
        plain = subprocess.run(command, check=True, capture_output=True, text=True)
        command.insert(1, "-Ximporttime")
        told = subprocess.run(command, check=True, capture_output=True, text=True).stderr
    before_s, after_s = map(float, plain.stdout.split("took")[-1].split())
    yield Line("imported before the first step", f"{before_s:.2f} s")
    yield Line("from there to the end", f"{after_s:.2f} s")
    own_ms = Counter[str]()
    for us, module in re.findall(r"^import time:\s+(\d+) \|\s+\d+ \|\s*(\S+)$", told, re.MULTILINE):
        own_ms[module.partition(".")[0]] += int(us) / 1e3
    yield Line(
        "all imports, also later ones, with the clock of each running", f"{own_ms.total():.0f} ms"
    )
    for package, ms in own_ms.most_common(8):
        yield Line(f"  {package}", f"{ms:.0f} ms")


class _Profile:
    """What ran within its blocks, in this thread, in seconds of processor time."""

    def __init__(self) -> None:
        self._profile = cProfile.Profile(time.process_time)

    def __enter__(self) -> _Profile:
        self._profile.enable()
        return self

    def __exit__(self, *_: object) -> None:
        self._profile.disable()

    def seconds(self) -> float:
        """All of it."""
        return sum(own_s for _, _, own_s, _ in self._rows())

    def calls(self, function: str) -> int:
        """How often a function ran, `module.name`."""
        return sum(calls for place, calls, _, _ in self._rows() if _named(place) == function)

    def share(self, function: str) -> float:
        """What a function took of all, with what it called."""
        return (
            sum(s for place, _, _, s in self._rows() if _named(place) == function) / self.seconds()
        )

    def lines(self, what: str) -> Iterator[Line]:
        """The subjects, the largest first."""
        shares, whole_s = Counter[str](), self.seconds()
        for place, _, own_s, _ in self._rows():
            shares[_subject(place)] += own_s / whole_s
        yield Line(what, f"{whole_s:.2f} s", "processor time, all of them")
        for subject, share in shares.most_common():
            yield Line(f"  {subject}", f"{100 * share:.0f} %")
        free = sum(shares[subject] for subject in LOCK_FREE)
        yield Line("  outside the interpreter's lock", f"{100 * free:.0f} %")
        most = 1.0 / (1.0 - free / 2.0)
        yield Line("  by which two cores are faster at most", f"{most:.2f} x")

    def _rows(self) -> Iterator[tuple[tuple[str, int, str], int, float, float]]:
        stats = pstats.Stats(self._profile).stats  # type: ignore[attr-defined]
        for place, (_, calls, own_s, all_s, _) in stats.items():
            yield place, calls, own_s, all_s


def _named(place: tuple[str, int, str]) -> str:
    return f"{Path(place[0]).stem}.{place[2]}"


def _subject(place: tuple[str, int, str]) -> str:
    file, _, name = place
    if file == "~":
        return next((of for pattern, of in BUILT_IN if re.search(pattern, name)), "other built-ins")
    if file.startswith(SOURCE):
        module = sys.modules.get(
            "fieldgrid." + file[len(SOURCE) : -len(".py")].replace(os.sep, ".")
        )
        one = getattr(module, name, None)
        is_kernel = hasattr(one, "py_func") or hasattr(one, "compiled")
        return "compiled kernels" if is_kernel else "Python of fieldgrid"
    return "NumPy" if "numpy" in file else "Python of others"


if __name__ == "__main__":
    main()
