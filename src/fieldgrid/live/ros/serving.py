"""A map for Nav2 and RViz: what a bag of it would have latched, and the mask of its keep-outs."""

from __future__ import annotations

import numpy as np

from fieldgrid.export import BagContent, occupancy_grid, standing_messages
from fieldgrid.geometry import Datum
from fieldgrid.live.ros.node import RosNode
from fieldgrid.maps import OCCUPIED, CostCurve, MapFile, Selection
from fieldgrid.recordings import datum_message, ros_messages

KEEPOUT, FILTER_INFO = "keepout_filter_mask", "costmap_filter_info"
