"""The frozen figures: what the benchmarks printed when `frozen.json` was written, and what moved.

    python -m benchmarks.frozen --write [PART ...]   run parts and freeze what they print
    python -m benchmarks.frozen [PART ...]           run parts and print what moved
    python -m benchmarks.frozen --list               the parts, and how long they take

`make figures` and `make compare` do the first two, with PARTS="rows moved". Without parts all run,
which takes about two hours. A part is a benchmark: it runs in a process of its own, and each
number in what it prints is a figure (benchmarks/frozen_text.py names them). A figure moved if it
differs from the frozen one by more than its tolerance, which benchmarks/frozen_tolerances.py
derives. A tolerance may be edited in the file: with "by": "hand" beside it, writing keeps it. The
exit status is 1 if a figure moved, vanished or appeared, or if a part could not be compared.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks.frozen_text import Figure, figures_of
from benchmarks.frozen_tolerances import Times, tolerance_of

ROOT = Path(__file__).resolve().parents[1]
DATA = ROOT.parent / "shared" / "data"
FROZEN = Path(__file__).with_name("frozen.json")

RENDERED = ("vineyard_two_lanes", "vineyard_two_lanes_later", "vineyard_slope")
LOGS = ("gnss", "kitti_oxts")
ROAD = ("kitti_2011_09_30_drive_0020",)


class Part(NamedTuple):
    """A benchmark: its module and arguments, the data that it needs, whether it measures times, and
    the number of its random cases, None where nothing is drawn."""

    command: str
    needs: tuple[str, ...] = ()
    times: Times = Times.NONE
    cases: int | None = None


PARTS = {
    "heading": Part("benchmarks.heading", (*RENDERED, *LOGS, "vineyard_gnss_rows")),
    "heading_shunts": Part("benchmarks.heading_shunts", cases=96),
    "variations": Part("benchmarks.variations", RENDERED),
    "transformed": Part("benchmarks.transformed", (*RENDERED, *LOGS)),
    "stretches": Part("benchmarks.stretches", RENDERED),
    "damages": Part("benchmarks.damages"),
    "late_fixes": Part("benchmarks.late_fixes", cases=200),
    "faults": Part("benchmarks.faults"),
    "given_poses": Part("benchmarks.given_poses"),
    "accuracy": Part("benchmarks.accuracy"),
    "row_step": Part("benchmarks.row_step", (*RENDERED, *ROAD)),
    "rectified": Part("benchmarks.rectified", RENDERED[:1]),
    "mounting": Part("benchmarks.mounting", (*RENDERED[:1], *ROAD)),
    "clock": Part("benchmarks.clock", RENDERED[:1]),
    "align": Part("benchmarks.align 100", (*RENDERED, *ROAD), Times.SOME, cases=100),
    "poor_receivers": Part("benchmarks.poor_receivers", RENDERED),
    "good_receivers": Part("benchmarks.good_receivers", RENDERED),
    "changes": Part("benchmarks.changes", RENDERED[:2], Times.SOME),
    "moved": Part("benchmarks.moved", RENDERED),
    "random_drives_0": Part("benchmarks.random_drives 300 0", cases=300),
    "random_drives_5000": Part("benchmarks.random_drives 300 5000", cases=300),
    "rows": Part("benchmarks.rows", (*RENDERED, "vineyard_survey_lcas", "row_layouts"), Times.SOME),
    "routes": Part("benchmarks.routes", times=Times.SOME, cases=1000),
    "benchmarks": Part("benchmarks", times=Times.ALL),
    "parsing": Part("benchmarks.parsing", times=Times.ALL),
    "odometry": Part("benchmarks.odometry", ROAD, times=Times.ALL),
    "track_hour": Part("benchmarks.track_hour", times=Times.ALL),
    "intake": Part("benchmarks.intake", (*RENDERED, *LOGS, *ROAD)),
    "reading": Part("benchmarks.reading", RENDERED[:1], times=Times.ALL),
    "verifying": Part("benchmarks.verifying", times=Times.ALL),
    "drives": Part("benchmarks.drives", times=Times.ALL),
    "example_map": Part("benchmarks.example_map", times=Times.ALL),
}

TWO_SEEDS = ("random_drives_0", "random_drives_5000")
"""Their difference is what another seed gives."""

Frozen = dict[str, Any]
"""By part: "seconds" that it took, and "figures", by name "value" and "tolerance"."""


class NotMeasuredError(Exception):
    """A part has no figures; says why."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Freeze or compare; 1 if anything moved or could not be measured."""
    options = _parsed(arguments)
    frozen: Frozen = json.loads(options.file.read_text("utf-8")) if options.file.exists() else {}
    if options.list:
        for name in PARTS:
            print(_listed(name, frozen))
        return 0
    outputs = dict(text.split("=", 1) for text in options.output)
    work = _write if options.write else _compare
    good = True
    for name in options.parts or outputs or PARTS:
        try:
            start = time.perf_counter()
            figures = _figures(name, outputs)
            seconds = None if name in outputs else round(time.perf_counter() - start)
            good &= work(name, figures, seconds, frozen, options.file)
        except NotMeasuredError as why:
            print(f"{name}: not {'written' if options.write else 'compared'}: {why}", flush=True)
            good = False
    return 0 if good else 1


