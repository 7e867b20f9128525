"""The verdicts of conditioning fix by fix, as the tests ask for them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from fieldgrid.fixes import Fix, FixColumns
from fieldgrid.gnss import DEFAULT_LIMITS, Gate, condition
from fieldgrid.settings import GateLimits


class Judged(NamedTuple):
    """The verdict on one fix."""

    ok: bool
    gate: Gate = Gate.NONE
    reason: str = ""


def judge(fixes: Iterable[Fix], limits: GateLimits = DEFAULT_LIMITS) -> list[Judged]:
    """The verdict on each fix, in their order."""
    verdicts = condition(FixColumns.of_rows(fixes), limits)
    return [Judged(*one) for one in zip(verdicts.ok.tolist(), *verdicts[1:], strict=True)]
