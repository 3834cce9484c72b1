"""Inference of the columns of an unknown file: guesses with reasons, and questions where the data do not decide."""

from dynident.identification.column_inference.inspection import Inspection, inspect_file
from dynident.identification.column_inference.proposal import Guess, Proposal, Question
from dynident.recordings.metadata import EffortKind

__all__ = ["EffortKind", "Guess", "Inspection", "Proposal", "Question", "inspect_file"]
