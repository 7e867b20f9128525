"""`fieldgrid evaluate`: a map against truth."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldgrid.cli import options, output

if TYPE_CHECKING:
    from fieldgrid.field import Evaluation, GroupScores
    from fieldgrid.maps import MapFile


def command(
    map_: options.MapArgument,
    truth: Annotated[
        Path, typer.Argument(metavar="TRUTH", help="A folder with the truth, or a survey.")
    ],
    min_pixels: Annotated[
        int | None,
        typer.Option(
            min=1,
            metavar="N",
            help="Folder only: a truth cell is observable from N pixels [default: 100].",
        ),
    ] = None,
    frames: Annotated[
        bool, typer.Option("--frames", help="Folder only: print the errors of each frame.")
    ] = False,
    within: Annotated[
        float | None,
        typer.Option(
            min=0.01,
            max=10.0,
            metavar="M",
            help="Survey only: largest distance between a surveyed object and the map "
            "[default: 0.3].",
        ),
    ] = None,
    crop: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Survey only: crop of its rows [default: vineyard]."),
    ] = None,
    things: Annotated[
        bool, typer.Option("--things", help="Survey only: print the error of each object.")
    ] = False,
    as_json: options.AsJson = False,
) -> None:
    """Compare a map with surveyed or simulated truth: obstacles, free space, rows, poses.

    The comparison is absolute: the map is not shifted or turned to fit. TRUTH is a folder
    with rasters and poses, or a survey of posts, rows and obstacles as GeoJSON or CSV.

    Examples:

        fieldgrid evaluate vineyard.gpkg examples/two_lanes/truth

        fieldgrid evaluate vineyard.gpkg posts.csv --within 0.2
    """
    from fieldgrid.maps import open_map

    is_survey = truth.is_file() or truth.suffix.lower() in (".csv", ".geojson", ".json")
    of_other = (
        {"--min-pixels": min_pixels, "--frames": frames}
        if is_survey
        else {"--within": within, "--crop": crop, "--things": things}
    )
    for flag, value in of_other.items():
        if value:
            what = "a survey" if is_survey else "a folder with the truth"
            raise typer.BadParameter(f"{truth} is {what}, which does not take it", param_hint=flag)
    with open_map(map_) as universal:
        if is_survey:
            _survey(universal, truth, within, crop, things, as_json)
            return
        from fieldgrid.field import OBSERVABLE_PIXELS, evaluate, read_truth
        from fieldgrid.pipeline import Attitudes, attitudes_of

        true = read_truth(truth)
        has_attitude = any(math.isfinite(pose.roll_deg) for pose in true.poses)
        attitudes = attitudes_of(universal) if has_attitude else Attitudes({}, {})
        result = evaluate(
            universal,
            true,
            observable_pixels=min_pixels or OBSERVABLE_PIXELS,
            attitudes=attitudes.by_session,
        )
    notes = [
        f"roll and pitch of {name} are not compared: {reason}"
        for name, reason in attitudes.left_out.items()
    ]
    if as_json:
        output.print_json({**result.as_dict(), "notes": notes})
        return
    _print_scores(result)
    for note in notes:
        output.print_line(f"note: {note}")
    if frames:
        _print_frames(result)


def _survey(
    universal: MapFile,
    path: Path,
    within: float | None,
    crop: str | None,
    things: bool,
    as_json: bool,
) -> None:
    from fieldgrid.field import WITHIN_M, evaluate_survey, read_survey

    result = evaluate_survey(
        universal,
        read_survey(path, universal.datum),
        within_m=WITHIN_M if within is None else within,
        crop=crop or "vineyard",
    )
    if as_json:
        output.print_json(result.as_dict())
        return
    metres = ("error_median_m", "error_p95_m", "error_max_m", "shift_east_m", "shift_north_m")
    rows = [
        (
            kind.kind,
            *(str(n) for n in (kind.surveyed, kind.not_seen, kind.found, kind.missed)),
            *(output.number(getattr(kind, name), 3, "m") for name in metres),
        )
        for kind in result.kinds
    ]
    output.print_table(
        (
            "", "surveyed", "not seen", "found", "missed", "error, median", "95 %", "largest",
            "shift east", "north",
        ),
        rows,
    )  # fmt: skip
    output.print_line(
        f"found: an obstacle of the map within {result.within_m:g} m; by chance this holds for "
        f"{output.percent(result.by_chance)} of the seen ground around the survey"
    )
    false = result.false
    if false is None:
        output.print_line(
            "false objects are not counted: add a polygon of the kind area to the survey, for the "
            "ground that it covers"
        )
    else:
        rows_too = "" if false.rows is None else f"{false.rows} rows and "
        output.print_line(
            f"false, on the ground of the survey: {rows_too}{false.obstacles} groups of obstacle "
            f"cells, {false.obstacles_m2:.2f} m2 together"
        )
    if things:
        rows = [
            (
                one.kind,
                one.id,
                "found" if one.found else "missed" if one.seen else "not seen",
                *(
                    output.number(error_m, 3)
                    for error_m in (one.east_error_m, one.north_error_m, one.error_m)
                ),
            )
            for one in result.things
        ]
        output.print_table(("kind", "id", "", "dE m", "dN m", "error m"), rows)


def _print_scores(result: Evaluation) -> None:
    groups = result.groups
    rows = [
        ("frames used / rejected", *(f"{g.poses.frames} / {g.poses.rejected}" for g in groups)),
        *_tolerance_rows("precision", groups),
        *_tolerance_rows("recall", groups),
        (
            "free cells with an obstacle",
            *(output.percent(g.obstacles.free_with_obstacle, 2) for g in groups),
        ),
        ("obstacle cells", *(str(g.obstacles.obstacle_cells) for g in groups)),
        ("observable true cells", *(str(g.obstacles.observable_cells) for g in groups)),
        ("free cells", *(str(g.obstacles.free_cells) for g in groups)),
        *_error_rows(groups),
    ]
    output.print_table(("", *(group.name for group in groups)), rows)
    if (ground := result.terrain) is not None:
        output.print_line(
            f"ground: RMSE {100 * ground.rmse_m:.1f} cm, bias {100 * ground.bias_m:+.1f} cm, 95 % "
            f"{100 * ground.p95_m:.1f} cm, largest {100 * ground.max_m:.1f} cm in {ground.cells} "
            f"cells of {ground.cell_m:g} m; {output.percent(ground.within_3_sigma)} within 3 sigma"
        )
    if (leaning := result.attitude) is not None:
        output.print_line(
            f"roll and pitch: median {leaning.median_deg:.2f}°, 95 % {leaning.p95_deg:.2f}°, "
            f"largest {leaning.max_deg:.2f}° in {leaning.frames} frames; "
            f"{output.percent(leaning.within_3_sigma)} within 3 sigma"
        )
    if result.unmatched_frames:
        output.print_line(f"{result.unmatched_frames} frames of the map are not in this truth")
    if result.unlevelled_frames:
        output.print_line(
            f"position errors include roll and pitch: {result.unlevelled_frames} frames have none "
            "and are placed as if the vehicle stood level, unlike the truth; cells are not affected"
        )


def _tolerance_rows(score: str, groups: tuple[GroupScores, ...]) -> list[tuple[str, ...]]:
    return [
        (
            f"{score} within {100 * float(t):.0f} cm",
            *(output.percent(getattr(g.obstacles, score)[t]) for g in groups),
        )
        for t in getattr(groups[0].obstacles, score)
    ]


def _error_rows(groups: tuple[GroupScores, ...]) -> list[tuple[str, ...]]:
    labels = (
        ("heading error, median", "heading_median_deg", 2, "°"),
        ("heading error, 95 %", "heading_p95_deg", 2, "°"),
        ("heading error, largest", "heading_max_deg", 2, "°"),
        ("position error, median", "position_median_m", 3, "m"),
        ("position error, largest", "position_max_m", 3, "m"),
    )
    within = (
        ("heading within 3 sigma", "heading_within_3_sigma"),
        ("position within 3 sigma", "position_within_3_sigma"),
    )
    return [
        *(
            (label, *(output.number(getattr(g.poses, name), digits, unit) for g in groups))
            for label, name, digits, unit in labels
        ),
        *(
            (label, *(output.percent(getattr(g.poses, name)) for g in groups))
            for label, name in within
        ),
    ]


def _print_frames(result: Evaluation) -> None:
    output.print_table(
        ("frame", "segment", "direction", "status", "dE m", "dN m", "heading °", "sigma °"),
        [
            (
                error.frame_id,
                error.segment,
                error.direction,
                error.status,
                f"{error.east_error_m:.3f}",
                f"{error.north_error_m:.3f}",
                f"{error.heading_error_deg:.2f}",
                f"{error.heading_sigma_deg:.2f}",
            )
            for error in result.frames
        ],
    )
