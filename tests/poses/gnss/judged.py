"""The verdicts of conditioning fix by fix, as the tests ask for them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

from fieldgrid.core import GateLimits
from fieldgrid.geometry import Fix, FixColumns
from fieldgrid.poses import Gate
from fieldgrid.poses.gates.conditioning import condition
from fieldgrid.poses.gates.verdict import DEFAULT_LIMITS


class Judged(NamedTuple):
    """The verdict on one fix."""

    ok: bool
    gate: Gate = Gate.NONE
    reason: str = ""


def judge(fixes: Iterable[Fix], limits: GateLimits = DEFAULT_LIMITS) -> list[Judged]:
    """The verdict on each fix, in their order."""
    verdicts = condition(FixColumns.of_rows(fixes), limits)
    return [Judged(*one) for one in zip(verdicts.ok.tolist(), *verdicts[1:], strict=True)]
