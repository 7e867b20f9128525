"""Rows as files: GIS features, Lanelet2, AgOpenGPS."""
