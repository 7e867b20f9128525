"""Tiles: their codec and tables, the levels above the base, pictures and overviews."""
