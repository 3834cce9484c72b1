"""What a foreign file most probably holds: guesses with reasons, and questions where the data do not say."""

from dynident.identification.imports.inspecting import Inspection, inspect_file
from dynident.identification.imports.proposal import Guess, Proposal, Question
from dynident.recordings.stated import EffortKind

__all__ = ["EffortKind", "Guess", "Inspection", "Proposal", "Question", "inspect_file"]
