"""Rows of plants and what lies between them, found in the evidence of a map."""

from fieldgrid.rows.crops import CROPS, Crop, crop_named
from fieldgrid.rows.find import find_rows, rows_of_view
from fieldgrid.rows.result import Block, Doubt, Gap, Headland, Lane, Obstacle, Planting, Row

__all__ = [
    "CROPS",
    "Block",
    "Crop",
    "Doubt",
    "Gap",
    "Headland",
    "Lane",
    "Obstacle",
    "Planting",
    "Row",
    "crop_named",
    "find_rows",
    "rows_of_view",
]
