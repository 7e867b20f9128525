"""What becomes of a map when its writer dies, or its disk fails, at any moment."""
