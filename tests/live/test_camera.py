"""A camera of one device or of two, as OpenCV gives it; the devices are made here."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np
import pytest

from fieldgrid.core import ConfigError
from fieldgrid.live import StereoDevices, parse_devices
from tests.live.sources import TIMEOUT_S, running
from tests.scenes import paper_rig

RIG = paper_rig()
WIDTH, HEIGHT = RIG.camera.width_px, RIG.camera.height_px


class Device:
    """Gives the pictures that it was given, each once, and waits for the next; None is a plug that
    is pulled out."""

    def __init__(self) -> None:
        self._pictures: list[Any] = []
        self._changed = threading.Condition()
        self.opened: list[tuple[int, int]] = []
        self.released = 0

    def open(self, number: int, size_px: tuple[int, int]) -> Device:
        self.opened.append(size_px)
        return self

    def give(self, picture: Any) -> None:
        with self._changed:
            self._pictures.append(picture)
            self._changed.notify()

    def grab(self) -> bool:
        with self._changed:
            assert self._changed.wait_for(lambda: bool(self._pictures), TIMEOUT_S)
            self._held = self._pictures.pop(0)
        return self._held is not None

    def retrieve(self) -> tuple[bool, Any]:
        return True, self._held

    def release(self) -> None:
        self.released += 1


def coloured(value: int, width: int = WIDTH) -> Any:
    return np.full((HEIGHT, width, 3), value, dtype=np.uint8)


def test_one_device_gives_both_sides_and_may_be_unplugged(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    device = Device()
    monkeypatch.setattr("fieldgrid.live.sources.camera.open_device", device.open)
    source = StereoDevices((0,), RIG, most_fps=1000.0)
    before_ns = time.time_ns()
    with running(source) as notes:
        both = np.hstack((coloured(10), coloured(20)))
        device.give(both)
        notes.wait(lambda: len(notes.frames) == 1)
        device.give(None)
        notes.wait_told("The camera 0 is not there (it gives no more pictures)")
        device.give(both + 1)
        notes.wait(lambda: len(notes.frames) == 2)
        notes.wait_told("The camera 0 is there again.")
        device.give(None)
    assert device.opened[0] == (2 * WIDTH, HEIGHT)
    assert device.released == len(device.opened) >= 2
    left, right = notes.frames[1].images()
    assert left.shape == right.shape == (HEIGHT, WIDTH)
    assert (left.max(), right.min()) == (11, 21)
    times_ns = [frame.time_ns for frame in notes.frames]
    assert before_ns < times_ns[0] < times_ns[1] < time.time_ns()


def test_two_devices_give_a_side_each(monkeypatch: pytest.MonkeyPatch) -> None:
    devices = {2: Device(), 0: Device()}

    def opener(number: int, size_px: tuple[int, int]) -> Device:
        return devices[number].open(number, size_px)

    monkeypatch.setattr("fieldgrid.live.sources.camera.open_device", opener)
    with running(StereoDevices((2, 0), RIG)) as notes:
        devices[2].give(coloured(10))
        devices[0].give(coloured(20)[:, :, 0])  # grey
        notes.wait(lambda: len(notes.frames) == 1)
        devices[2].give(None)
    assert devices[0].opened[0] == (WIDTH, HEIGHT)
    left, right = notes.frames[0].images()
    assert (left.max(), right.max()) == (10, 20)


def test_no_more_pairs_are_taken_than_were_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    device = Device()
    monkeypatch.setattr("fieldgrid.live.sources.camera.open_device", device.open)
    with running(StereoDevices((0,), RIG, most_fps=0.1)) as notes:
        for value in range(5):
            device.give(coloured(value, 2 * WIDTH))
        device.give(None)
        notes.wait_told("is not there")
        device.give(None)
    assert len(notes.frames) == 1


def test_a_device_of_this_machine_that_is_not_there() -> None:
    with running(StereoDevices((987,), RIG)) as notes:
        notes.wait_told("The camera 987 is not there (device 987 cannot be opened)")


@pytest.mark.parametrize("wrong", ["", "a", "0,1,2", "1,1", "-1", "9999"])
def test_what_is_no_camera(wrong: str) -> None:
    with pytest.raises(ConfigError, match="give "):
        parse_devices(wrong)
    with pytest.raises(ConfigError, match=r"outside 0.1..1000"):
        StereoDevices((0,), RIG, most_fps=0.0)
    assert parse_devices("0, 2") == (0, 2)
