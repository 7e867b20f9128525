"""Routes that a vehicle can drive over what a map has seen."""

from fieldgrid.route.plan import Route, plan_route, route_in_view
from fieldgrid.route.vehicle import Vehicle, read_vehicle

__all__ = ["Route", "Vehicle", "plan_route", "read_vehicle", "route_in_view"]
