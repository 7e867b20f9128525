"""`fieldgrid show`: the paper's figures."""

from __future__ import annotations

import math
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldgrid.cli import options, output
from fieldgrid.cli.farms import MapOrFarm, opened
from fieldgrid.core import quoted

if TYPE_CHECKING:
    from fieldgrid.geometry import Bounds, Feature
    from fieldgrid.maps import Farm, MapFile, MapView

MAX_PIXELS = 4000
"""A picture of more cells than this a side is drawn with larger cells."""


class FigureKind(StrEnum):
    """Which figure."""

    SHEET = "sheet"
    GRID = "grid"
    TRAJECTORY = "trajectory"
    HEADING = "heading"


_OF_ALL = {"map_", "out", "figure", "at", "session", "datum_from"}
_OF_ALL |= {"overwrite", "as_json", "quiet", "verbose"}
"""The parameters that count for every figure; the others are of the universal grid."""


def command(
    ctx: typer.Context,
    map_: MapOrFarm,
    out: Annotated[Path, typer.Option("--out", "-o", metavar="FILE.png", help="PNG, PDF or SVG.")],
    figure: Annotated[
        FigureKind, typer.Option(help="Which figure of the paper.")
    ] = FigureKind.SHEET,
    cell: options.Cell = None,
    bounds: options.BoundsValues = None,
    at: options.At = None,
    session: Annotated[
        str | None, typer.Option(metavar="SESSION", help="Only this session.")
    ] = None,
    layer: Annotated[
        str, typer.Option(metavar="LAYER", help="Layer to draw, as in `export`.")
    ] = "density",
    route: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Draw a route over the map: .geojson or .csv."),
    ] = None,
    rows: Annotated[
        bool,
        typer.Option(
            "--rows", help="Also draw the rows that `fieldgrid rows --keep` stored in the map."
        ),
    ] = False,
    averaging: Annotated[
        str,
        typer.Option(
            metavar="mean|paper",
            help="How several values of a cell are combined [default: mean].",
            show_default=False,
        ),
    ] = "mean",
    datum_from: options.DatumFrom = None,
    overwrite: options.Overwrite = False,
    as_json: options.AsJson = False,
) -> None:
    """Draw a map: universal grid, trajectory with grid positions, heading against time.

    Examples:

        fieldgrid show vineyard.gpkg -o vineyard.png

        fieldgrid show vineyard.gpkg -o row.png --figure grid --cell 0.25 --bounds -20 40 0 60

        fieldgrid show vineyard.gpkg -o all.pdf --figure grid --layer count

        fieldgrid show vineyard.gpkg -o rows.png --rows

        fieldgrid show maps -o farm.png --figure grid --cell 0.8
    """
    if figure in (FigureKind.TRAJECTORY, FigureKind.HEADING):
        options.refuse_given(ctx, _OF_ALL, f"the figure {figure} shows no cells; leave it out")
    options.check_outputs([out], [map_], overwrite=overwrite)
    from fieldgrid.export import figures

    with opened(map_, datum_from) as universal:
        chosen, crop = _sessions(universal, at, session), options.bounds(bounds)
        drives = figures.drives_of(universal, _in_sight(universal, chosen, crop))
        if figure is FigureKind.TRAJECTORY:
            drawn = figures.trajectory(drives)
        elif figure is FigureKind.HEADING:
            drawn = figures.heading(drives)
        else:
            way = None if route is None else figures.read_route(route, universal.datum)
            # Cells of all sessions are read as they are stored.
            some = None if at is None and session is None else chosen
            view = _view(universal, crop, cell, layer, averaging, some)
            what = "universal grid" if layer == "density" else layer
            title = (
                f"{map_.stem or map_.resolve().name}: {what}, cells of "
                f"{view.lattice.cell_m * 100:g} cm"
            )
            draw = figures.universal_grid if figure is FigureKind.GRID else figures.sheet
            drawn = draw(
                view,
                drives,
                layer=layer,
                route=way,
                found=_kept(universal) if rows else (),
                title=title,
            )
    figures.save(drawn, out)
    if as_json:
        output.print_json({"map": str(map_), "figure": str(out)})
    else:
        output.report_line(f"figure {out}")


