"""A map against surveyed or simulated truth, absolute: nothing is shifted or turned to fit."""
