"""A map against surveyed or simulated truth, absolute: nothing is shifted or turned to fit."""

from fieldgrid.evaluation.scores import (
    Evaluation,
    FrameError,
    Group,
    ObstacleScores,
    PoseErrors,
    evaluate,
)
from fieldgrid.evaluation.truth import Truth, TruthPose, read_truth

__all__ = [
    "Evaluation",
    "FrameError",
    "Group",
    "ObstacleScores",
    "PoseErrors",
    "Truth",
    "TruthPose",
    "evaluate",
    "read_truth",
]
