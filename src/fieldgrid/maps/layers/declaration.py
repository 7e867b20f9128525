"""What a channel group and a layer declare; everything else about them follows from it.

A *channel* is a whole number for each cell (unsigned, modulo 2^64). A *channel group* is the
channels that are accumulated and stored together. A *layer* is what a user reads: values made of
channels. Nothing here depends on the order of frames or sessions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from typing import Protocol, Self

import numpy as np

from fieldgrid.core import AnyArray, Bool, Ramp, Stop, UInt64
from fieldgrid.geometry import Lattice
from fieldgrid.maps.layers.frame import FrameInPlace


class Combine(StrEnum):
    """How two values of a channel become one."""

    SUM = "sum"
    """Added, and subtracted again when a session leaves, exactly: all is modulo 2^64."""

    MAX = "max"
    """The larger one; made again from what stays when a session leaves."""

    ABSENT = "absent"
    """Of base cells only: a larger cell has no such channel."""


class Cells(dict[str, UInt64]):
    """The channels of some cells by name, uint64 [rows north, columns east].

    Each cell stands for `base_cells` cells of the lattice that frames were folded into. Where that
    is no whole number, base cells are cut into parts, and `base_cells` counts these, like the sums
    of overviews. Those of a tile have one value for each block of `block` x `block` cells in the
    channels of groups with `blocks`.
    """

    def __init__(self, arrays: Mapping[str, UInt64], base_cells: int = 1, block: int = 1) -> None:
        super().__init__(arrays)
        self.base_cells = base_cells
        self.block = block

    @property
    def observed(self) -> Bool:
        """The cells that have any weight."""
        return np.asarray(self["weight"] > 0)


@lru_cache(maxsize=64)
def nothing(shape: tuple[int, ...]) -> UInt64:
    """A channel that is 0 everywhere: one 0 that is repeated, takes no memory and stays so.

    Many drives have none of what a channel is for, and a tile of zeros costs as much as any other.
    """
    return np.broadcast_to(np.uint64(0), shape)


def is_nothing(channel: UInt64) -> bool:
    """Whether `nothing` made a channel. Kernels take none: they are compiled for other arrays."""
    return not any(channel.strides) and channel.size > 1 and not channel.flat[0]


def has_any(channel: UInt64) -> bool:
    """Whether a channel is other than 0 anywhere."""
    if is_nothing(channel):
        return False
    if channel.strides[-1] == channel.itemsize:
        channel = channel.view(np.bool_)  # whose search ends at the first that is
    return bool(channel.any())


@dataclass(frozen=True, slots=True)
class Channel:
    """A stored channel.

    `sessions` says how the sessions meet in a base cell, `coarser` how base cells meet in a larger
    one. `signed` values are stored as small numbers of either sign. What is stored of a channel of
    base cells is the difference from `guess`, if there is one: of the channels `guessed_from`,
    which come before it in its group. It must give 0 where these are 0.
    """

    name: str
    sessions: Combine = Combine.SUM
    coarser: Combine = Combine.SUM
    signed: bool = False
    guess: Callable[..., UInt64] | None = None
    guessed_from: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class OverviewChannel:
    """A channel that follows from the other channels of its group in a base cell, and is stored
    only of larger cells, where it no longer does. See `Channel` for `signed`. Without `of_base` it
    is one of those that the group's `overview_of_base` makes."""

    name: str
    coarser: Combine
    of_base: Callable[[Cells], UInt64] | None = None
    signed: bool = False


class Fold(Protocol):
    """Takes up the frames of one session over a window of cells."""

    def add(self, frame: FrameInPlace) -> None:
        """Add a frame to the cells that it lands in."""

    def channels(self) -> Iterable[UInt64]:
        """The channels so far, or what the group unfolds to them, uint64 [cells] each; a cell
        without a frame is all 0.

        Where no frame had anything to tell, `nothing` says so.
        """


