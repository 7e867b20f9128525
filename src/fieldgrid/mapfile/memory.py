"""Memory of tiles: taken, freed and taken again, thousands of times, without the system."""

from __future__ import annotations

import numpy as np

_LARGEST_BYTES = (32 << 20) - (64 << 10)
"""A block that is no larger than what glibc adapts its thresholds to."""


def keep_freed_memory() -> None:
    """Have the allocator keep the memory of arrays that are freed.

    glibc takes each array above a threshold from the system, and gives it back when it is freed.
    Its pages are then cleared and mapped anew for the next array, which takes longer than most of
    what is done with the cells of a tile. The threshold starts at 128 KB and becomes the size of
    any larger block that is freed, up to 32 MB; a tile has 512 KB (mallopt(3)). So a large block is
    freed here, of which no page was ever touched: two system calls. Other allocators do not mind.

    The cost: from then on the whole process, other programs' code in it too, keeps up to 64 MB of
    what each of its threads' arenas has freed (with 4 threads 547 MB were resident instead of 340).
    There is no way back, so only what folds or writes drives calls this, and no reader.
    """
    np.empty(_LARGEST_BYTES, np.uint8)