def _parsed(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="*", metavar="PART", help="default: all")
    parser.add_argument("--write", action="store_true", help="freeze the figures")
    parser.add_argument("--list", action="store_true", help="list the parts")
    parser.add_argument(
        "--output", action="append", default=[], metavar="PART=FILE",
        help="what a part printed, instead of running it",
    )  # fmt: skip
    parser.add_argument("--file", type=Path, default=FROZEN, help="default: %(default)s")
    options = parser.parse_args(arguments)
    for name in [*options.parts, *(text.split("=", 1)[0] for text in options.output)]:
        if name not in PARTS:
            parser.error(f"no part is called {name}; there are {', '.join(PARTS)}")
    if any("=" not in text for text in options.output):
        parser.error("--output takes PART=FILE")
    return options


def _listed(name: str, frozen: Frozen) -> str:
    part = frozen.get(name, {})
    seconds, figures = part.get("seconds"), len(part.get("figures", {}))
    minutes = "" if seconds is None else f"{seconds / 60.0:.1f} min"
    return f"{name:<20}{minutes:>10}{figures:>7} figures   {PARTS[name].command}"


def _figures(name: str, outputs: Mapping[str, str]) -> list[Figure]:
    """The figures of a part, from its output if that is given."""
    text = Path(outputs[name]).read_text("utf-8") if name in outputs else _run(PARTS[name])
    figures = figures_of(text)
    if not figures:
        raise NotMeasuredError("it printed no figures")
    return figures


def _run(part: Part) -> str:
    absent = [name for name in part.needs if not (DATA / name).exists()]
    if absent:
        raise NotMeasuredError(f"absent from ../shared/data: {', '.join(absent)}")
    command = [sys.executable, "-m", *part.command.split()]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    if done.returncode:
        raise NotMeasuredError(f"it failed with exit status {done.returncode}")
    return done.stdout


def _write(
    name: str, figures: Sequence[Figure], seconds: int | None, frozen: Frozen, file: Path
) -> bool:
    """Freeze the figures of a part; tolerances by hand stay."""
    part, before = PARTS[name], frozen.get(name, {})
    known = before.get("figures", {})
    entries = {}
    for figure in figures:
        tolerance = tolerance_of(figure, part.times, part.cases)
        entry: dict[str, float | str] = {"value": figure.value, "tolerance": _rounded(tolerance)}
        by_hand = known.get(figure.name, {})
        if by_hand.get("by") == "hand":
            entry |= {"tolerance": by_hand["tolerance"], "by": "hand"}
        entries[figure.name] = entry
    took = before.get("seconds") if seconds is None else seconds
    frozen[name] = {"seconds": took, "figures": entries}
    _widen(frozen)
    file.write_text(_as_text(frozen), "utf-8")
    print(f"{name}: {len(entries)} figures written", flush=True)
    return True


def _widen(frozen: Frozen) -> None:
    """By what the two seeds differ."""
    one, other = (frozen.get(name, {}).get("figures", {}) for name in TWO_SEEDS)
    for name in one.keys() & other.keys():
        apart = _rounded(abs(one[name]["value"] - other[name]["value"]))
        for entry in (one[name], other[name]):
            if entry.get("by") != "hand":
                entry["tolerance"] = max(entry["tolerance"], apart)


def _rounded(tolerance: float) -> float:
    return float(f"{tolerance:.3g}")


def _as_text(frozen: Frozen) -> str:
    """JSON with a line a figure, sorted."""
    parts = []
    for name in sorted(frozen):
        figures = frozen[name]["figures"]
        lines = [f"  {_json(key)}: {_json(figures[key])}" for key in sorted(figures)]
        seconds = _json(frozen[name]["seconds"])
        body = ",\n".join(lines)
        parts.append(f'{_json(name)}: {{"seconds": {seconds}, "figures": {{\n{body}\n}}}}')
    return "{\n" + ",\n".join(parts) + "\n}\n"


def _json(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)


def _compare(
    name: str, figures: Sequence[Figure], _seconds: int | None, frozen: Frozen, _file: Path
) -> bool:
    """Print what moved in a part."""
    if name not in frozen:
        raise NotMeasuredError("it has no frozen figures; write them first")
    known, found = frozen[name]["figures"], {figure.name: figure.value for figure in figures}
    moved = [
        f"{key}: was {known[key]['value']:g}, is {value:g}, tolerance {known[key]['tolerance']:g}"
        for key, value in found.items()
        if key in known and not _is_within(value, known[key])
    ]
    vanished = list(_lines(key for key in known if key not in found))
    appeared = list(_lines(key for key in found if key not in known))
    print(
        f"{name}: {len(found)} figures, {len(moved)} moved, {len(vanished)} lines vanished, "
        f"{len(appeared)} appeared"
    )
    for what, lines in (("moved", moved), ("vanished", vanished), ("appeared", appeared)):
        for line in lines:
            print(f"  {what}  {name} / {line}", flush=True)
    return not (moved or vanished or appeared)


def _is_within(value: float, entry: Mapping[str, Any]) -> bool:
    rounding = 1e-9 * max(1.0, abs(value))
    return bool(abs(value - entry["value"]) <= entry["tolerance"] + rounding)


def _lines(names: Iterator[str]) -> Iterator[str]:
    """Figures by their lines: a name where there is one of a line, else how many there are."""
    of_line: dict[str, list[str]] = {}
    for name in names:
        of_line.setdefault(name.rpartition(" / ")[0], []).append(name)
    for line, several in of_line.items():
        yield several[0] if len(several) == 1 else f"{line} ({len(several)} figures)"


if __name__ == "__main__":
    sys.exit(main())
