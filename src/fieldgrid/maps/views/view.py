"""A part of a map as arrays, with what places them on Earth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any

import numpy as np

from fieldgrid.core import AnyArray, Bool, ConfigError, Float32, UInt8, notebook, quoted
from fieldgrid.geometry import Bounds, Datum, Lattice, Window, squares
from fieldgrid.maps.cost import LEAST_DROP_M
from fieldgrid.maps.file.records import FrameRecord
from fieldgrid.maps.layers.registry import LAYERS
from fieldgrid.maps.transfer import PaperFold, footprint
from fieldgrid.maps.vector.marks import Mark
from fieldgrid.maps.views.decision import (
    Decided,
    Decision,
    cells_under,
    deciding,
    marked_cells,
)

# A part of a map as a dataset by the CF conventions, in which no cell that nobody saw has a value.
#
# An unseen cell is NaN or what `_FillValue` names. Densities take all of 0..255, so they are stored
# as int16 with -1 for unseen: readers make NaN of it.


_UNITS = {"": "1", "frames": "1", "sessions": "1", "°": "degree"}
"""What UDUNITS, and so the conventions, call a layer's unit where it is not the same."""


def cf_dataset(view: MapView) -> Any:
    """The view as an `xarray.Dataset` as it is stored: whole numbers, attributes, `_FillValue`."""
    import xarray

    east_m, north_m = view.lattice.centres(view.window)
    axes = ("north_m", "east_m")
    variables: dict[str, Any] = {
        "observed": (
            axes,
            view.observed.astype(np.int8),
            {
                "long_name": "whether any frame observed the cell",
                "flag_values": np.array([0, 1], dtype=np.int8),
                "flag_meanings": "not_observed observed",
                "grid_mapping": "crs",
                "dtype": "bool",  # as xarray reads it back
            },
        )
    }
    for name, values in {"density": view.density, **view.layers}.items():
        layer = LAYERS[name]
        stored, fill = _stored(values, view.observed, layer.nodata)
        attributes = {
            "long_name": layer.meaning,
            "units": _UNITS.get(layer.unit, layer.unit),
            "grid_mapping": "crs",
            "_FillValue": fill,
        }
        if layer.above_datum:
            attributes["comment"] = (
                "The height above the WGS84 ellipsoid is datum_height_m + value + "
                "(east_m^2 + north_m^2) / 12.75e6."
            )
        variables[name] = (axes, stored, attributes)
    datum = view.datum
    variables["crs"] = ((), np.int32(0), datum.grid_mapping())
    dataset = xarray.Dataset(
        variables,
        coords={
            "north_m": ("north_m", north_m, _axis("y", "north")),
            "east_m": ("east_m", east_m, _axis("x", "east")),
        },
        attrs={
            "Conventions": "CF-1.11",
            "title": "Obstacles and ground seen from a vehicle, as a grid of the field",
            "source": "what a vehicle saw where its GNSS receiver says that it was",
            "history": f"exported by fieldgrid {version('fieldgrid')}",
            "comment": "A cell that nothing observed has _FillValue in every layer: it is not "
            "free ground. east_m and north_m are metres from the datum in its local tangent plane.",
            "cell_m": view.lattice.cell_m,
            "datum_lat_deg": datum.lat_deg,
            "datum_lon_deg": datum.lon_deg,
            "datum_height_m": datum.height_m,
            "crs_wkt": view.crs_wkt,
        },
    )
    for name in axes:
        dataset[name].encoding["_FillValue"] = None  # which coordinates must not have
    return dataset


def masked(values: AnyArray, observed: Bool, nodata: float | None) -> AnyArray:
    """Values in which an unseen cell is NaN; as they are where the layer has a value for it."""
    if nodata is not None:
        return values
    return np.asarray(np.where(observed, values, np.float32(np.nan)))


def _stored(values: AnyArray, observed: Bool, nodata: float | None) -> tuple[AnyArray, Any]:
    """The values as they are stored, and which of them says that nothing is known."""
    if nodata is not None:
        return values, values.dtype.type(nodata)
    if values.dtype.kind == "u" and values.dtype.itemsize < 8:
        wide = np.promote_types(values.dtype, np.int8)
        return np.where(observed, values, np.array(-1, wide)), wide.type(-1)
    floats = masked(values, observed, None)
    return floats, floats.dtype.type(np.nan)


def _axis(axis: str, direction: str) -> dict[str, str]:
    return {
        "standard_name": f"projection_{axis}_coordinate",
        "long_name": f"metres {direction} of the datum, centre of the cell",
        "units": "m",
        "axis": axis.upper(),
    }


MAX_CELLS = 400_000_000
"""Cells that a view may have: 800 MB of density and mask."""

DROP_LAYERS = ("drop", "sure_share")
"""What makes an obstacle of the edge of a drop, and unseen ground of what lies beyond it."""

BLOCK_CELLS = 2048
"""Side of the block that is folded at a time, so that its sums take 64 MB at most."""


