"""What the frames of a session are called, also of one that a restart counted anew."""

from __future__ import annotations

from collections.abc import Sequence


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
