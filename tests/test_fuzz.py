"""A short run of what `make fuzz` does for longer."""

from __future__ import annotations

from pathlib import Path

import pytest

from fuzz.mutation import mutant
from fuzz.run import FuzzError, run_mutants
from fuzz.target import Target
from fuzz.targets import TARGETS


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
@pytest.mark.parametrize("most", [60, pytest.param(200, marks=pytest.mark.long)])
def test_hostile_input_does_no_harm(target: Target, most: int) -> None:
    run_mutants(target, seed=1, most=most)


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
def test_seeds_are_good_input(target: Target) -> None:
    seeds = target.seeds()
    assert seeds
    assert all(seeds)
    assert target.mend(seeds[0]) == seeds[0]


def test_a_seed_gives_the_same_mutants_again() -> None:
    first, again, other = (
        [mutant([b"abc,def", b"123"], bytes, seed, k) for k in range(50)] for seed in (7, 7, 8)
    )
    assert first == again
    assert first != other


def test_a_failing_input_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)

    def check(data: bytes) -> None:
        if len(data) < 5:
            raise IndexError("too short")

    with pytest.raises(FuzzError, match=r"small fails with IndexError: too short.*--replay"):
        run_mutants(Target("small", check, lambda: [b"0123456789"]), seed=1, most=10_000)
    (kept,) = (tmp_path / "build" / "fuzz").iterdir()
    assert len(kept.read_bytes()) < 5
