"""Routes that work the lanes of a planting, or parallel tracks, one after the other."""
