"""How the drives of a map lie against each other, and the transforms that make them coincide."""

from fieldgrid.align.alignment import (
    FINE_ROUNDS,
    REACH_M,
    align_map,
    undo_alignment,
)
from fieldgrid.align.drives import Role
from fieldgrid.align.report import DriveAlignment, MapAlignment, PairAlignment

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
