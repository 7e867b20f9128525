"""Whether a map is sound, and how it is repaired."""
