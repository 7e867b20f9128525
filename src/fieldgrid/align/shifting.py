"""Sums of pictures that are each shifted by parts of a cell."""

from __future__ import annotations

import math

import numpy as np

from fieldgrid.array_types import Float64
from fieldgrid.kernel import kernel


def shifted_sums(pictures: Float64, rows: Float64, columns: Float64) -> Float64:
    """The sums [t, h, w] of pictures [p, h, w], each shifted by `rows` and `columns` [t, p] cells:
    between cells linear, and 0 beyond the outermost."""
    total = np.zeros((len(rows), *pictures.shape[1:]))
    add_shifted(
        *(np.ascontiguousarray(one, dtype=np.float64) for one in (pictures, rows, columns)), total
    )
    return total


@kernel
def add_shifted(pictures, rows, columns, total):  # type: ignore[no-untyped-def]
    """Add to `total` [t, h, w] the pictures as :func:`shifted_sums` has it."""
    count, height, width = pictures.shape
    for t in range(len(total)):
        for p in range(count):
            down, right = math.floor(rows[t, p]), math.floor(columns[t, p])
            part_down, part_right = rows[t, p] - down, columns[t, p] - right
            for j in range(height):
                # The cell above which this one lies, and by how much of a cell.
                y = j - rows[t, p]
                if y < 0.0 or y > height - 1:
                    continue
                high, low = j - down, max(j - down - 1, 0)
                high = min(high, height - 1)
                for i in range(width):
                    x = i - columns[t, p]
                    if x < 0.0 or x > width - 1:
                        continue
                    far, near = min(i - right, width - 1), max(i - right - 1, 0)
                    upper = pictures[p, high, far] * (1.0 - part_right)
                    upper += pictures[p, high, near] * part_right
                    lower = pictures[p, low, far] * (1.0 - part_right)
                    lower += pictures[p, low, near] * part_right
                    total[t, j, i] += upper * (1.0 - part_down) + lower * part_down
