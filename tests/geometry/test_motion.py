"""The motion of a drive."""

from __future__ import annotations

import numpy as np

from fieldgrid.geometry import Motion, Steps, WheelSpeed


def test_a_part_has_no_step_beyond_it() -> None:
    start_ns = np.arange(0, 50, 10)
    steps = Steps(start_ns, start_ns + 10, *(np.zeros(5) for _ in range(9)))
    wheels = WheelSpeed(np.arange(0, 60, 5), np.arange(12.0))
    parts = [Motion(wheels=wheels, steps=steps).between(*ends) for ends in ((0, 26), (26, 60))]
    assert [part.steps.start_ns.tolist() for part in parts if part.steps] == [[0, 10], [30, 40]]
    assert [part.wheels.speed_mps.tolist() for part in parts if part.wheels] == [
        [*range(6)],
        [*range(6, 12)],
    ]
    assert Motion(wheels=wheels).between(60, 70) == Motion()
