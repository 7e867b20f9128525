"""What `fieldgrid route` says of a route, in tables and as JSON."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from fieldgrid.cli import output

if TYPE_CHECKING:
    from fieldgrid.field import Coverage, Route, SurveyPlan


def show(route: Route, coverage: Coverage | None, found: SurveyPlan | None) -> None:
    """Print the tables of a route, of the lanes that it covers and of what a survey is for."""
    share = route.turning_share if coverage is None else coverage.turning_share
    summary = [
        ("length", output.number(route.length_m, 1, "m")),
        ("turning", output.percent(share, 0)),
        ("in reverse", output.percent(route.reverse_share, 0)),
        ("changes of gear", str(route.cusps)),
        ("least clearance", output.number(route.least_clearance_m, 2, "m")),
    ]
    if coverage is not None:
        count = len(coverage.lanes)
        what = "lanes covered" if coverage.swaths is None else "tracks driven"
        summary.append((what, f"{count} of {count + len(coverage.left_out)}"))
        if coverage.swaths is not None:
            done = coverage.swaths
            headings = [block.heading_deg for block in coverage.planting.blocks]
            summary += [
                ("heading", ", ".join(output.number(value, 1, "°") for value in headings)),
                ("worked", output.number(done.worked_m2, 0, "m²")),
                ("of what can be reached", output.percent(done.worked_m2 / done.reachable_m2, 1)),
                ("crossing worked ground", output.number(done.crossing_m, 1, "m")),
            ]
    if found is not None:
        summary.append(("sees of what is not known in lanes", output.percent(found.share, 0)))
    output.print_table(("route", ""), summary)
    if found is not None:
        output.print_table(
            ("not known", "where", "area", "share"),
            [
                (
                    need.kind,
                    need.lane,
                    output.number(need.area_m2, 1, "m²"),
                    output.percent(need.share, 0),
                )
                for need in found.needs
            ],
        )
    if coverage is None:
        return
    output.print_table(
        ("lane", "direction", "from", "to"),
        [
            (
                lane.lane,
                "against its line" if lane.against else "along its line",
                output.number(lane.from_m, 1, "m"),
                output.number(lane.to_m, 1, "m"),
            )
            for lane in coverage.lanes
        ],
    )
    for lane in coverage.left_out:  # sentences, which are too long for the column of a table
        place = f"{lane.east_m:.2f},{lane.north_m:.2f}"
        output.print_line(f"not covered: {lane.lane}: {lane.reason} at {place}.")


def as_dict(
    route: Route, coverage: Coverage | None, survey: SurveyPlan | None, out: Path | None
) -> dict[str, Any]:
    """The same for JSON, with the file that was written."""
    found: dict[str, Any] = {
        "length_m": route.length_m,
        "turning_share": route.turning_share,
        "reverse_share": route.reverse_share,
        "gear_changes": route.cusps,
        "least_clearance_m": route.least_clearance_m,
        "poses": len(route.east_m),
        "file": None if out is None else str(out),
    }
    if coverage is None:
        return found
    swaths = {} if coverage.swaths is None else {"swaths": coverage.swaths._asdict()}
    if survey is not None:
        found["sees_share"] = survey.share
        found["needs"] = [
            {name: value for name, value in need._asdict().items() if name != "area"}
            for need in survey.needs
        ]
    return {
        **found,
        "turning_share": coverage.turning_share,
        "lanes": [lane._asdict() for lane in coverage.lanes],
        **swaths,
        "left_out": [lane._asdict() for lane in coverage.left_out],
        "remedy": coverage.remedy,
    }
