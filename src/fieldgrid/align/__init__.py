"""How the drives of a map lie against each other, and the transforms that make them coincide."""

from fieldgrid.align.alignment import (
    FINE_ROUNDS,
    REACH_M,
    DriveAlignment,
    MapAlignment,
    PairAlignment,
    align_map,
    undo_alignment,
)
from fieldgrid.align.drives import Role

__all__ = [
    "FINE_ROUNDS",
    "REACH_M",
    "DriveAlignment",
    "MapAlignment",
    "PairAlignment",
    "Role",
    "align_map",
    "undo_alignment",
]