def _sessions(universal: MapFile | Farm, at: str | None, session: str | None) -> list[str]:
    """The sessions to draw, in the order of their drives."""
    from fieldgrid.core import ConfigError

    infos = universal.sessions()
    found = [info.name for info in infos if info.active]
    if at is not None:
        found = universal.sessions_at(at)
    if session is None:
        return found
    if session not in found:
        names = ", ".join(repr(name) for name in found) or "none"
        raise ConfigError(f"{universal.path} has no session {quoted(session)}; it has {names}.")
    return [session]


def _kept(universal: MapFile | Farm) -> tuple[Feature, ...]:
    """What `fieldgrid rows --keep` has left in a map; a note where the map has changed since."""
    from fieldgrid.core import ConfigError
    from fieldgrid.maps import Farm

    if isinstance(universal, Farm):
        raise typer.BadParameter("it is of one map; give one of the farm", param_hint="--rows")
    kept = universal.kept_features()
    if kept is None:
        raise ConfigError(
            f"{universal.path} keeps no rows; `fieldgrid rows {universal.path.name} --keep` finds "
            "them, and puts them there."
        )
    if kept.root_sha256 != universal.root_sha256:
        output.message(
            f"{universal.path} has changed since its rows were found; `fieldgrid rows "
            f"{universal.path.name} --keep` finds them again"
        )
    return kept.features


def _in_sight(universal: MapFile | Farm, sessions: list[str], bounds: Bounds | None) -> list[str]:
    """The sessions to draw; of a farm those of the maps in the part that is drawn."""
    from fieldgrid.maps import Farm

    if bounds is None or not isinstance(universal, Farm):
        return sessions
    near = {name for name, one in universal.extents().items() if one.overlaps(bounds)}
    return [name for name in sessions if universal.map_of(name).name in near]


def _view(
    universal: MapFile | Farm,
    bounds: Bounds | None,
    cell_m: float | None,
    layer: str,
    averaging: str,
    sessions: list[str] | None,
) -> MapView:
    """The part of the map to draw; cells are enlarged where a picture could not show them."""
    from fieldgrid.core import ConfigError
    from fieldgrid.geometry import MAX_DISTANCE_M, check_inside
    from fieldgrid.maps import Averaging, Farm

    options.refuse(
        averaging not in {rule.value for rule in Averaging},
        "--averaging",
        f"{quoted(averaging)} is neither mean nor paper",
    )
    extent = bounds or universal.bounds
    check_inside(extent, universal.bounds)
    if cell_m is None:
        side_m = max(extent.east_m - extent.west_m, extent.north_m - extent.south_m)
        if side_m > 2.0 * MAX_DISTANCE_M:
            raise ConfigError(
                f"Bounds {tuple(extent)} are {side_m / 1000:.0f} km wide; give metres of the map, "
                f"which reaches {MAX_DISTANCE_M / 1000:.0f} km from its datum at most."
            )
        times = max(1, math.ceil(side_m / universal.cell_m / MAX_PIXELS))
        if isinstance(universal, Farm):
            times = 1 << (times - 1).bit_length()  # as each of the maps has stored them
        cell_m = universal.cell_m * times
    layers, rule = () if layer == "density" else (layer,), Averaging(averaging)
    if not isinstance(universal, Farm):
        # Larger cells take long to decide, and show none.
        decide = layer if layer == "density" and cell_m == universal.cell_m else ""
        return universal.read(
            bounds, cell_m, layers=layers, averaging=rule, sessions=sessions, decide=decide
        )
    options.refuse(
        rule is Averaging.PAPER, "--averaging", "it is of one map; several are joined by the mean"
    )
    return universal.read(bounds, cell_m, layers=layers, sessions=sessions)