@dataclass(frozen=True, slots=True)
class MapView:
    """A window of a map: 3D density, uint8 [rows north, columns east], row 0 in the south.

    0 with `observed` is free ground; without, nothing is known of the cell. `layers` has what
    else was asked for, by name, in arrays of the same shape. `is_base` when the cells are the
    map's own. All of these are what drives saw; `marks` are what people said of the map. `decided`
    is what follows from all that is known, where that was asked for: see `decision`.
    """

    lattice: Lattice
    window: Window
    density: UInt8
    observed: Bool
    datum: Datum
    layers: Mapping[str, AnyArray] = field(default_factory=dict)
    is_base: bool = False
    marks: tuple[Mark, ...] = ()
    decided: Decided | None = None

    @property
    def bounds(self) -> Bounds:
        """The outer edges in metres east and north of the datum."""
        return self.lattice.bounds(self.window)

    @property
    def transform(self) -> tuple[float, float, float, float, float, float]:
        """(a, b, c, d, e, f): east = a·column + b·row + c and north = d·column + e·row + f of a
        cell's south-west corner."""
        cell_m, bounds = 1.0 / self.lattice.cells_per_m, self.bounds
        return cell_m, 0.0, bounds.west_m, 0.0, cell_m, bounds.south_m

    @property
    def crs_wkt(self) -> str:
        """The plane of east and north as well-known text, for a GIS."""
        return self.datum.crs_wkt("WKT2_2019")

    def _repr_png_(self) -> bytes:
        """The density, north up, for a notebook."""
        return notebook.picture(self.density, self.observed, LAYERS["density"].colours.ramp)

    def layer(self, name: str) -> AnyArray:
        """A layer by its name; ConfigError when it was not asked for."""
        arrays = {"density": self.density, "observed": self.observed, **self.layers}
        if name not in arrays:
            raise ConfigError(
                f"The view has no layer {quoted(name)} but {', '.join(arrays)}; "
                f"read the map with layers=[{quoted(name)}]."
            )
        return arrays[name]

    @property
    def peak(self) -> UInt8:
        """The highest mean density of the map's own cells in each cell; of the layer `peak`."""
        return self.density if self.is_base else self.layer("peak")

    @property
    def seen_share(self) -> Float32:
        """The share of the map's own cells in each that were seen; of the layer `seen_share`."""
        return self.observed.astype(np.float32) if self.is_base else self.layer("seen_share")

    @property
    def sure_share(self) -> Float32:
        """`seen_share` without what was seen only beyond the edge of a drop, where that was asked
        for."""
        if "sure_share" not in self.layers:
            return self.seen_share
        sure: Float32 = self.layer("sure_share")
        return np.nan_to_num(sure, nan=0.0) if self.is_base else sure

    @property
    def drop_m(self) -> Float32:
        """How far the ground falls away in each cell; 0 where nobody asked for it, or knows."""
        if "drop" not in self.layers:
            return np.zeros(self.window.shape, dtype=np.float32)
        return np.nan_to_num(self.layer("drop"), nan=0.0)

    def decision(self, least_drop_m: float = LEAST_DROP_M) -> Decision:
        """What the cells count as for whoever plans, where the view was read to `decide`. Ground
        that falls by `least_drop_m` is an obstacle.

        Of a view that was not, and of one that was made, it is what its layers say: `peak` and
        `seen_share` where cells are larger than the map's own, and those of drops; with marks on
        the map's own cells.
        """
        decided = self.decided
        if decided is None:
            flags = np.zeros(self.window.shape, np.uint8)
            if self.is_base and self.is_marked:
                flags = marked_cells(self.marks, self.lattice, self.window)
            decided = Decided.of_cells(self.peak, self.sure_share, self.drop_m, flags)
        return decided.decision(least_drop_m)

    @property
    def is_marked(self) -> bool:
        """Whether a mark changes what any of the cells counts as."""
        return any(
            cells_under(mark, self.lattice).intersect(self.window) for mark in deciding(self.marks)
        )

    def to_xarray(self) -> Any:
        """The view as an `xarray.Dataset` over `north_m` and `east_m`, the cells' centres.

        What nobody saw is NaN in every layer; a layer of whole numbers is float, and is stored as
        whole numbers again. Its attributes follow the CF conventions, so that rioxarray and GDAL
        find the plane. Raises ConfigError when xarray is not installed.
        """
        try:
            import xarray
        except ImportError as error:
            raise ConfigError(
                "A view as Dataset needs xarray, which is not installed; "
                "run: pip install 'fieldgrid[xarray]'"
            ) from error
        return xarray.decode_cf(cf_dataset(self), decode_coords="all").load()


def empty_view(
    lattice: Lattice,
    window: Window,
    datum: Datum,
    layers: Sequence[str] = (),
    *,
    is_base: bool = False,
) -> MapView:
    """A view in which nothing has been observed, to be filled in place."""
    check_size(lattice, window)
    density = np.zeros(window.shape, dtype=np.uint8)
    observed = np.zeros(window.shape, dtype=np.bool_)
    arrays = {
        name: np.full(window.shape, LAYERS[name].nodata or 0, LAYERS[name].dtype) for name in layers
    }
    return MapView(lattice, window, density, observed, datum, arrays, is_base)


def check_size(lattice: Lattice, window: Window) -> None:
    """Raise ConfigError for a window of more cells than a view may have."""
    if window.width * window.height > MAX_CELLS:
        raise ConfigError(
            f"A view of {window.width} x {window.height} cells of {lattice.cell_m} m is over "
            f"{MAX_CELLS / 1e6:.0f} million cells; give smaller bounds or a larger cell."
        )


def fold_as_the_paper(view: MapView, frames: Sequence[FrameRecord]) -> None:
    """Fill a view from frames in the order given, block by block, a grid in memory at a time."""
    for block in squares(view.window, BLOCK_CELLS):
        fold = PaperFold(view.lattice, block)
        for frame in frames:
            if footprint(frame.spec, frame.pose, view.lattice).intersect(block) is not None:
                fold.add(frame.grid(), frame.pose)
        place = view.window.slices_of(block)
        view.density[place], view.observed[place] = fold.density()
