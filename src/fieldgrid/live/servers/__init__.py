"""Servers of a live session: a page, Foxglove, a feed for controllers."""
