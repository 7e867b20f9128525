"""Formats of features: GIS files, task data, guidance, QGIS projects."""
