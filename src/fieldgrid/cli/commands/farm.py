"""`fieldgrid farm`: the maps of a folder."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldgrid.cli import options, output

if TYPE_CHECKING:
    from datetime import datetime

    from fieldgrid.maps import FarmBlock

_MOST_NAMES = 5


def command(
    ctx: typer.Context,
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", show_default=False)],
    verify: Annotated[
        bool, typer.Option("--verify", help="Verify each map; reads every file completely.")
    ] = False,
    jobs: options.Jobs = None,
    stac: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Write a STAC catalogue of the maps.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    cog: Annotated[
        bool,
        typer.Option(
            "--cog",
            help="Add a cloud-optimised GeoTIFF of each map to the catalogue.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = False,
    overwrite: options.Overwrite = False,
    as_json: options.AsJson = False,
) -> None:
    """List the maps of a folder: observed ground, drives, and the health of each map.

    Health is `opens` if settings, plane, sessions and marks are undamaged. Frames are checked only
    with --verify; then health is `sound`. A map that cannot be read is listed with the reason. The
    exit status is 1 if a map is damaged.

    Examples:

        fieldgrid farm maps

        fieldgrid farm maps --verify --json

        fieldgrid farm maps --stac catalogue --cog
    """
    from fieldgrid.core import MapError, counted
    from fieldgrid.maps import Farm, Health

    if stac is None:
        options.refuse_idle(ctx, {"cog", "overwrite"}, "it is for a catalogue; give --stac")
    if not verify:
        options.refuse_idle(ctx, {"jobs"}, "it is for --verify; add that")
    with Farm(folder, verify=verify, jobs=jobs) as farm:
        blocks = farm.blocks
        written = None
        if stac is not None:
            from fieldgrid.export import write_stac

            written = write_stac(farm, stac, with_cog=cog, overwrite=overwrite)
    told = {block.path.name for block in blocks if block.problem or not block.bounds}
    left_out = () if written is None else written.left_out
    failed = [(name, why) for name, why in left_out if name not in told]
    if as_json:
        found: dict[str, Any] = {"farm": str(folder), "maps": [_block(block) for block in blocks]}
        if written is not None:
            found["stac"] = {
                "file": str(written.file),
                "items": list(written.items),
                "left_out": dict(written.left_out),
            }
        output.print_json(found)
    else:
        _print(blocks)
        if written is not None:
            for name, why in failed:
                output.print_line(f"{name} is not in the catalogue: {why}")
            output.report_line(f"{written.file}: {len(written.items)} maps")
    bad = [block.path.name for block in blocks if block.health is Health.DAMAGED]
    bad += [name for name, _ in failed if name not in bad]
    if bad:
        raise MapError(
            f"{', '.join(bad[:_MOST_NAMES])}{' ...' if len(bad) > _MOST_NAMES else ''}: "
            f"{counted(len(bad), 'map')} of {folder} damaged or not in the catalogue; the list "
            "says why."
        )


def _print(blocks: tuple[FarmBlock, ...]) -> None:
    output.print_table(
        ("map", "ha seen", "extent m", "first", "last", "drives", "datum", "MB", "health"),
        [_row(block) for block in blocks],
    )
    for block in blocks:
        if block.problem:
            output.print_line(f"{block.path.name}: {block.problem}")
    output.print_line(
        f"{len(blocks)} files, {sum(block.area_m2 for block in blocks) / 1e4:.2f} ha; ground that "
        "two maps have counts twice"
    )


def _row(block: FarmBlock) -> tuple[str, ...]:
    megabytes = f"{block.size_bytes / 1e6:.1f}"
    if block.header is None:
        return (block.path.name, *"-" * 6, megabytes, block.health)
    extent = "-"
    if block.bounds is not None:
        west, south, east, north = block.bounds
        extent = f"{east - west:.0f} x {north - south:.0f}"
    datum = block.header.datum
    return (
        block.path.name,
        f"{block.area_m2 / 1e4:.2f}",
        extent,
        f"{block.first:%Y-%m-%d}" if block.first else "-",
        f"{block.last:%Y-%m-%d}" if block.last else "-",
        str(len(block.sessions)) + (f" (+{block.removed} removed)" if block.removed else ""),
        f"{datum.lat_deg:.6f} {datum.lon_deg:.6f}",
        megabytes,
        block.health,
    )


def _iso(moment: datetime | None) -> str | None:
    return None if moment is None else moment.isoformat().replace("+00:00", "Z")


def _block(block: FarmBlock) -> dict[str, Any]:
    about = {"map": str(block.path), "health": block.health.value, "bytes": block.size_bytes}
    if block.header is None:
        return {**about, "problem": block.problem}
    datum = block.header.datum
    return {
        **about,
        "area_m2": round(block.area_m2, 4),
        "bounds_m": block.bounds,
        "cell_m": block.header.lattice.cell_m,
        "datum": {
            "lat_deg": datum.lat_deg,
            "lon_deg": datum.lon_deg,
            "height_m": datum.height_m,
        },
        "first": _iso(block.first),
        "last": _iso(block.last),
        "sessions": [info.name for info in block.sessions],
        "removed": block.removed,
        "root_sha256": block.root_sha256,
    }
