"""Logs and tables: columns, times, units, fixes, gyro and wheels."""
