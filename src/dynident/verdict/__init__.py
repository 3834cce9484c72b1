"""State what a model is fit for, what not, and what to do about it."""

from dynident.diagnosis.comparing.content import DataOverlap, find_overlaps
from dynident.verdict.evidence import Outcome
from dynident.verdict.judge import ModelVerdict, is_stopped, verdict
from dynident.verdict.stopping import Stop
from dynident.verdict.tool_loads import DetectableForce
from dynident.verdict.use import MARKS, State, Use, UseName

__all__ = [
    "MARKS",
    "DataOverlap",
    "DetectableForce",
    "ModelVerdict",
    "Outcome",
    "State",
    "Stop",
    "Use",
    "UseName",
    "find_overlaps",
    "is_stopped",
    "verdict",
]
