"""Rows of plants and what lies between them, found in the evidence of a map."""
