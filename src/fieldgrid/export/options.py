"""Options that several formats take. Those of one format stand beside what writes it."""

from __future__ import annotations

from typing import Any

from fieldgrid.core import ConfigError, Flag, Settings, quoted, setting
from fieldgrid.geometry import FREE_UP_TO, OBSTACLE_ABOVE
from fieldgrid.maps import LEAST_DROP_M, LEAST_SEEN, LOSS, CostCurve


def _obstacle_above() -> Any:
    return setting(
        OBSTACLE_ABOVE,
        "density above which a cell is an obstacle",
        flag=Flag("--obstacle-above", "0..254"),
        ge=0,
        le=254,
    )


class PlaneOptions(Settings):
    """Of pictures that lie in a plane."""

    epsg: int | None = setting(
        None,
        "reproject to this system",
        usual="the map's own plane",
        flag=Flag("--epsg", "CODE"),
    )


class CurveOptions(Settings):
    """From density to cost: see `fieldgrid.CostCurve`."""

    free_up_to: int = setting(
        FREE_UP_TO,
        "density up to which a cell is free",
        flag=Flag("--free-up-to", "0..255"),
        ge=0,
        le=255,
    )
    obstacle_above: int = _obstacle_above()
    cost_shape: float = setting(
        1.0,
        "how costs rise between free and obstacle; 1 is a straight line",
        flag=Flag("--cost-shape", "POWER"),
    )

    least_seen: float = setting(
        LEAST_SEEN,
        "share of the map's own cells that must be seen in a larger cell without an obstacle",
        flag=Flag("--least-seen", "SHARE"),
    )

    least_drop_m: float = setting(
        LEAST_DROP_M,
        "a drop of the ground by this much is an obstacle; inf for none",
        flag=Flag("--least-drop", "M"),
        gt=0.0,
    )

    def curve(self) -> CostCurve:
        """The curve. ConfigError when there is none."""
        return CostCurve(
            self.free_up_to,
            self.obstacle_above,
            self.cost_shape,
            self.least_seen,
            self.least_drop_m,
        )


class ObstacleOptions(Settings):
    """Which cells are obstacles."""

    obstacle_above: int = _obstacle_above()


class ShapeOptions(ObstacleOptions):
    """How obstacles become polygons."""

    min_area_m2: float = setting(
        0.0, "smallest obstacle area", flag=Flag("--min-area", "M2"), ge=0.0, lt=1e9
    )
    simplify_m: float | None = setting(
        None,
        "largest deviation of simplified outlines",
        usual="a cell",
        flag=Flag("--simplify", "M"),
        ge=0.0,
        le=10.0,
    )


class QuadtreeOptions(Settings):
    """Of squares of several sizes: see `fieldgrid.Quadtree`."""

    quadtree_loss: float = setting(
        LOSS,
        "density by which a cell may differ from the mean of its square",
        flag=Flag("--quadtree-loss", "0..255"),
        ge=0.0,
        le=255.0,
    )
    quadtree_sides: str | None = setting(
        None,
        "sides that squares may have, the first that of a cell, in metres",
        usual="1, 2, 4 ... 256 cells",
        flag=Flag("--quadtree-sides", "M,M"),
    )
    quadtree_seen: float = setting(
        1.0,
        "share that must be seen of a square larger than a cell",
        flag=Flag("--quadtree-seen", "SHARE"),
        gt=0.0,
        le=1.0,
    )

    def sides_m(self) -> tuple[float, ...] | None:
        """The sides as numbers, None for all. ConfigError for what is no number."""
        if self.quadtree_sides is None:
            return None
        try:
            return tuple(float(side) for side in self.quadtree_sides.split(","))
        except ValueError as error:
            raise ConfigError(
                f"{quoted(self.quadtree_sides)} are no sides of squares; give metres, such as "
                "0.05,0.4."
            ) from error
