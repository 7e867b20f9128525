"""Curves, polylines, planes through points, and features as files."""
