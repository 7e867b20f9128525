"""The normal equations of a drive: of the states of its nodes, and of a few constants."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fieldgrid.core import Float64
from fieldgrid.poses.smoother.envelope import STATES, Envelope

CONSTANTS = 5
"""Of a drive, beside the states of its nodes."""


class NormalEquations(NamedTuple):
    """Normal equations: `values` is the matrix of the nodes' states in the shape of an envelope,
    `border` [states, constants] couples them with the constants, `corner` is that of the constants
    alone. `total` is the sum of the squared residuals in units of their sigmas, and that of the
    logarithms of the weights."""

    shape: Envelope
    values: Float64
    right: Float64
    border: Float64
    corner: Float64
    right_constants: Float64
    total: Float64


def empty_system(
    shape: Envelope, values: Float64 | None = None, *, coupled: bool = True
) -> NormalEquations:
    """Normal equations that nothing has been added to. They take the memory of `values` if given,
    whose content `model.add_motion` replaces, which then has to come first. Where nothing measures
    a constant, none is `coupled` with the states and the border has no rows."""
    n = STATES * shape.nodes
    return NormalEquations(
        shape,
        np.zeros(shape.size) if values is None else values,
        np.zeros(n),
        np.zeros((n if coupled else 0, CONSTANTS)),
        np.zeros((CONSTANTS, CONSTANTS)),
        np.zeros(CONSTANTS),
        np.zeros(2),
    )
