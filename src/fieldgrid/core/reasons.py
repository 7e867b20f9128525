"""Reasons for refusals, counted: those that differ in their numbers only are one."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping


def grouped_reasons(reasons: Mapping[str, int]) -> list[tuple[int, str]]:
    """The commonest first: how many, and one of them. None is "" (no reason)."""
    groups: dict[str, list[tuple[int, str]]] = {}
    for reason, count in reasons.items():
        if reason:
            groups.setdefault(re.sub(r"\d+(\.\d+)?", "#", reason), []).append((count, reason))
    totals = [(sum(n for n, _ in group), max(group)[1]) for group in groups.values()]
    return sorted(totals, key=lambda total: -total[0])


def commonest_reason(reasons: Iterable[str]) -> str:
    """One of the largest group; there must be one."""
    return grouped_reasons(Counter(reasons))[0][1]
