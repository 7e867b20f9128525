"""Who looks on while a session is driven: a page in the browser that follows the vehicle, and
Foxglove."""

from fieldgrid.onlookers.address import parse_address
from fieldgrid.onlookers.foxglove import FoxgloveServer
from fieldgrid.onlookers.page import LivePage
from fieldgrid.onlookers.story import Story

__all__ = ["FoxgloveServer", "LivePage", "Story", "parse_address"]
