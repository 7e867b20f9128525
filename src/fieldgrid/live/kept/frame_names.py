"""What the frames of a session are called, also of one that a restart counted anew."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

MOST_DIGITS = 18


def told_apart(names: Sequence[str]) -> list[str]:
    """Names of frames, those that came before with a number behind them. No map takes two frames of
    one name, and a source that is started again may count its frames from the beginning again."""
    told, seen, taken = list[str](), dict[str, int](), set(names)
    for name in names:
        made = name
        while made in seen or (made != name and made in taken):
            seen[name] += 1
            made = f"{name}-{seen[name]}"
        seen[made] = 1
        told.append(made)
    return told


def highest_number(names: Iterable[str]) -> int:
    """The highest number that is the name of a frame; 0 without."""
    numbers = (name for name in names if name.isdecimal() and len(name) <= MOST_DIGITS)
    return max(map(int, numbers), default=0)
