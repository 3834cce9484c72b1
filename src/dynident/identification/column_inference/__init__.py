"""Inference of the columns of an unknown file (`inspect`): guesses with reasons, and questions to the user."""

from dynident.identification.column_inference.file_inspection import Inspection, inspect_file
from dynident.identification.column_inference.metadata_proposal import Guess, Proposal, Question
from dynident.recordings.recording_metadata import EffortKind

__all__ = ["EffortKind", "Guess", "Inspection", "Proposal", "Question", "inspect_file"]
