"""Routes that a vehicle can drive over what a map has seen."""
