"""Measuring one row: its line, its extent, its profile, its neighbours."""
