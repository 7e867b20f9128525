"""Recordings at URLs: copied to this machine, and read from there."""