@dataclass(frozen=True, slots=True)
class ChannelGroup:
    """Channels that are accumulated and stored together.

    They come from the frames (`fold`, given the number of cells and the lattice) or from a
    session's finished density (`of_session`, given its `Cells`; returns [channels, ...]). `frame`
    names channels of a frame's evidence that are needed beyond density and mask; others may be left
    out. `expected` guesses
    each channel from a cell's weight and sum, flat arrays, as they are when it was seen once or
    always alike: what is stored is the difference, which is mostly 0 and costs nothing. It must
    give 0 for a cell of weight 0. With `blocks` there is one value for each block of cells
    (`maps.layers.blocks`), of which `fold` is given the number; such a group has no
    `expected`. `of_frames` says that the frames of several sessions fold into what these make
    together, so that a read folds them at once. `overview_of_base` makes the overview channels that
    share a calculation, those without `of_base`, at once. `unfold` makes the channels of a part of
    the window from what the fold gave of it, where that is less; it must give 0 for 0.

    A group without channels is *derived*: its overview channels follow from base cells of the
    groups that it `follows_from`, and are never stored.
    """

    name: str
    channels: tuple[Channel, ...]
    fold: Callable[[int, Lattice], Fold] | None = None
    of_session: Callable[[Cells], UInt64] | None = None
    overview: tuple[OverviewChannel, ...] = ()
    overview_of_base: Callable[[Cells], Iterable[UInt64]] | None = None
    unfold: Callable[[Sequence[UInt64]], Iterable[UInt64]] | None = None
    expected: Callable[[UInt64, UInt64], Iterable[UInt64]] | None = None
    frame: tuple[str, ...] = ()
    follows_from: tuple[str, ...] = ()
    blocks: bool = False
    of_frames: bool = False

    @property
    def derived(self) -> bool:
        """Whether the group has no channels of its own, so that tiles hold nothing of it."""
        return not self.channels


@dataclass(frozen=True, slots=True)
class Colours:
    """How values are drawn: from the first of `stops` (`#rrggbb`) at `low` to the last at `high`.

    Without `low` and `high` they are those of the data. The stops are evenly spaced, or at
    `shares` of the way, which do not decrease; two of one share make an edge.
    """

    stops: tuple[str, ...]
    low: float | None = None
    high: float | None = None
    shares: tuple[float, ...] = ()

    @classmethod
    def of(cls, ramp: Ramp, low: float | None = None, high: float | None = None) -> Self:
        """The colours of a ramp of the palette."""
        return cls(
            tuple(stop.colour for stop in ramp), low, high, tuple(stop.share for stop in ramp)
        )

    @property
    def ramp(self) -> Ramp:
        """The stops and where they are."""
        shares = self.shares or np.linspace(0.0, 1.0, len(self.stops)).tolist()
        return tuple(Stop(share, colour) for share, colour in zip(shares, self.stops, strict=True))


@dataclass(frozen=True, slots=True)
class Surroundings:
    """How the cells about a cell enter into what a layer says of it.

    `of(values, reach_cells)` is given the values of a window [rows, columns], NaN where there is
    none, and the reach in cells of that window. What it says of a cell depends on the cells whose
    centres are no farther than that; so it may be wrong by the edges of the window, which are cut
    off. In cells that are larger than `reach_m` a cell stands for itself.
    """

    reach_m: float
    of: Callable[[AnyArray, float], AnyArray]


@dataclass(frozen=True, slots=True)
class Layer:
    """Something that can be read of every cell.

    `values` makes it from the channels of `groups`, of cells of any size. An unobserved cell gets
    `nodata`; without one it gets 0, which the mask tells from a value. `above_datum` marks heights
    above the datum's plane. With `around` the values of neighbouring cells enter, too.
    """

    name: str
    dtype: str
    unit: str
    meaning: str
    groups: tuple[str, ...]
    values: Callable[[Cells], AnyArray]
    nodata: float | None
    colours: Colours
    above_datum: bool = False
    around: Surroundings | None = None
