"""The pose now: a fixed-lag estimate, carried to the newest frame."""
