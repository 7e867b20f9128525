"""Who looks on while a session is driven: a page in the browser that follows the vehicle."""

from fieldgrid.onlookers.address import parse_address
from fieldgrid.onlookers.page import LivePage
from fieldgrid.onlookers.story import Story

__all__ = ["LivePage", "Story", "parse_address"]
