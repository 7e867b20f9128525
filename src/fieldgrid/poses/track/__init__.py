"""A trajectory as a table, and as tracks for other programs."""
