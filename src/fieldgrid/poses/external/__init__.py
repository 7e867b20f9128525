"""Poses of another program: brought to their place on Earth, and judged."""
