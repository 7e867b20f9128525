"""Which way a view is read: from the stored sums where they have it, else from the evidence."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fieldgrid.errors import ConfigError
from fieldgrid.lattice import Bounds, Lattice, Window
from fieldgrid.mapfile.asof import until
from fieldgrid.mapfile.cells import LayerTally, Tally, tally_folded, tally_stored, with_layers
from fieldgrid.mapfile.change import ChangeTally, ChangeView
from fieldgrid.mapfile.evidence import Evidence
from fieldgrid.mapfile.header import Header
from fieldgrid.mapfile.heights import HEIGHT, with_heights
from fieldgrid.mapfile.records import FrameRecord
from fieldgrid.mapfile.view import MapView, check_size, empty_view, fold
from fieldgrid.transfer import Averaging, Transfer, check_cell_sizes


class Request(NamedTuple):
    """What is asked of a map; `sessions` in the order of their drives, None for all active."""

    lattice: Lattice
    window: Window
    transfer: Transfer
    averaging: Averaging = Averaging.MEAN
    sessions: tuple[str, ...] | None = None
    frame_filter: Callable[[FrameRecord], bool] | None = None
    layers: tuple[str, ...] = ()


def read_view(evidence: Evidence, header: Header, request: Request) -> MapView:
    """The view, by the shortest way that gives the same bits."""
    if HEIGHT in request.layers:
        return _with_heights(evidence, header, request)
    view = empty_view(request.lattice, request.window, header.datum)
    level = stored_level(evidence, header, request)
    if level is not None:
        evidence.fill_from_tiles(view, level)
        return view
    beyond = _beyond(request)
    own_cells = _by_own_rule(header, request) and request.lattice == header.lattice
    if beyond or own_cells:
        view = with_layers(view, beyond)
        tally_sessions(evidence, header, request, lambda: LayerTally(view))
        return view
    frames = evidence.accepted(view.bounds, request.sessions, request.frame_filter)
    _check_cells(request.lattice, frames)
    fold(view, frames, request.averaging, request.transfer)
    return view


def stored_level(evidence: Evidence, header: Header, request: Request) -> int | None:
    """The level of the map's own tiles that has all that is asked for; None when none has."""
    if _beyond(request) or request.sessions is not None or not _by_own_rule(header, request):
        return None
    level = level_of(header.lattice, request.lattice)
    # Small maps have few levels; the rest of them is soon folded.
    return level if level is not None and level <= evidence.levels() else None


def _beyond(request: Request) -> tuple[str, ...]:
    return tuple(name for name in request.layers if name != "density")


def _by_own_rule(header: Header, request: Request) -> bool:
    """Whether cells are filled as the map's own are, of whichever size they are."""
    return (
        request.transfer is header.transfer
        and request.averaging is Averaging.MEAN
        and request.frame_filter is None
    )


def _with_heights(evidence: Evidence, header: Header, request: Request) -> MapView:
    _refuse_layers_of_paper(request)
    others = tuple(name for name in request.layers if name != HEIGHT)
    view = read_view(evidence, header, request._replace(layers=others))
    frames = evidence.accepted(view.bounds, request.sessions, request.frame_filter)
    return with_heights(view, frames, request.transfer)


def _refuse_layers_of_paper(request: Request) -> None:
    if request.averaging is Averaging.PAPER:
        raise ConfigError("The paper's averaging gives a density only; leave the other layers out.")


def tally_sessions(
    evidence: Evidence, header: Header, request: Request, tally: Callable[[], Tally]
) -> None:
    """Tally each session's moments, stored ones where the request is as the map is stored."""
    _refuse_layers_of_paper(request)
    names = request.sessions or tuple(info.name for info in evidence.active())
    as_stored = (request.lattice, request.transfer, request.frame_filter) == (
        header.lattice, header.transfer, None,
    )  # fmt: skip
    if as_stored:
        tally_stored(evidence.session_tiles(request.window, names), tally)
        return
    near = request.lattice.bounds(request.window)
    frames = evidence.accepted(near, names, request.frame_filter)
    _check_cells(request.lattice, frames)
    by_session = [(name, [f for f in frames if f.session == name]) for name in names]
    tally_folded(request.window, request.lattice, request.transfer, by_session, tally)


def read_change(
    evidence: Evidence,
    header: Header,
    request: Request,
    between: tuple[str | int, str | int],
    path: Path,
) -> ChangeView:
    """What changed between two moments; ConfigError when no drive is up to or after the first."""
    check_size(request.lattice, request.window)
    sessions = evidence.sessions()
    early, late = ([info.name for info in until(at, sessions, path)] for at in between)
    late = [name for name in late if name not in early]
    if not early or not late:
        gap = f"after {between[0]} and up to {between[1]}" if early else f"up to {between[0]}"
        raise ConfigError(
            f"{path} has no session {gap}, so there is nothing to compare; `fieldgrid sessions` "
            "lists the dates of its drives."
        )
    view = ChangeView(
        request.lattice,
        request.window,
        np.zeros(request.window.shape, dtype=np.uint8),
        header.datum,
        tuple(early),
        tuple(late),
    )
    both = request._replace(sessions=(*early, *late))
    tally_sessions(evidence, header, both, lambda: ChangeTally(view, late))
    return view


def sessions_at(evidence: Evidence, at: str | int, path: Path) -> tuple[str, ...]:
    """The active sessions as of a moment; ConfigError when there are none yet."""
    found = tuple(info.name for info in until(at, evidence.sessions(), path))
    if not found:
        raise ConfigError(
            f"{path} has no session up to {at}; `fieldgrid sessions` lists the dates of its drives."
        )
    return found


def level_of(own: Lattice, other: Lattice) -> int | None:
    """How many times the cells of a lattice are doubled in another; None for any other ratio."""
    level = round(math.log2(other.cell_m / own.cell_m))
    # Exactly, because only then do both lattices put every point into the same cells.
    return level if level >= 0 and own.cell_m * 2.0**level == other.cell_m else None


def extent_of(evidence: Evidence, header: Header) -> Bounds:
    """The observed cells' outer edges; MapError when there are none."""
    return header.lattice.bounds(evidence.data_window())


def _check_cells(lattice: Lattice, frames: list[FrameRecord]) -> None:
    for frame in frames:
        check_cell_sizes(lattice.cell_m, frame.spec.cell_m)
