"""Formats of cells: rasters, arrays, tables, points."""
