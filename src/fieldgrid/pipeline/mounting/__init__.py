"""How a sensor is mounted on its vehicle, estimated from a drive and beside what was stated."""
