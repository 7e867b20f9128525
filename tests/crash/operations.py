"""Everything that changes a map, as steps that can be told apart afterwards."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fieldgrid.maps import Mark, MarkKind, Transform, create_map, merge_maps, open_map
from tests.maps.file.maps import CELL_M, DATUM, drive, track, write_session

State = dict[str, tuple[bool, float, float]]
"""The sessions of a map: whether each is active, the heading of its first frame as driven, and how
far east it was shifted."""


class Step(NamedTuple):
    """An operation on a map, and what it makes of the sessions."""

    name: str
    run: Callable[[Path], None]
    expected: Callable[[State], State]


def state_of(path: Path) -> State:
    """The sessions as the map tells of them; {} where there is no map."""
    if not path.exists():
        return {}
    with open_map(path) as universal:
        return {
            info.name: (
                info.active,
                next(universal.frames(info.name)).driven.heading_deg,
                info.transform.shift_east_m,
            )
            for info in universal.sessions()
        }


def add(name: str, heading_deg: float, frames: int) -> Step:
    def run(path: Path) -> None:
        with open_map(path, datum=DATUM, cell_m=CELL_M) as universal:
            write_session(universal, name, drive(frames, heading_deg=heading_deg), track(5))

    return Step(f"add {name}", run, lambda state: {**state, name: (True, heading_deg, 0.0)})


def remove(name: str) -> Step:
    def run(path: Path) -> None:
        with open_map(path, writable=True) as universal:
            universal.remove_session(name)

    return Step(f"remove {name}", run, lambda s: {**s, name: (False, *s[name][1:])})


def restore(name: str) -> Step:
    def run(path: Path) -> None:
        with open_map(path, writable=True) as universal:
            universal.restore_session(name)

    return Step(f"restore {name}", run, lambda s: {**s, name: (True, *s[name][1:])})


def repose(name: str, heading_deg: float) -> Step:
    def run(path: Path) -> None:
        with open_map(path, writable=True) as universal:
            count = sum(1 for _ in universal.frames(name))
            poses = {
                f"{k:06d}": pose
                for k, (_, pose) in enumerate(drive(count, heading_deg=heading_deg))
            }
            universal.repose(name, poses, track(7))

    return Step(f"repose {name}", run, lambda s: {**s, name: (s[name][0], heading_deg, s[name][2])})


def shift(name: str, east_m: float) -> Step:
    def run(path: Path) -> None:
        with open_map(path, writable=True) as universal:
            universal.set_transform(name, east_m, -1.5 * east_m, 7.0 * east_m)

    return Step(f"shift {name}", run, lambda s: {**s, name: (*s[name][:2], east_m)})


def rename(name: str, to: str) -> Step:
    def run(path: Path) -> None:
        with open_map(path, writable=True) as universal:
            universal.rename_session(name, to)

    def expected(state: State) -> State:
        return {to if key == name else key: value for key, value in state.items()}

    return Step(f"rename {name}", run, expected)


def align(names: tuple[str, ...], east_m: float) -> Step:
    """All of some drives put elsewhere at once, as an alignment does."""

    def run(path: Path) -> None:
        with open_map(path, writable=True) as universal:
            universal.set_transforms({name: Transform(east_m, 0.5, 1.0) for name in names})

    def expected(state: State) -> State:
        moved = {name: (*state[name][:2], east_m) for name in names}
        return {**state, **moved}

    return Step("align", run, expected)


def upgrade() -> Step:
    def run(path: Path) -> None:
        with open_map(path, writable=True) as universal:
            universal.upgrade()

    return Step("upgrade", run, lambda state: state)


def create(heading_deg: float) -> Step:
    """A new map with one session."""

    def run(path: Path) -> None:
        make(path, heading_deg)

    return Step("create", run, lambda _: {"0": (True, heading_deg, 0.0)})


def mark(east_m: float) -> Step:
    """A mark, and as many taken out or put back; the sessions are not changed."""

    def run(path: Path) -> None:
        with open_map(path, writable=True) as universal:
            corners = ((east_m, 0.0), (east_m + 1.0, 0.0), (east_m, 1.0))
            (number,) = universal.add_marks([Mark(MarkKind.KEEPOUT, corners, "pond")])
            universal.remove_marks([number])
            universal.restore_marks([number])

    return Step("mark", run, lambda state: state)


def repair() -> Step:
    def run(path: Path) -> None:
        keep = path.with_name("kept.gpkg")
        if keep.exists():
            keep.unlink()
        with open_map(path, writable=True) as universal:
            universal.repair(keep=keep)

    return Step("repair", run, lambda state: state)


def merge(into: Path) -> Step:
    """A copy that takes the place of an earlier one; the map itself is not changed."""

    def run(path: Path) -> None:
        merge_maps([path], into, overwrite=True)

    return Step("merge", run, lambda state: state)


def make(path: Path, heading_deg: float = 30.0) -> None:
    """A map with one session to begin with."""
    with create_map(path, DATUM, cell_m=CELL_M, overwrite=True) as universal:
        write_session(universal, "0", drive(3, heading_deg=heading_deg), track(4))


def random_step(random: np.random.Generator, state: State, number: int) -> Step:
    """Any step that is possible now."""
    active = sorted(name for name, (is_active, *_) in state.items() if is_active)
    removed = sorted(state.keys() - set(active))
    heading_deg = round(float(random.uniform(-170.0, 170.0)), 2)
    steps = [
        add(f"s{number}", heading_deg, int(random.integers(1, 9))),
        repose(str(random.choice(sorted(state))), heading_deg),
        shift(str(random.choice(sorted(state))), round(heading_deg / 100.0, 2)),
        mark(heading_deg),
        repair(),
    ]
    if len(active) > 1:
        steps.append(remove(str(random.choice(active))))
    if removed:
        steps.append(restore(str(random.choice(removed))))
    return steps[int(random.integers(len(steps)))]


def check(path: Path, allowed: list[State]) -> None:
    """The map is sound, and its sessions are one of the states that there may be."""
    with open_map(path) as universal:
        verdict = universal.verify(deep=True)
    assert verdict.sound, verdict.problems
    found = state_of(path)
    assert found in allowed, (found, allowed)
