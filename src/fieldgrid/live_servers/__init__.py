"""Servers that show a live session: a page in the browser that follows the vehicle, and
Foxglove."""

from fieldgrid.live_servers.address import parse_address
from fieldgrid.live_servers.foxglove import FoxgloveServer
from fieldgrid.live_servers.live_state import LiveState
from fieldgrid.live_servers.page import LivePage

__all__ = ["FoxgloveServer", "LivePage", "LiveState", "parse_address"]
