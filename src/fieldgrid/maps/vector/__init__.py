"""Marks, features for a GIS, and the styles of QGIS."""
