"""Where a search has its products from: the recordings, and the torque that sensitivities are about."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from dynident.diagnosis.candidates.gathering import PhasedProducts, gather_products
from dynident.diagnosis.candidates.pool import Pool
from dynident.diagnosis.search.refine import improve_reference
from dynident.diagnosis.search.state import Finding
from dynident.effects import ReferenceParameters
from dynident.progress import Progress, ignore_progress
from dynident.recordings import Preprocessing, Recording
from dynident.regressors.model import Model


@dataclass(frozen=True, eq=False)
class RecordedSource:
    """The recordings that a search learns from; `reference` is what loads are predicted with."""

    model: Model
    recordings: tuple[Recording, ...]
    preprocessing: Preprocessing
    reference: ReferenceParameters

    def gather_products(self, pool: Pool, progress: Progress = ignore_progress) -> PhasedProducts:
        """Inner products of all columns of a pool and of the torque."""
        return gather_products(
            pool.observation,
            self.model.signals,
            self.recordings,
            self.preprocessing,
            self.reference,
            pool.n_base,
            progress,
        )

    def add_findings(self, findings: Sequence[Finding]) -> RecordedSource:
        """The same, with the torque predicted by the model with these findings in it."""
        choices = [finding.judged.candidate.choice for finding in findings]
        better = improve_reference(self.model, choices, self.recordings, self.preprocessing, self.reference)
        return replace(self, reference=better)
