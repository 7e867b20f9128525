"""`fieldgrid mark`: what people say of places in a map."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldgrid.cli import options, output, progress
from fieldgrid.core import quoted

if TYPE_CHECKING:
    from fieldgrid.maps import Mark

_ADD, _UNDO = "Add", "Undo"
_KINDS = "keepout|free|obstacle|place"


def command(
    ctx: typer.Context,
    map_: options.MapArgument,
    add: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE.geojson",
            help="Add the points and polygons of a file, with their kind, name, note and author.",
            rich_help_panel=_ADD,
        ),
    ] = None,
    polygon: Annotated[
        str | None,
        typer.Option(
            metavar="E,N;E,N;E,N...",
            help="A polygon by its corners, metres of the map.",
            rich_help_panel=_ADD,
        ),
    ] = None,
    point: Annotated[
        str | None,
        typer.Option(metavar="E,N", help="A point; it marks its cell.", rich_help_panel=_ADD),
    ] = None,
    kind: Annotated[
        str | None, typer.Option(metavar=_KINDS, help="Kind of the mark.", rich_help_panel=_ADD)
    ] = None,
    name: Annotated[
        str, typer.Option(metavar="TEXT", help="Name of the mark.", rich_help_panel=_ADD)
    ] = "",
    note: Annotated[
        str, typer.Option(metavar="TEXT", help="Reason for the mark.", rich_help_panel=_ADD)
    ] = "",
    author: Annotated[
        str, typer.Option(metavar="TEXT", help="Author of the mark.", rich_help_panel=_ADD)
    ] = "",
    remove: Annotated[
        list[int] | None,
        typer.Option(
            metavar="ID", help="Remove a mark; it can be restored.", rich_help_panel=_UNDO
        ),
    ] = None,
    restore: Annotated[
        list[int] | None,
        typer.Option(metavar="ID", help="Put a removed mark back.", rich_help_panel=_UNDO),
    ] = None,
    out: Annotated[
        Path | None, options.out_file(".geojson, .gpkg, .csv, .kml or .dxf with the marks in force")
    ] = None,
    overwrite: options.Overwrite = False,
    wait_s: options.Wait = options.USUAL_WAIT_S,
    as_json: options.AsJson = False,
) -> None:
    """List the marks of a map; add, remove or restore marks.

    A keepout is never entered; free and obstacle correct what the drives saw; a place is a named
    position. All planners, routes and exports respect marks. The density layer is not changed.

    Examples:

        fieldgrid mark a.gpkg --kind keepout --polygon "4,4;6,4;6,5.5"

        fieldgrid mark a.gpkg --point 2.1,53.4 --kind free --author Ana

        fieldgrid mark a.gpkg --add drawn.geojson --kind keepout

        fieldgrid mark a.gpkg --remove 1

        fieldgrid mark a.gpkg --restore 1 -o marks.geojson
    """
    given = {
        "--add": add, "--polygon": polygon, "--point": point,
        "--remove": remove, "--restore": restore,
    }  # fmt: skip
    changes = [flag for flag, value in given.items() if value]
    if len(changes) > 1:
        raise typer.BadParameter(f"give it without {changes[1]}", param_hint=changes[0])
    is_new = bool(changes) and changes[0] in ("--add", "--polygon", "--point")
    for flag, value in (("--kind", kind), ("--name", name), ("--note", note), ("--author", author)):
        options.refuse(bool(value) and not is_new, flag, "it is for a new mark only")
    if out is None:
        options.refuse_idle(ctx, {"overwrite"}, "nothing is written; give --out")
    from fieldgrid.core import refuse_input
    from fieldgrid.geometry import write_features
    from fieldgrid.maps import Mark, MarkKind, features, marks_of_geojson, open_map

    options.refuse(
        kind is not None and kind not in set(MarkKind),
        "--kind",
        f"{quoted(kind)} is none of {_KINDS}",
    )
    options.refuse(
        kind is None and bool(polygon or point), "--kind", f"it is needed: one of {_KINDS}"
    )
    places = _corners("--polygon", polygon) if polygon else _corners("--point", point or "")
    if out is not None:
        refuse_input(out, [map_, *([add] if add else [])])
    patience = progress.patience(map_, wait_s)
    with open_map(map_, writable=bool(changes), patience=patience) as universal:
        if add is not None:
            usual = {"kind": kind or "", "name": name, "note": note, "author": author}
            universal.add_marks(marks_of_geojson(_read(add), universal.datum, usual))
        if places:
            universal.add_marks([Mark(MarkKind(str(kind)), places, name, note, author)])
        if remove:
            universal.remove_marks(remove)
        if restore:
            universal.restore_marks(restore)
        marks, datum = universal.marks(removed=True), universal.datum
        root = universal.root_sha256
    if out is not None:
        write_features(
            out, features(mark for mark in marks if mark.active), datum, overwrite=overwrite
        )
    if as_json:
        output.print_json(
            {"map": str(map_), "root_sha256": root, "marks": [_as_dict(mark) for mark in marks]}
        )
        return
    output.print_table(
        ("id", "kind", "name", "where, m", "area", "author", "created", "note", ""),
        [_row(mark) for mark in marks],
    )
    if out is not None:
        output.print_line(f"{out}")


def _corners(flag: str, text: str) -> tuple[tuple[float, float], ...]:
    """The corners in the text of a flag; a usage error for too few or too many."""
    if not text:
        return ()
    parts = [part for part in text.split(";") if part.strip()]
    found = [options.numbers(flag, part, ",", "E,N", "-14,50.5") for part in parts]
    options.refuse(
        (flag == "--point") != (len(found) == 1) or len(found) == 2,
        flag,
        f"{len(found)} corners are no {flag[2:]}; give --point E,N, or --polygon with three or "
        "more corners, as in '0,0;2,0;2,3'",
    )
    return tuple((east, north) for east, north in found)


def _read(path: Path) -> Any:
    """A GeoJSON as Python has it."""
    from fieldgrid.core import ConfigError, check_document, file_bytes, parse_json

    try:
        check_document(file_bytes(path), path, ConfigError)
        return parse_json(path.read_bytes())
    except OSError as error:
        raise ConfigError(f"{path} cannot be read ({error.strerror}); check its name.") from error
    except ValueError as error:
        raise ConfigError(f"{path} is no GeoJSON ({error}); check the file.") from error


def _row(mark: Mark) -> tuple[str, ...]:
    east_m, north_m = mark.geometry.representative_point().coords[0]
    return (
        str(mark.id),
        mark.kind.value,
        mark.name,
        f"{east_m:.2f},{north_m:.2f}",
        "-" if mark.is_point else output.number(mark.geometry.area, 2, "m²"),
        mark.author,
        mark.created[:16].replace("T", " "),
        mark.note,
        "" if mark.active else "removed",
    )


def _as_dict(mark: Mark) -> dict[str, Any]:
    return {
        **{k: value for k, value in mark._asdict().items() if k not in ("corners", "holes")},
        "corners_m": [list(corner) for corner in mark.corners],
        "holes_m": [[list(corner) for corner in hole] for hole in mark.holes],
        "area_m2": mark.geometry.area,
    }
