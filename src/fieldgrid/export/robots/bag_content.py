"""What of a map is in a bag: its messages, in the order of their times.

What is of the whole map bears the time of the first pose, so that a player shows it at once; paths
and grids are latched, as Nav2 wants them. The topics are listed in `docs/exports.md`.
"""

from __future__ import annotations

import heapq
import json
import re
from collections.abc import Iterator
from itertools import takewhile
from typing import Any, NamedTuple, Self

import numpy as np

from fieldgrid.core import Bool, CalibrationError, ConfigError, Float64, Int64, MapError, quoted
from fieldgrid.export.cells.tiles import Tile, Whole, cut
from fieldgrid.export.georeference import extent, georeference
from fieldgrid.export.robots import ros_messages
from fieldgrid.export.shapes.features import trajectories
from fieldgrid.geometry import HEIGHT_SHARE, Bounds, Rig, Trajectory
from fieldgrid.maps import CostCurve, MapFile, Selection
from fieldgrid.recordings import ANTENNA, BASE, datum_message, text, transforms

TILE_CELLS = 2048
"""Cells along a side of a tile of what is too large for one message."""

GRID_MAP_CELLS = 8_000_000
"""Cells of a grid map: 16 bytes of each are in the message, and 90 in memory while it is made."""

_END_NS = 2**31 * 1_000_000_000

GRID_MAP_LAYERS = ("density", "count", "variance", "persistence")


class BagMessage(NamedTuple):
    """A ROS message on its way into a bag."""

    topic: str
    message: Any
    time_ns: int
    latched: bool


class BagContent(NamedTuple):
    """What a bag is made of. `tiles` are those of what is too large for a message; `start_ns` is
    the time of the first accepted pose, or of the first frame where there is no trajectory."""

    universal: MapFile
    selection: Selection
    curve: CostCurve
    whole: Whole
    tiles: tuple[Tile, ...]
    tracks: dict[str, Trajectory]
    start_ns: int

    @classmethod
    def of(cls, universal: MapFile, selection: Selection, curve: CostCurve) -> Self:
        """What a selection comes to. ConfigError for times that no message can hold."""
        whole = Whole(*selection.cells(universal))
        cells = whole.window.width * whole.window.height
        tiles = cut(universal, selection, whole, TILE_CELLS) if cells > GRID_MAP_CELLS else ()
        tracks = trajectories(universal, selection)
        for name, track in tracks.items():
            if len(track) and not 0 <= int(track.time_ns[0]) <= int(track.time_ns[-1]) < _END_NS:
                raise ConfigError(
                    f"Session {quoted(name)} has times before 1970 or after 2038, which a ROS "
                    "message cannot hold; take another format."
                )
        poses = [int(one.time_ns[one.accepted][0]) for one in tracks.values() if any(one.accepted)]
        infos = universal.sessions()
        frames = [info.first_time_ns for info in infos if info.first_time_ns is not None]
        start_ns = min(max(min(poses or frames, default=0), 0), _END_NS - 1)
        return cls(universal, selection, curve, whole, tuple(tiles), tracks, start_ns)

    @property
    def area(self) -> Bounds | None:
        """What paths and fixes are cut to, None for nothing."""
        return (
            None if self.selection.bounds is None else self.whole.lattice.bounds(self.whole.window)
        )

    @property
    def cells(self) -> str:
        """The size as text."""
        window = self.whole.window
        return f"{window.width} x {window.height} cells of {self.whole.lattice.cell_m:g} m"

    def about(self, messages: int) -> dict[str, Any]:
        """Size, place and numbers of messages and tiles, for a program."""
        whole, datum = self.whole, self.universal.datum
        return extent(whole.lattice, whole.window, datum) | {
            "messages": messages,
            "tiles": len(self.tiles),
        }

    def rows(self, messages: int) -> tuple[tuple[str, str], ...]:
        """What a reader is told."""
        rows = (("cells", self.cells.replace(" cells", "")), ("messages", str(messages)))
        if not self.tiles:
            return rows
        which = "/map and /grid_map" if self.whole.is_large else "/grid_map"
        tiles = f"{which}: {len(self.tiles)} tiles of up to {TILE_CELLS} a side, and an index"
        return (("too large for one message", tiles), *rows)


def _vehicle(
    content: BagContent, session: str, names: dict[str, str]
) -> tuple[str, ros_messages.Antenna | None]:
    """The frame of a session's vehicle on the ground, and its antenna where the session tells it;
    of several sessions, each has frames below its own name."""
    above = "" if len(content.tracks) == 1 else f"{names[session]}/"
    (info,) = (one for one in content.universal.sessions() if one.name == session)
    antenna = None
    if "rig" in info.config:
        try:
            at = Rig.from_dict(info.config["rig"]).antenna
        except CalibrationError as error:
            raise MapError(
                f"Session {quoted(session)} does not say where its antenna was ({error}); build it "
                "again from its recording."
            ) from error
        antenna = ros_messages.Antenna(f"{above}{ANTENNA}", at)
    return f"{above}{BASE}", antenna


