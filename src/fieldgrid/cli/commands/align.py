"""`fieldgrid align`: how the drives of a map lie against each other, and how they coincide."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fieldgrid.cli import options, output, progress
from fieldgrid.cli.commands.rows import BLOCK_COLUMNS, block_rows, blocks_as_dict

if TYPE_CHECKING:
    from fieldgrid.field import DriveAlignment, MapAlignment, PairAlignment, Planting


_UNTOLD_M = 0.5
"""A direction in which matches leave more is not told by them."""


def command(
    ctx: typer.Context,
    map_: options.MapArgument,
    session: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Move only this session; may be repeated."),
    ] = None,
    to: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Align to this session, which stays in place; leave out the others.",
        ),
    ] = None,
    datum_from: Annotated[
        str | None,
        typer.Option(metavar="SESSION", help="Align all sessions; this one stays in place."),
    ] = None,
    reach: Annotated[float, typer.Option(metavar="M", help="Largest accepted shift.")] = 2.5,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Only report; change nothing.")
    ] = False,
    undo: Annotated[
        bool, typer.Option("--undo", help="Restore the positions before alignment.")
    ] = False,
    rows: Annotated[
        bool,
        typer.Option(
            "--rows", help="Find rows before and after: a check that is independent of GNSS."
        ),
    ] = False,
    figure: options.Figure = None,
    overwrite: options.Overwrite = False,
    wait_s: options.Wait = options.USUAL_WAIT_S,
    jobs: options.Jobs = None,
    scheduler: options.Scheduler = None,
    as_json: options.AsJson = False,
) -> None:
    """Align the drives of a map by comparing what they saw.

    Each drive gets a shift, a small turn and a slow time-dependent shift, with their sigmas. Its
    original poses are kept. Drives with better receivers weigh more. If several shifts fit, for
    example because rows repeat, nothing is moved; --figure shows the score of all shifts.

    Examples:

        fieldgrid align vineyard.gpkg --dry-run --figure scores.png

        fieldgrid align vineyard.gpkg --session june-17 --to june-03

        fieldgrid align vineyard.gpkg --rows

        fieldgrid align vineyard.gpkg --undo
    """
    if undo:
        options.refuse_given(
            ctx,
            {"map_", "session", "undo", "wait_s", "as_json", "quiet", "verbose"},
            "--undo cannot use it; leave it out",
        )
    options.check_figure(figure)
    options.check_outputs([figure], [], overwrite=overwrite)
    options.check_scheduler(scheduler, jobs)
    from fieldgrid.field import align_map, find_rows, undo_alignment
    from fieldgrid.maps import open_map

    plantings: dict[str, Planting] = {}
    patience = progress.patience(map_, wait_s)
    with open_map(map_, writable=not dry_run, patience=patience) as universal:
        if undo:
            names = undo_alignment(universal, session)
            if as_json:
                output.print_json({"map": str(map_), "undone": names})
            else:
                output.print_line(f"{', '.join(names)}: as before alignment")
            return
        with progress.stages() as show:
            found = align_map(
                universal, session, to=to or (), datum_from=datum_from, reach_m=reach,
                progress=show, jobs=jobs, scheduler=scheduler,
            )  # fmt: skip
        if rows:  # read here: the workers need no map, and after a change nothing may be lost
            plantings["before" if found.transforms else "now"] = find_rows(universal, jobs=jobs)
        if not dry_run and found.transforms:
            universal.set_transforms(found.transforms)
            if rows:
                plantings["after"] = find_rows(universal, jobs=jobs)
    if figure is not None:
        from fieldgrid.export import figures

        figures.save(figures.alignment_scores(found), figure)
    if as_json:
        value = _as_dict(map_, found, applied=not dry_run)
        if rows:
            value["rows"] = {when: blocks_as_dict(p) for when, p in plantings.items()}
        output.print_json(value)
        return
    _print(found)
    blocks = [(when, *row) for when, p in plantings.items() for row in block_rows(p)]
    if blocks:
        output.print_table(("rows", *BLOCK_COLUMNS), blocks)
    for when, planting in plantings.items():
        if not planting.rows:
            output.print_line(f"no rows of plants {when}")
    if dry_run:
        output.print_line("nothing was changed (--dry-run)")
    if figure is not None:
        output.print_line(f"figure {figure}")


def _print(found: MapAlignment) -> None:
    output.print_table(
        ("session", "east", "north", "sigma", "turn", "wander", "up", "matches", ""),
        [_drive_row(drive) for drive in found.drives],
    )
    for drive in found.drives:
        if drive.heights_kept is not None:
            output.print_line(f"{drive.name}: heights are not aligned, {drive.heights_kept}")
    if found.pairs:
        output.print_table(
            ("of", "against", "offset", "left", "sigma", "turn", "matches", ""),
            [_pair_row(pair) for pair in found.pairs],
        )
    else:
        output.print_line("no two sessions saw the same ground; each was compared only with itself")
    for pair in found.pairs:
        if pair.doubt is not None:
            output.print_line(f"{pair.b} against {pair.a}: {pair.doubt}; not used")
            continue
        if len(places := pair.contradictions):
            worst = places[0]
            output.print_line(
                f"{pair.b} against {pair.a}: {len(places)} of {pair.matches} places contradict the "
                f"others; {math.hypot(*worst.left_m):.2f} m are left about {worst.at_m[0]:.1f} m "
                f"east, {worst.at_m[1]:.1f} m north (does a receiver leap, or a pose drift there?)"
            )
        if len(alike := pair.agreement.alike_m):
            every = ", ".join(f"{east:+.1f} {north:+.1f}" for east, north in alike[:3])
            output.print_line(
                f"{pair.b} against {pair.a}: a shift by {every} m matches as well (repeating "
                "rows?); only the stated errors of the receivers exclude it"
            )
        if pair.weak_sigma_m > _UNTOLD_M:
            output.print_line(
                f"{pair.b} against {pair.a}: the shift along {pair.weak_axis_deg:.0f}° cannot "
                "be measured (uniform rows?); it comes from the receivers alone"
            )


def _drive_row(drive: DriveAlignment) -> tuple[str, ...]:
    if not drive.moved:
        why = drive.role.value if drive.matches else "nothing to compare with"
        return (drive.name, "", "", "", "", "", "", str(drive.matches), why)
    after, wander = drive.after, drive.after.wander
    # The largest departure from the shift.
    most_m = max(map(math.hypot, wander.east_m, wander.north_m)) if wander is not None else 0.0
    return (
        drive.name,
        f"{after.shift_east_m:+.3f} m",
        f"{after.shift_north_m:+.3f} m",
        f"{drive.sigma_m:.3f} m",
        f"{after.turn_deg:+.2f} ± {drive.turn_sigma_deg:.2f}°",
        f"{most_m:.3f} m",
        "" if after.heights is None else f"{after.heights.mean_m:+.3f} m",
        str(drive.matches),
        "",
    )


def _pair_row(pair: PairAlignment) -> tuple[str, ...]:
    east_m, north_m = pair.before_m
    in_doubt = pair.doubt is not None
    return (
        pair.b,
        pair.a,
        f"{east_m:+.2f} {north_m:+.2f} m",
        "" if in_doubt else "{:+.2f} {:+.2f} m".format(*pair.after_m),
        "" if in_doubt else f"{pair.sigma_m:.3f} m",
        "" if in_doubt else f"{pair.turn_before_deg:+.2f}°",
        str(pair.matches),
        "in doubt" if in_doubt else "",
    )


def _as_dict(path: Path, found: MapAlignment, *, applied: bool) -> dict[str, Any]:
    return {
        "map": str(path),
        "applied": applied and bool(found.transforms),
        "misfit": output.known(found.misfit),
        "sessions": [
            {
                "name": drive.name,
                "moved": drive.moved,
                "role": drive.role.value,
                "matches": drive.matches,
                "sigma_m": drive.sigma_m,
                "turn_sigma_deg": drive.turn_sigma_deg,
                "heights_kept": drive.heights_kept,
                "transform": asdict(drive.after),
            }
            for drive in found.drives
        ],
        "pairs": [
            {
                "of": pair.b,
                "against": pair.a,
                "at_m": pair.at_m.tolist(),
                "lay_apart_m": pair.before_m.tolist(),
                "lies_apart_m": pair.after_m.tolist(),
                "turn_deg": pair.turn_before_deg,
                "sigma_m": pair.sigma_m if pair.doubt is None else None,
                "weak_axis_deg": pair.weak_axis_deg,
                "weak_sigma_m": output.known(pair.weak_sigma_m),
                "matches": pair.matches,
                "left_sigmas": pair.left_sigmas if pair.doubt is None else None,
                "contradictions": [
                    {"at_m": one.at_m.tolist(), "left_m": one.left_m.tolist(), "sigmas": one.sigmas}
                    for one in pair.contradictions
                ],
                "doubt": pair.doubt,
                "rivals_m": pair.agreement.rivals_m.tolist(),
                "alike_m": pair.agreement.alike_m.tolist(),
            }
            for pair in found.pairs
        ],
    }
