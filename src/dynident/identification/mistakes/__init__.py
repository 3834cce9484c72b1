"""Gross faults of a recording, found by the robot's own dynamics: columns in another order, signs turned round."""

from dynident.identification.mistakes.checks import CAUSES, VETOES, Examined, checks_against, examine
from dynident.identification.mistakes.search import Finding, mistakes_in
from dynident.identification.mistakes.swaps import Mistake

__all__ = ["CAUSES", "VETOES", "Examined", "Finding", "Mistake", "checks_against", "examine", "mistakes_in"]
