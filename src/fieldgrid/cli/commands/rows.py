"""`fieldgrid rows`: rows, lanes, gaps, headlands, blocks and obstacles of a map."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldgrid.cli import options, output, progress

if TYPE_CHECKING:
    from fieldgrid.field import Planting, Worked
    from fieldgrid.maps import MapFile

_WORK = "As worked"
_TASKDATA = ".taskdata.zip"
_OF_WORK = ("keep", "truth", "agopengps", "speed_limit")
"""Options that have no use beside `--worked`."""


def command(
    ctx: typer.Context,
    map_: options.MapArgument,
    out: Annotated[
        Path | None,
        options.out_file(
            ".geojson, .gpkg, .csv, .kml, .dxf, .osm for Lanelet2, .graph.geojson for Nav2; of "
            "--worked also .taskdata.zip for a terminal"
        ),
    ] = None,
    crop: options.CropName = "vineyard",
    spacing: options.Spacing = None,
    plant_spacing: Annotated[
        float | None, typer.Option(metavar="M", help="Largest usual distance between plants.")
    ] = None,
    min_gap: Annotated[
        float | None, typer.Option(metavar="M", help="A longer hole in a row is a gap.")
    ] = None,
    min_row: Annotated[float | None, typer.Option(metavar="M", help="Shortest row.")] = None,
    half_width: Annotated[
        float | None,
        typer.Option(
            metavar="M", help="Half width of a canopy, used if no row was seen from both sides."
        ),
    ] = None,
    obstacle_above: options.ObstacleAbove = 100,
    hole: Annotated[
        float,
        typer.Option(
            metavar="M",
            help="Unseen ground counts as seen where no square of this side fits in it.",
        ),
    ] = 0.25,
    headland: Annotated[
        float, typer.Option(metavar="M", help="Depth of the headlands from the plants.")
    ] = 15.0,
    bounds: options.BoundsValues = None,
    at: options.At = None,
    truth: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="Surveyed points, .csv or .geojson, to compare the rows with."
        ),
    ] = None,
    worked: Annotated[
        str | None,
        typer.Option(
            metavar="SESSION",
            help="Tell what this drive worked: areas, repeats, shares of the lanes, missed strips.",
            rich_help_panel=_WORK,
        ),
    ] = None,
    width: Annotated[
        float,
        typer.Option(metavar="M", help="Working width of its implement.", rich_help_panel=_WORK),
    ] = 1.0,
    behind: Annotated[
        float,
        typer.Option(
            metavar="M",
            help="How far behind the camera the implement works.",
            rich_help_panel=_WORK,
        ),
    ] = 0.0,
    agopengps: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Write a field of AgOpenGPS: boundaries, and one track per lane.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = None,
    speed_limit: options.SpeedLimit = None,
    keep: Annotated[
        bool,
        typer.Option(
            "--keep",
            help="Store the rows in the map as layers, for `show --rows`, `view` and a GIS.",
            rich_help_panel=options.OUTPUT,
        ),
    ] = False,
    overwrite: options.Overwrite = False,
    wait_s: options.Wait = options.USUAL_WAIT_S,
    jobs: options.Jobs = None,
    scheduler: options.Scheduler = None,
    as_json: options.AsJson = False,
) -> None:
    """Find rows of plants and the lanes, gaps and headlands between them, with sigmas.

    Prints a table of blocks, rows and lanes. It also checks the map: rows of one block are parallel
    and equally spaced.

    Examples:

        fieldgrid rows vineyard.gpkg -o rows.geojson

        fieldgrid rows orchard.gpkg --crop orchard --truth trees.csv

        fieldgrid rows vineyard.gpkg -o lanes.osm --speed-limit 5

        fieldgrid rows vineyard.gpkg --keep

        fieldgrid rows vineyard.gpkg --worked june-03 --width 1.6 --behind 2.5 -o worked.geojson
    """
    from fieldgrid.core import ConfigError
    from fieldgrid.field import (
        against_survey,
        check_rows_target,
        crop_named,
        find_rows,
        find_worked,
        planting_features,
        read_survey,
        write_agopengps,
        write_planting,
    )
    from fieldgrid.geometry import FEATURE_SUFFIXES
    from fieldgrid.maps import open_map

    options.check_scheduler(scheduler, jobs)
    options.refuse(
        keep and at is not None, "--keep", "it is for the map as it is now; leave --at out"
    )
    if worked is None:
        options.refuse_idle(ctx, {"width", "behind"}, "it is of the implement of --worked")
    else:
        options.refuse_idle(ctx, _OF_WORK, "it is for the rows themselves; leave --worked out")
    if out is None:
        options.refuse_idle(ctx, {"speed_limit"}, "it is for a file with lanes; give --out")
    elif worked is None:
        check_rows_target(out, speed_limit)
    elif not out.name.lower().endswith((*FEATURE_SUFFIXES, _TASKDATA)):
        known = ", ".join((*FEATURE_SUFFIXES, _TASKDATA))
        raise ConfigError(f"{out.name} ends in none of {known}; choose one of them.")
    written = [path for path in (out, agopengps) if path is not None]
    options.check_outputs(written, [map_, *([truth] if truth else [])], overwrite=overwrite)
    low, high = options.spacing(spacing)
    planted = crop_named(crop).changed(
        min_spacing_m=low,
        max_spacing_m=high,
        plant_spacing_m=plant_spacing,
        min_gap_m=min_gap,
        min_row_m=min_row,
        half_width_m=half_width,
    )
    patience = progress.patience(map_, wait_s)
    with open_map(map_, writable=keep, patience=patience) as universal:
        root = universal.root_sha256
        survey = read_survey(truth, universal.datum).points_m if truth else None
        planting = find_rows(
            universal,
            crop=planted,
            bounds=options.bounds(bounds),
            obstacle_above=obstacle_above,
            hole_m=hole,
            headland_m=headland,
            at=at,
            jobs=jobs,
            scheduler=scheduler,
        )
        if keep:
            universal.keep_features(planting_features(planting), root)
        if worked is not None:
            work = find_worked(universal, worked, planting, width, behind)
            if out is not None:
                _write_worked(work, out, universal, overwrite=overwrite)
            _tell_worked(map_, work, out, as_json=as_json)
            return
    compared = against_survey(planting, survey) if survey is not None else None
    if agopengps is not None:
        write_agopengps(planting, agopengps, overwrite=overwrite)
    if out is not None:
        write_planting(planting, out, speed_limit_kmh=speed_limit, overwrite=overwrite)
    if as_json:
        value = _as_dict(map_, planting)
        if compared is not None:
            value["survey"] = compared._asdict()
        output.print_json(value)
        return
    _print(planting)
    for doubt in planting.doubts:
        output.message(f"doubtful: {doubt.text}")
    if compared is not None:
        output.print_table(
            ("survey", ""),
            (
                ("points on rows", f"{compared.points} on {compared.rows}"),
                ("mean offset", output.number(compared.offset_m, 3, "m")),
                ("RMS offset", output.number(compared.rms_m, 3, "m")),
                ("within 3 sigma", output.percent(compared.within_3_sigma)),
            ),
        )
    for file in written:
        output.print_line(f"{file}")


def _write_worked(work: Worked, out: Path, universal: MapFile, *, overwrite: bool) -> None:
    from fieldgrid.export import Selection, TaskdataOptions, export_taskdata
    from fieldgrid.field import worked_features
    from fieldgrid.geometry import write_features

    if not out.name.lower().endswith(_TASKDATA):
        write_features(out, worked_features(work), work.datum, overwrite=overwrite)
        return
    areas = [
        *((f"worked {times} x", area) for times, area in work.areas),
        *((f"missed {lane}", area) for lane, area in work.missed),
    ]
    export_taskdata(
        universal, out, Selection(), TaskdataOptions(), overwrite=overwrite, areas=areas
    )


def _tell_worked(map_: Path, work: Worked, out: Path | None, *, as_json: bool) -> None:
    """What a drive worked, as a table or as JSON."""
    if as_json:
        told = ("session", "width_m", "behind_m", "sigma_m", "driven_m", "unknown_m", "worked_m2")
        values = {name: getattr(work, name) for name in (*told, "again_m2", "times_m2")}
        values["blocks"], values["lanes"] = (
            [of._asdict() | {"share": of.share} for of in parts]
            for parts in (work.blocks, work.lanes)
        )
        output.print_json({"map": str(map_), **values})
        return
    output.print_table(
        ("worked", ""),
        (
            ("session", work.session),
            ("way", output.number(work.driven_m, 1, "m")),
            ("way not known", output.number(work.unknown_m, 1, "m")),
            ("area", output.number(work.worked_m2, 1, "m²")),
            ("more than once", output.number(work.again_m2, 1, "m²")),
        ),
    )
    if work.lanes:
        output.print_table(
            ("of", "ground", "worked", "share", "missed strips"),
            [
                (
                    of.lane or of.block,
                    output.number(of.ground_m2, 1, "m²"),
                    output.number(of.worked_m2, 1, "m²"),
                    output.percent(of.share),
                    str(of.missed),
                )
                for of in (*work.blocks, *work.lanes)
            ],
        )
    else:
        output.message("no rows found, so that no share of a lane or a block is known")
    if out is not None:
        output.print_line(f"{out}")


BLOCK_COLUMNS = ("block", "rows", "lanes", "heading", "spacing", "std dev", "parallel to", "bend")


def block_rows(planting: Planting) -> list[tuple[str, ...]]:
    """What a table of blocks says of them: their rows as a check of quality."""
    from fieldgrid.field import block_quality

    return [
        (
            b.id,
            str(b.rows),
            str(b.lanes),
            _text(b.heading_deg, 1, "°"),
            _text(q.spacing_m, 3, "m"),
            _text(q.spacing_sd_m, 3, "m"),
            _text(q.parallel_deg, 2, "°"),
            _text(q.bend_m, 3, "m"),
        )
        for b, q in zip(planting.blocks, block_quality(planting), strict=True)
    ]


def blocks_as_dict(planting: Planting) -> list[dict[str, Any]]:
    """The blocks with the check of their rows, for JSON."""
    from fieldgrid.field import block_quality

    return [
        {
            **{name: getattr(block, name) for name in ("rows", "lanes")},
            "heading_deg": output.known(block.heading_deg),
            **{name: value if name == "block" else output.known(value) for name, value in quality},
        }
        for block, quality in zip(
            planting.blocks,
            (q._asdict().items() for q in block_quality(planting)),
            strict=True,
        )
    ]


def _text(value: float, digits: int, unit: str) -> str:
    return output.number(output.known(value), digits, unit)


def _print(planting: Planting) -> None:
    from fieldgrid.field import row_quality

    if not planting.rows:
        output.print_line(
            "no rows found; check --crop and --spacing, and with --obstacle-above which "
            "cells are plants"
        )
        return

    output.print_table(BLOCK_COLUMNS, block_rows(planting))
    quality = {q.row: q for q in row_quality(planting)}
    output.print_table(
        ("row", "length", "sigma", "spacing", "half width", "sides", "bend", "turn", "gaps"),
        [
            (
                r.id,
                _text(r.length_m, 1, "m"),
                _text(r.sigma_m, 3, "m"),
                _text(r.spacing_m, 2, "m"),
                _text(r.half_width_m, 2, "m"),
                _text(r.sides, 1, ""),
                _text(quality[r.id].bend_m, 3, "m"),
                _text(quality[r.id].turn_deg, 2, "°"),
                str(sum(gap.row == r.id for gap in planting.gaps)),
            )
            for r in planting.rows
        ],
    )
    output.print_table(
        ("lane", "between", "length", "free width", "clear width", "known", "driven", "obstacles"),
        [
            (
                lane.id,
                " ".join(lane.rows),
                _text(lane.length_m, 1, "m"),
                _text(lane.free_width_m, 2, "m"),
                f"{lane.clear_width_m:.2f} ± {lane.clear_sigma_m:.2f} m"
                if math.isfinite(lane.clear_width_m)
                else "-",
                output.percent(lane.known, 0),
                "yes" if lane.driven else "no",
                str(sum(o.lane == lane.id for o in planting.obstacles)),
            )
            for lane in planting.lanes
        ],
    )


def _as_dict(path: Path, planting: Planting) -> dict[str, Any]:
    from fieldgrid.field import block_quality, planting_features, row_quality
    from fieldgrid.geometry import plain_properties

    found: dict[str, Any] = {
        "map": str(path),
        "cell_m": planting.cell_m,
        **{f"{kind}s": [] for kind in ("row", "lane", "gap", "headland", "block", "obstacle")},
    }
    for feature in planting_features(planting):
        found[f"{feature.kind}s"].append(plain_properties(feature))
    found["doubts"] = [
        {"kind": doubt.kind, "rows": list(doubt.rows), "text": doubt.text}
        for doubt in planting.doubts
    ]
    for entry, quality in zip(found["blocks"], block_quality(planting), strict=True):
        entry.update({k: output.known(v) for k, v in quality._asdict().items() if k != "block"})
    by_row = {q.row: q._asdict() for q in row_quality(planting)}
    for entry in found["rows"]:
        values = by_row[entry["id"]].items()
        entry.update({k: output.known(v) for k, v in values if k != "row"})
    return found
