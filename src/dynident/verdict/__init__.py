"""Verdicts: what a model is fit for, what not, and what to do next.

The observer of contacts is of `dynident.validation`; its names can still be imported from here.
"""

from dynident.diagnosis.comparison.data_leakage import DataOverlap, find_overlaps
from dynident.validation.contact_detection import ContactDetection as ContactDetection
from dynident.validation.contact_detection import calibrate_contact_detection
from dynident.validation.momentum_observer import MomentumObserver as MomentumObserver
from dynident.validation.momentum_observer import ObservedContacts as ObservedContacts
from dynident.verdict.fitness_by_use import MARKS, Action, NextStep, State, Use, UseName
from dynident.verdict.held_out_evidence import DetectableForce, Outcome
from dynident.verdict.model_verdict import ModelVerdict, explain_stop, is_stopped, verdict
from dynident.verdict.stop_cause import Stop

__all__ = [
    "MARKS",
    "Action",
    "DataOverlap",
    "DetectableForce",
    "ModelVerdict",
    "NextStep",
    "Outcome",
    "State",
    "Stop",
    "Use",
    "UseName",
    "calibrate_contact_detection",
    "explain_stop",
    "find_overlaps",
    "is_stopped",
    "verdict",
]
