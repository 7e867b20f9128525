"""An IMU of a stream: its axes by what is said, by its frame, or by gravity, as of a bag."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fieldgrid.live.pose.sensor_rows import Rows
from fieldgrid.live.sources.imu_stream import HELD, ImuStream
from fieldgrid.recordings import Transforms

G = 9.81


def message(
    rates: tuple[float, ...], forces: tuple[float, ...], *, frame: str = "imu", felt: bool = True
) -> Any:
    return SimpleNamespace(
        header=SimpleNamespace(frame_id=frame),
        angular_velocity=SimpleNamespace(**dict(zip("xyz", rates, strict=True))),
        linear_acceleration=SimpleNamespace(**dict(zip("xyz", forces, strict=True))),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration_covariance=np.full(9, 0.0 if felt else -1.0),
    )


def said(stream: ImuStream, *messages: Any, count: int = HELD + 2) -> dict[str, list[Rows]]:
    """What comes of messages, over and over, each 10 ms."""
    found: dict[str, list[Rows]] = {}
    for k in range(count):
        for part, rows in stream.take(messages[k % len(messages)], 10_000_000 * (k + 1)):
            found.setdefault(part, []).append(rows)
    for part, rows in stream.finish():
        found.setdefault(part, []).append(rows)
    return found


def joined(chunks: list[Rows]) -> tuple[np.ndarray, ...]:
    return tuple(np.concatenate([rows.columns[k] for rows in chunks]) for k in range(2))


@pytest.mark.parametrize(
    ("axes", "frame", "rates", "forces"),
    [
        ("flu", "imu", (0.1, 0.2, 0.3), (0.5, 0.6, G)),
        ("frd", "imu", (0.1, -0.2, -0.3), (0.5, -0.6, -G)),
        ("flu", "left_optical", (-0.2, -0.3, 0.1), (-0.6, -G, 0.5)),
    ],
)
def test_rates_and_forces_are_in_the_vehicles_axes(
    axes: str, frame: str, rates: tuple[float, ...], forces: tuple[float, ...]
) -> None:
    stream = ImuStream(axes)
    found = said(stream, message(rates, forces, frame=frame))
    # Forward, left, up are 0.1, 0.2, 0.3; the vehicle's axes are right, forward, up.
    gyro = np.concatenate([rows.columns[0] for rows in found["gyro"]])
    assert gyro == pytest.approx(np.full(HELD + 2, -0.3))
    turned, felt = joined(found["inertial"])
    assert turned == pytest.approx(np.tile([-0.2, 0.1, 0.3], (HELD + 2, 1)))
    assert felt == pytest.approx(np.tile([-0.6, 0.5, G], (HELD + 2, 1)))
    assert not stream.notes


def test_an_accelerometer_may_count_in_g_and_be_missing() -> None:
    in_g = ImuStream("flu")
    _, felt = joined(said(in_g, message((0.1, 0.0, 0.0), (0.0, 0.0, 1.0)))["inertial"])
    assert felt[:, 2] == pytest.approx(np.full(HELD + 2, 9.80665))
    assert "in g" in in_g.notes[0]
    without = message((0.1, 0.0, 0.0), (0.0, 0.0, 0.0), felt=False)
    _, felt = joined(said(ImuStream("flu"), without)["inertial"])
    assert len(felt) == HELD + 2
    assert np.isnan(felt).all()
    # A sample without its force among others is left out.
    with_both = said(ImuStream("flu"), *[message((0.1, 0.0, 0.0), (0.0, 0.0, G))] * 2, without)
    assert np.isfinite(joined(with_both["inertial"])[1]).all()
    assert len(joined(with_both["inertial"])[1]) == round((HELD + 2) * 2 / 3)
    assert sum(len(rows.time_ns) for rows in with_both["gyro"]) == HELD + 2


def test_an_imu_on_its_side_tells_the_turn_alone() -> None:
    stream = ImuStream("flu")
    found = said(stream, message((0.1, 0.3, 0.2), (0.0, G, 0.0)))
    assert "inertial" not in found
    assert np.concatenate([rows.columns[0] for rows in found["gyro"]]) == pytest.approx(
        np.full(HELD + 2, -0.3)
    )
    assert "imu_axes" in stream.notes[0]


def test_an_imu_of_one_axis_tells_no_lean() -> None:
    one_axis = ImuStream("flu")
    still = message((0.0, 0.0, 0.3), (0.0, 0.0, G))
    assert set(said(one_axis, still)) == {"gyro"}
    # One that has stood still gives all its rows once it turns about others.
    whole = ImuStream("flu")
    assert "inertial" not in said(whole, still)
    moved = said(whole, message((0.01, 0.0, 0.3), (0.0, 0.0, G)), count=1)
    assert sum(len(rows.time_ns) for rows in moved["inertial"]) == HELD + 3


def test_few_messages_are_given_at_the_end() -> None:
    found = said(ImuStream("flu"), message((0.1, 0.2, 0.3), (0.0, 0.0, G)), count=3)
    assert [len(rows.time_ns) for rows in found["gyro"]] == [3]
    # And slow ones after a second.
    slow = ImuStream("flu")
    one = message((0.1, 0.2, 0.3), (0.0, 0.0, G))
    assert not slow.take(one, 10**9)
    assert [part for part, _ in slow.take(one, 2 * 10**9)] == ["gyro", "inertial"]


def placed(transforms: Transforms, child: str, parent: str, *xyzw: float) -> None:
    names = SimpleNamespace(frame_id=parent)
    turn = SimpleNamespace(**dict(zip("xyzw", xyzw, strict=True)))
    place = SimpleNamespace(translation=SimpleNamespace(x=0.0, y=0.0, z=1.0), rotation=turn)
    one = SimpleNamespace(header=names, child_frame_id=child, transform=place)
    transforms.add(SimpleNamespace(transforms=[one]))


UPSIDE_DOWN = 1.0, 0.0, 0.0, 0.0


def test_static_transforms_come_before_gravity_and_after_the_mounting() -> None:
    transforms = Transforms()
    placed(transforms, "imu", "base_link", *UPSIDE_DOWN)
    stream = ImuStream("flu", transforms)
    found = said(stream, message((0.1, -0.2, -0.3), (0.5, -0.6, -G)))
    turned, felt = joined(found["inertial"])
    assert turned == pytest.approx(np.tile([-0.2, 0.1, 0.3], (HELD + 2, 1)))
    assert felt == pytest.approx(np.tile([-0.6, 0.5, G], (HELD + 2, 1)))
    assert not stream.notes
    named = ImuStream("frd", transforms)
    assert joined(said(named, message((0.1, 0.2, 0.3), (0.0, 0.0, -G)))["inertial"])[0][
        0
    ] == pytest.approx([0.2, 0.1, -0.3])


def test_transforms_that_come_late_or_lead_in_a_circle_are_reported_once() -> None:
    transforms = Transforms()
    stream = ImuStream("flu", transforms)
    said(stream, message((0.1, 0.2, 0.3), (0.5, 0.6, G)))
    placed(transforms, "imu", "base_link", 0.0, 0.0, 0.0, 1.0)
    stream.check_transforms()
    assert not stream.notes  # they say what was taken
    for _ in range(2):
        placed(transforms, "imu", "base_link", *UPSIDE_DOWN)
        stream.check_transforms()
    (note,) = stream.notes
    assert "came after its first messages" in note
    circle = Transforms()
    placed(circle, "imu", "a", *UPSIDE_DOWN)
    placed(circle, "a", "imu", *UPSIDE_DOWN)
    placed(circle, "camera", "base_link", *UPSIDE_DOWN)
    lost = ImuStream("flu", circle)
    assert set(said(lost, message((0.1, 0.2, 0.3), (0.0, 0.0, G)))) == {"gyro", "inertial"}
    lost.check_transforms()
    (note,) = lost.notes
    assert "in a circle" in note
