"""The memory of what was worked out changes nothing but the time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fieldgrid.core import BuildSettings, MatcherKind, StereoSettings
from fieldgrid.geometry import StereoCamera
from fieldgrid.perception import StereoMatcher, stereo, whole_image
from fieldgrid.pipeline import build_map
from fieldgrid.pipeline.staging import perception
from tests.pipeline.drives.making import content
from tests.remembered import READERS, USES, Matcher, Memory, worked_out_once

CAMERA = StereoCamera(96, 64, 80.0, 48.0, 32.0, 0.2)
LEFT = np.random.default_rng(1).integers(0, 256, (64, 96), dtype=np.uint8)
RIGHT = np.roll(LEFT, -5, axis=1)


def disparities(left: np.ndarray, settings: StereoSettings, most: int = 16) -> np.ndarray:
    return StereoMatcher(CAMERA, settings, whole_image(CAMERA, most)).disparity(left, RIGHT).values


def test_what_is_remembered_is_what_is_matched() -> None:
    other = LEFT.copy()
    other[40:50, 40:60] = 7
    bm = StereoSettings(matcher=MatcherKind.BM)
    cases = ((LEFT, StereoSettings(), 16), (other, StereoSettings(), 16), (LEFT, bm, 16),
             (LEFT, StereoSettings(), 32))  # fmt: skip
    plain = [disparities(*case) for case in cases]
    assert len({values.tobytes() for values in plain}) == len(plain)
    with worked_out_once(Memory()):
        assert isinstance(stereo.make_matcher(StereoSettings(), 16), Matcher)
        for _ in range(2):
            for case, values in zip(cases, plain, strict=True):
                np.testing.assert_array_equal(disparities(*case), values)
    assert not isinstance(stereo.make_matcher(StereoSettings(), 16), Matcher)


def test_it_is_worked_out_once_and_each_has_its_own_copy() -> None:
    asked: list[tuple[Any, ...]] = []

    def doubled(array: np.ndarray, *, more: float = 0.0) -> np.ndarray:
        asked.append((array, more))
        return 2.0 * array + more

    recall = Memory().remembered(doubled)
    one = np.arange(4.0)
    first = recall(one)
    first[:] = -1.0
    np.testing.assert_array_equal(recall(one.copy()), 2.0 * one)
    assert len(asked) == 1
    np.testing.assert_array_equal(recall(one, more=1.0), 2.0 * one + 1.0)
    np.testing.assert_array_equal(recall(one.astype(np.float32)), 2.0 * one)
    assert recall(one.reshape(2, 2)).shape == (2, 2)
    assert len(asked) == 4


def test_the_oldest_is_forgotten_when_it_gets_too_much() -> None:
    asked: list[int] = []

    def zeros(count: int) -> bytes:
        asked.append(count)
        return bytes(count)

    recall = Memory(2500).remembered(zeros)
    for count in (1000, 1001, 1001, 1002, 1002, 1000):
        assert recall(count) == bytes(count)
    assert asked == [1000, 1001, 1002, 1000]


def test_processes_with_one_folder_work_it_out_once(tmp_path: Path) -> None:
    asked: list[int] = []

    def zeros(count: int) -> bytes:
        asked.append(count)
        return bytes(count)

    for memory in (Memory(2500, tmp_path / "shared"), Memory(2500, tmp_path / "shared")):
        recall = memory.remembered(zeros)
        for count in (1000, 1001, 1002):
            assert recall(count) == bytes(count)
    assert asked == [1000, 1001, 1002, 1002]  # the last is more than the first may leave there


def test_what_cannot_be_shared_is_remembered_all_the_same(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    recall = Memory(folder=tmp_path / "file" / "folder").remembered(bytes)
    assert recall(3) == recall(3) == bytes(3)


def test_what_fails_is_not_remembered() -> None:
    tried: list[int] = []

    def fails(number: int) -> None:
        tried.append(number)
        raise ValueError(number)

    recall = Memory().remembered(fails)
    for _ in range(2):
        with pytest.raises(ValueError, match="7"):
            recall(7)
    assert tried == [7, 7]


def test_a_file_is_read_again_when_it_has_another_content_or_name(tmp_path: Path) -> None:
    read: list[Path] = []

    def text_of(path: Path) -> str:
        read.append(path)
        return f"{path.name}: {path.read_text()}"

    recall = Memory().remembered_of_file(text_of)
    for folder, name, text in (("a", "x", "1"), ("b", "x", "1"), ("a", "x", "2"), ("a", "y", "1")):
        (tmp_path / folder).mkdir(exist_ok=True)
        (tmp_path / folder / name).write_text(text)
        assert recall(tmp_path / folder / name) == f"{name}: {text}"
    assert read == [tmp_path / "a" / "x", tmp_path / "a" / "x", tmp_path / "a" / "y"]
    with pytest.raises(FileNotFoundError):
        recall(tmp_path / "z")


def test_each_function_is_where_it_is_used() -> None:
    """Else a function that has moved would be worked out each time, and nobody would notice."""
    every = (*USES, *READERS)
    for work, users in every:
        for user in users:
            assert getattr(user, work.__name__) is work, (work.__name__, user)
    with worked_out_once():
        for work, users in every:
            for user in users:
                assert getattr(user, work.__name__) is not work
    assert perception.features is USES[0][0]


def test_a_map_is_the_same_worked_out_or_remembered(tmp_path: Path, make_drive: Any) -> None:
    drive = make_drive("drive", range(20, 24))
    build_map([drive], tmp_path / "plain.gpkg", BuildSettings())
    memory = Memory()
    with worked_out_once(memory):
        for name in ("first", "again"):
            build_map([drive], tmp_path / f"{name}.gpkg", BuildSettings())
    plain = content(tmp_path / "plain.gpkg")
    assert content(tmp_path / "first.gpkg") == plain
    assert content(tmp_path / "again.gpkg") == plain
