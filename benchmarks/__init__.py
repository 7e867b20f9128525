"""What the project claims, measured: `make bench` for speed and memory, `make accuracy`."""

from pathlib import Path

EXAMPLE = Path(__file__).resolve().parents[1] / "examples" / "two_lanes"
"""The drive that every figure is taken from, unless its line says otherwise."""
