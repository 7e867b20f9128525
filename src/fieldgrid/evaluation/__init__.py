"""A map against surveyed or simulated truth, absolute: nothing is shifted or turned to fit."""

from fieldgrid.evaluation.against_survey import (
    FalseScore,
    KindScore,
    SurveyScores,
    ThingScore,
    evaluate_survey,
)
from fieldgrid.evaluation.attitude import AttitudeScores
from fieldgrid.evaluation.results import (
    Evaluation,
    FrameError,
    GroupScores,
    ObstacleScores,
    PoseErrors,
)
from fieldgrid.evaluation.scores import evaluate
from fieldgrid.evaluation.survey import Survey, SurveyFeature, read_survey
from fieldgrid.evaluation.terrain import TerrainScores, TrueGround
from fieldgrid.evaluation.truth import Truth, TruthPose, read_truth

__all__ = [
    "AttitudeScores",
    "Evaluation",
    "FalseScore",
    "FrameError",
    "GroupScores",
    "KindScore",
    "ObstacleScores",
    "PoseErrors",
    "Survey",
    "SurveyFeature",
    "SurveyScores",
    "TerrainScores",
    "ThingScore",
    "TrueGround",
    "Truth",
    "TruthPose",
    "evaluate",
    "evaluate_survey",
    "read_survey",
    "read_truth",
]
