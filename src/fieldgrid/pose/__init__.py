"""Poses: where the grid origin was, where the nose pointed, how sure that is, and in which gear."""

from fieldgrid.pose.accepted import datum_of, no_fix_sentence
from fieldgrid.pose.clock_search import ClockOffset, ClockSearch
from fieldgrid.pose.convention import Comparison
from fieldgrid.pose.estimate import Estimate, carry_lever, estimate_poses
from fieldgrid.pose.fused import conditioned
from fieldgrid.pose.georeference import Georeference
from fieldgrid.pose.given import GIVEN
from fieldgrid.pose.levelled import levelling_attitude, tells_attitude
from fieldgrid.pose.paper import default_baseline_m
from fieldgrid.pose.report import FixOffset, PoseReport
from fieldgrid.pose.settings import HeadingSource, heading_source
from fieldgrid.pose.unseen import UnseenFault, unseen_sentence
from fieldgrid.pose.verdict import ErrorBudget

__all__ = [
    "GIVEN",
    "ClockOffset",
    "ClockSearch",
    "Comparison",
    "ErrorBudget",
    "Estimate",
    "FixOffset",
    "Georeference",
    "HeadingSource",
    "PoseReport",
    "UnseenFault",
    "carry_lever",
    "conditioned",
    "datum_of",
    "default_baseline_m",
    "estimate_poses",
    "heading_source",
    "levelling_attitude",
    "no_fix_sentence",
    "tells_attitude",
    "unseen_sentence",
]
