"""Calibrations of cameras in all dialects, and the mounting on the vehicle."""
