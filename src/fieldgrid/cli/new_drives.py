"""How new drives lie against those that a map had: compared, aligned if asked for, and told."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fieldgrid.cli import output, progress

_MOST_OTHERS = 4
"""Number of new and of older drives that a new drive is compared with where nothing is aligned:
that shows where it lies."""

_MOST_PAIRS = 10
"""Of more pairs of drives than these, only those are listed that do not agree."""


def compare(
    out: Path,
    new: list[str],
    wait_s: float,
    *,
    align: bool = False,
    jobs: int | None = None,
    scheduler: str | None = None,
) -> list[dict[str, Any]]:
    """How new drives lie against the map, and, with `align`, their transforms in it."""
    from fieldgrid.maps import open_map

    patience = progress.patience(out, wait_s)
    with open_map(out, writable=align, patience=patience) as universal:
        placed = {info.name for info in universal.sessions() if info.active and info.accepted}
        moving = [name for name in new if name in placed]
        if not moving or len(placed) < 2:
            return []
        from fieldgrid.field import (
            FINE_ROUNDS,  # not for a map of one drive
            align_map,
        )

        with progress.stages() as show:
            found = align_map(
                universal,
                moving,
                rounds=FINE_ROUNDS if align else 0,
                most_others=None if align else _MOST_OTHERS,
                progress=show,
                jobs=jobs,
                scheduler=scheduler,
            )
        if align and found.transforms:
            universal.set_transforms(found.transforms)
    return [
        {
            "of": pair.b if pair.b in new else pair.a,
            "against": pair.a if pair.b in new else pair.b,
            "lay_apart_m": [float(v) * (1.0 if pair.b in new else -1.0) for v in pair.before_m],
            "sigma_m": pair.sigma_m if pair.doubt is None else None,
            "doubt": pair.doubt,
            "aligned": align and pair.doubt is None,
        }
        for pair in found.pairs
    ]


def report_offsets(pairs: Sequence[dict[str, Any]], out: Path) -> None:
    """The offsets of new drives, a line for each pair; of many pairs only those that do not
    agree."""
    shown = [pair for pair in pairs if len(pairs) <= _MOST_PAIRS or not _agrees(pair)]
    for pair in shown:
        output.report_line(_sentence(pair, out))
    if agree := len(pairs) - len(shown):
        output.report_line(f"pairs of drives that agree within two standard errors: {agree}")


def _sentence(pair: dict[str, Any], out: Path) -> str:
    """The offset of a new drive from an older one."""
    east_m, north_m = pair["lay_apart_m"]
    between = f"{pair['of']} against {pair['against']}"
    if pair["doubt"] is not None:
        return f"{between}: {pair['doubt']}; not aligned"
    apart = f"{between}: {east_m:+.2f} m east, {north_m:+.2f} m north ± {pair['sigma_m']:.2f} m"
    if pair["aligned"]:
        return f"{apart}, aligned"
    return apart if _agrees(pair) else f"{apart}; `fieldgrid align {out}` makes them coincide"


def _agrees(pair: dict[str, Any]) -> bool:
    """Whether a new drive lies where an older one does, as far as can be told."""
    return pair["doubt"] is None and math.hypot(*pair["lay_apart_m"]) <= 2.0 * pair["sigma_m"]
