"""Which fixes are fit to map with, and the reasons why the others are not."""
