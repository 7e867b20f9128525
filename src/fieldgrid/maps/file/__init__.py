"""The map file: its tables, records and digests, and the map that is open."""
