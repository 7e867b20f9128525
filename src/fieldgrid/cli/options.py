"""Options that several commands share, and values that are more than one number."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldgrid.core import quoted

if TYPE_CHECKING:
    from fieldgrid.geometry import Bounds, Datum

OUTPUT, PART = "Output", "Part of the map"
MAP_FILE = "Session and map file"
USUAL_WAIT_S = 30.0

MapArgument = Annotated[Path, typer.Argument(metavar="MAP.gpkg", show_default=False)]
AsJson = Annotated[
    bool, typer.Option("--json", help="Print one JSON object.", rich_help_panel=OUTPUT)
]
Overwrite = Annotated[
    bool,
    typer.Option(
        "--overwrite",
        help="Replace an existing file of the same kind; never an input.",
        rich_help_panel=OUTPUT,
    ),
]
Wait = Annotated[
    float,
    typer.Option(
        "--wait",
        min=0.0,
        max=86_400.0,
        metavar="S",
        help="Seconds to wait for another writer of the map.",
        rich_help_panel=MAP_FILE,
    ),
]
Figure = Annotated[
    Path | None,
    typer.Option(
        "--figure",
        metavar="FILE.png",
        help="Also draw a figure: PNG, SVG or PDF.",
        rich_help_panel=OUTPUT,
    ),
]
Jobs = Annotated[
    int | None,
    typer.Option("--jobs", min=1, max=256, metavar="N", help="Threads [default: one per core]."),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="tcp://HOST:8786",
        help="Dask scheduler; its workers do the work and need the map at the same path.",
    ),
]
Cell = Annotated[
    float | None,
    typer.Option(
        "--cell",
        metavar="M",
        help="Cell size in metres, at least that of the local cells [default: the map's].",
        rich_help_panel=PART,
    ),
]
BoundsValues = Annotated[
    tuple[float, float, float, float] | None,
    typer.Option(
        "--bounds",
        metavar="W S E N",
        help="Crop: west, south, east, north in metres of the map.",
        rich_help_panel=PART,
    ),
]
At = Annotated[
    str | None,
    typer.Option(
        "--at",
        metavar="SESSION|DATE",
        help="The map after this drive, or at the end of this day; FROM..TO: only the drives "
        "in between.",
        rich_help_panel=PART,
    ),
]
CropName = Annotated[str, typer.Option(metavar="NAME", help="vineyard, bushes, orchard or arable.")]
Spacing = Annotated[
    str | None, typer.Option(metavar="MIN:MAX", help="Distance between rows, metres.")
]
ObstacleAbove = Annotated[
    int, typer.Option(metavar="N", help="Density above which a cell is an obstacle.")
]
SpeedLimit = Annotated[
    float | None,
    typer.Option(
        metavar="KMH",
        help="Speed limit of the lanes in a network, km/h.",
        rich_help_panel=OUTPUT,
    ),
]
DatumText = Annotated[
    str | None,
    typer.Option(
        "--datum",
        metavar="LAT,LON,HEIGHT",
        help="Origin of east and north [default: the recording's own, otherwise its first "
        "accepted fix].",
    ),
]
DatumFrom = Annotated[
    Path | None,
    typer.Option(
        "--datum-from",
        metavar="MAP.gpkg",
        help="For a farm with several datums: use the datum of this map.",
        rich_help_panel=PART,
    ),
]
Config = Annotated[
    Path | None,
    typer.Option("--config", metavar="FILE.toml", help="A settings file; flags override it."),
]

_PICTURES = (".png", ".svg", ".pdf")
_NUMBER = r"[-+]?\d+(?:\.\d+)?"


def out_file(endings: str) -> Any:
    """The option that names a file to write, by whose ending its format is picked."""
    return typer.Option(
        "-o", "--out", metavar="FILE", help=f"Write {endings}.", rich_help_panel=OUTPUT
    )


def spacing(text: str | None) -> tuple[float | None, float | None]:
    """`MIN:MAX`: metres between rows; nothing where nothing was given."""
    if text is None:
        return None, None
    low, high = numbers("--spacing", text, ":", "MIN:MAX", "1.5:3")
    return low, high


def numbers(flag: str, text: str, separator: str, form: str, example: str) -> Sequence[float]:
    """The numbers in the text of a flag, such as 41.65,-4.72,787.4, as many as the form has parts;
    a usage error for what is none."""
    parts = [f"({_NUMBER})"] * (form.count(separator) + 1)
    match = re.fullmatch(separator.join(parts), text.replace(" ", ""))
    if not match:
        raise typer.BadParameter(f"{quoted(text)} is not {form}, as in {example}", param_hint=flag)
    return [float(value) for value in match.groups()]


def datum(text: str | None) -> Datum | None:
    """`LAT,LON,HEIGHT`: degrees, degrees, ellipsoidal metres."""
    if text is None:
        return None
    from fieldgrid.geometry import Datum

    return Datum(*numbers("--datum", text, ",", "LAT,LON,HEIGHT", "41.65,-4.72,787.4"))


def datum_or_from(text: str | None, other: Path | None) -> Datum | None:
    """A datum as text or as a map has it; None where neither is given."""
    refuse(
        text is not None and other is not None,
        "--datum-from",
        "--datum and --datum-from exclude each other",
    )
    if other is None:
        return datum(text)
    from fieldgrid.maps import read_datum

    return read_datum(other)


def bounds(values: tuple[float, float, float, float] | None) -> Bounds | None:
    """West, south, east, north in metres."""
    from fieldgrid.geometry import Bounds

    return None if values is None else Bounds(*values)


def refuse(is_wrong: bool, flag: str, why: str) -> None:
    """A usage error of a flag or an argument, if something is wrong."""
    if is_wrong:
        raise typer.BadParameter(why, param_hint=flag)


def check_scheduler(scheduler: str | None, jobs: int | None) -> None:
    """Refuse --jobs beside a --scheduler."""
    refuse(
        scheduler is not None and jobs is not None,
        "--jobs",
        "the workers of the --scheduler do the work; leave it out",
    )


def check_outputs(
    outputs: Sequence[Path | None], inputs: Sequence[Path], *, overwrite: bool
) -> None:
    """Refuse outputs before the work: two of one name, inputs, and what may not be replaced. None
    stands for an output that was not asked for."""
    from fieldgrid.core import MapExistsError, refuse_input

    written = [path for path in outputs if path is not None]
    refuse(overwrite and not written, "--overwrite", "nothing is written; name a file")
    if len({path.resolve() for path in written}) < len(written):
        raise typer.BadParameter(f"{written[-1]} is the name of two outputs", param_hint="--out")
    for path in written:
        refuse_input(path, inputs)
        if path.exists() and not overwrite:
            raise MapExistsError(
                f"{path} exists already; give another name, or --overwrite to replace it."
            )


def check_figure(path: Path | None) -> None:
    """A usage error for a figure that could not be written."""
    if path is not None and path.suffix.lower() not in _PICTURES:
        raise typer.BadParameter(
            f"{path.name} ends in none of {', '.join(_PICTURES)}", param_hint="--figure"
        )


def check_new_map(path: Path) -> None:
    """A usage error for a new map whose name does not show that it is one: a farm would not list
    it. Maps that exist may have any name."""
    refuse(
        path.suffix.lower() != ".gpkg" and not path.exists(),
        "--out",
        f"{path.name} does not end in .gpkg, as maps do",
    )


def refuse_idle(ctx: typer.Context, idle: Collection[str], why: str) -> None:
    """A usage error for the first of the `idle` parameters, by name, that was given; `why` says
    what it is for."""
    refuse_given(ctx, {str(one.name) for one in ctx.command.params} - set(idle), why)


def refuse_given(ctx: typer.Context, taken: Collection[str], why: str) -> None:
    """A usage error for the first option or argument that was given and would be ignored.

    `taken` are the names of the parameters that count; `why` says what the others are at odds
    with.
    """
    for one in ctx.command.params:
        source = ctx.get_parameter_source(str(one.name))
        if source is not None and source.name == "COMMANDLINE" and one.name not in taken:
            hint = one.opts[0] if one.param_type_name == "option" else str(one.metavar)
            raise typer.BadParameter(why, param_hint=hint)
