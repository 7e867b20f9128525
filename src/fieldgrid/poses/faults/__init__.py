"""Sensors and declarations that a drive contradicts, one module a fault."""
