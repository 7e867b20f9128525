"""Hostile input for every parser: `make fuzz`, and a short run of the same in the tests."""
