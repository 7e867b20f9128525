"""`fieldgrid evaluate`: a map against truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fieldgrid.cli import options, output

if TYPE_CHECKING:
    from fieldgrid.evaluation import Evaluation, Group


def command(
    map_: options.MapArgument,
    truth: Annotated[Path, typer.Argument(metavar="TRUTH", help="A folder with the truth.")],
    min_pixels: Annotated[
        int,
        typer.Option(
            min=1,
            metavar="N",
            help="A truth cell is observable from N pixels [default: 100].",
            show_default=False,
        ),
    ] = 100,
    frames: Annotated[bool, typer.Option("--frames", help="Print each frame's errors.")] = False,
    as_json: options.AsJson = False,
) -> None:
    """Compare a map with surveyed or simulated truth: obstacles, free space, poses.

    Absolute: nothing is shifted or turned to fit. Example:

        fieldgrid evaluate vineyard.gpkg examples/two_lanes/truth
    """
    from fieldgrid.evaluation import evaluate, read_truth
    from fieldgrid.mapfile import open_map

    with open_map(map_) as universal:
        result = evaluate(universal, read_truth(truth), observable_pixels=min_pixels)
    if as_json:
        output.print_json(result.as_dict())
        return
    _print_scores(result)
    if frames:
        _print_frames(result)


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
    if result.unmatched_frames:
        output.print_line(f"{result.unmatched_frames} frames of the map are not in this truth")


def _tolerance_rows(score: str, groups: tuple[Group, ...]) -> list[tuple[str, ...]]:
    tolerances = getattr(groups[0].obstacles, score)
    return [
        (
            f"{score} within {100 * float(t):.0f} cm",
            *(output.percent(getattr(g.obstacles, score)[t]) for g in groups),
        )
        for t in tolerances
    ]


def _error_rows(groups: tuple[Group, ...]) -> list[tuple[str, ...]]:
    labels = (
        ("heading error, median", "heading_median_deg", 2, "°"),
        ("heading error, 95 %", "heading_p95_deg", 2, "°"),
        ("heading error, largest", "heading_max_deg", 2, "°"),
        ("position error, median", "position_median_m", 3, "m"),
        ("position error, largest", "position_max_m", 3, "m"),
    )
    return [
        (label, *(output.number(getattr(g.poses, name), digits, unit) for g in groups))
        for label, name, digits, unit in labels
    ]


def _print_frames(result: Evaluation) -> None:
    rows = [
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
    ]
    columns = (
        "frame", "segment", "direction", "status", "dE m", "dN m", "heading °", "sigma °",
    )  # fmt: skip
    output.print_table(columns, rows)