def messages(content: BagContent) -> Iterator[BagMessage]:
    """All messages in the order of their times, one in memory at a time."""
    datum, tracks, area = content.universal.datum, content.tracks, content.area
    start_ns, (lattice, window) = content.start_ns, content.whole
    names = topic_names(tracks)
    vehicles = {name: _vehicle(content, name, names) for name in tracks}
    # In one message: of a latched topic, those who come later get the last one.
    placed = [ros_messages.earth_to_map(datum, start_ns)]
    placed += [
        ros_messages.antenna_on(base, antenna, start_ns)
        for base, antenna in vehicles.values()
        if antenna is not None
    ]
    yield BagMessage("/tf_static", transforms(*placed), start_ns, True)
    yield BagMessage("/datum", datum_message(datum, start_ns), start_ns, True)
    yield BagMessage(
        "/georeference",
        text(json.dumps(georeference(lattice, window, datum), ensure_ascii=False)),
        start_ns,
        True,
    )
    for topic, is_large, message in (
        ("/map", content.whole.is_large, _occupancy),
        ("/grid_map", bool(content.tiles), _grid_map),
    ):
        if not is_large:
            yield BagMessage(topic, message(content, content.selection), start_ns, True)
            continue
        named = [(f"{topic}/tile_{tile.name}", tile) for tile in content.tiles]
        yield BagMessage(
            f"{topic}/index",
            text(json.dumps([{"topic": name, **tile.about(lattice)} for name, tile in named])),
            start_ns,
            True,
        )
        for name, tile in named:
            yield BagMessage(name, message(content, tile.selection), start_ns, True)
    for name, track in tracks.items():
        for number, rows in enumerate(_runs(track, area), 1):
            topic = f"/{names[name]}/path{'' if number == 1 else f'_{number}'}"
            yield BagMessage(topic, ros_messages.path(track, rows, start_ns), start_ns, True)
    for name, track in sorted(tracks.items(), key=lambda item: item[1].time_ns[:1].tolist()):
        wanted = track.accepted & _inside(track, area)
        base, antenna = vehicles[name]
        up_sigma_m = _up_sigma_m(content.universal, name)
        rows = np.flatnonzero(wanted & np.isfinite(track.heading_deg))
        # Both are in the order of time, and so are they together.
        yield from heapq.merge(
            (
                BagMessage(f"/{names[name]}/fix", fix, time_ns, False)
                for time_ns, fix in ros_messages.fixes(track, wanted, base, antenna, up_sigma_m)
            ),
            (
                one
                for time_ns, odometry, placed in ros_messages.driven(track, rows, base)
                for one in (
                    BagMessage("/tf", placed, time_ns, False),
                    BagMessage(f"/{names[name]}/odometry", odometry, time_ns, False),
                )
            ),
            key=lambda one: one.time_ns,
        )


def standing_messages(content: BagContent) -> Iterator[BagMessage]:
    """Those of the whole map, which are latched and come first."""
    return takewhile(lambda one: one.latched, messages(content))


def _up_sigma_m(universal: MapFile, session: str) -> Float64:
    """1-sigma errors of the heights of a trajectory: those of GNSS as driven, as only places are
    surer after an alignment."""
    sigma_m = HEIGHT_SHARE * universal.trajectory(session, as_driven=True).position_sigma_m
    (info,) = (one for one in universal.sessions() if one.name == session)
    heights = info.transform.heights
    return sigma_m if heights is None else np.maximum(sigma_m, heights.least_sigma_m)


def _occupancy(content: BagContent, selection: Selection) -> Any:
    """The occupancy grid of a part."""
    view = selection.view(content.universal, decide=selection.layer)
    occupancy = content.curve.occupancy(*view.decision(content.curve.least_drop_m))
    return ros_messages.occupancy_grid(view.lattice, view.window, occupancy, content.start_ns)


def _grid_map(content: BagContent, selection: Selection) -> Any:
    """The grid map of a part."""
    view = selection.view(content.universal, GRID_MAP_LAYERS)
    return ros_messages.grid_map(
        view, {name: view.layer(name) for name in GRID_MAP_LAYERS}, content.start_ns
    )


def _inside(track: Trajectory, area: Bounds | None) -> Bool:
    if area is None:
        return np.ones(len(track), dtype=np.bool_)
    east, north = track.east_m, track.north_m
    inside: Bool = (east >= area.west_m) & (east <= area.east_m)
    return inside & (north >= area.south_m) & (north <= area.north_m)


def _runs(track: Trajectory, area: Bounds | None) -> Iterator[Int64]:
    """The rows of a path for each time that the drive is in the area."""
    rows = np.flatnonzero(track.accepted & np.isfinite(track.heading_deg))
    inside = _inside(track, area)[rows]
    if area is None:
        yield rows
        return
    for part in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(inside)) + 1):
        if len(part) and inside[part[0]]:
            yield rows[part]


def topic_names(sessions: dict[str, Any]) -> dict[str, str]:
    """The names of sessions as ROS allows them in topics: letters, digits, single underscores, a
    letter first; those that become alike get a number behind them."""
    found: dict[str, str] = {}
    for session in sessions:
        plain = re.sub(r"[^A-Za-z0-9]+", "_", session).strip("_")
        plain = plain if plain[:1].isalpha() else f"session_{plain}".rstrip("_")
        name, number = plain, 2
        while name in found.values():
            name, number = f"{plain}_{number}", number + 1
        found[session] = name
    return found
