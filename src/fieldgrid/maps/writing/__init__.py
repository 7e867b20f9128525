"""Changing a map: sessions added, folded, moved, removed, merged."""
