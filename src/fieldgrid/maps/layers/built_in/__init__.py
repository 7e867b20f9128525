"""The layers that every map has, one module a subject."""
