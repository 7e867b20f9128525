"""A part of a map as a dataset by the CF conventions, in which no cell that nobody saw has a value.

An unseen cell is NaN or what `_FillValue` names. Densities take all of 0..255, so they are stored
as int16 with -1 for unseen: readers make NaN of it.
"""

from __future__ import annotations

from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np

from fieldgrid.array_types import AnyArray, Bool
from fieldgrid.layers import LAYERS

if TYPE_CHECKING:
    from fieldgrid.mapfile.view import MapView

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
