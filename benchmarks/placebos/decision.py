"""What the decision rule would recommend of given rows: the one place that knows how candidates are judged.

It does what `dynident.diagnosis.diagnose_model` does, from its pool of candidates to its picks. Where that changes,
this has to follow; all else of the placebo stays.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.diagnosis import compare
from dynident.diagnosis.candidates.candidate_pool import Pool, build_pool
from dynident.diagnosis.candidates.inner_product_accumulation import PhasedProducts, gather_products
from dynident.diagnosis.comparison.noise_floor import estimate_sensor_noise
from dynident.diagnosis.residuals.resolution_at_reversals import compute_resolution
from dynident.diagnosis.residuals.shape_proposals import propose_shapes
from dynident.diagnosis.search.contacts_and_loads import find_contacts
from dynident.diagnosis.search.finding_refinement import improve_reference
from dynident.diagnosis.search.forward_selection import search_findings, settle_findings
from dynident.diagnosis.search.search_state import Finding, State, score_family
from dynident.effects import ReferenceParameters
from dynident.identification import Identification
from dynident.progress import ignore_progress
from dynident.recordings import Recording
from dynident.recordings.joint_phases import Phase
from dynident.regressors.dynamic_model_rows import FilteredSamples, stream_filtered_samples
from dynident.regressors.model_structure import Model
from dynident.regressors.observation_matrix import Observation, RegressorInputs
from dynident.regressors.row_phases import RowPhases, find_joints_with_friction
from placebos.shifting import IndexArray, SamplesOf, remembered

Change = Callable[[Observation, SamplesOf], SamplesOf]
"""What is done to the rows of an observation before they are judged."""

# Beside the phases: rows of the motion next to a halt.
_PARTIAL = len(Phase)


@dataclass(frozen=True, eq=False)
class ChangedRows:
    """Where the search has products from: rows that are changed before they are folded."""

    identification: Identification
    recordings: tuple[Recording, ...]
    reference: ReferenceParameters
    change: Change

    @property
    def model(self) -> Model:
        """The model in which something is missing."""
        return self.identification.model

    def gather_products(self, pool: Pool) -> PhasedProducts:
        """Inner products of all columns of a pool, its candidates' changed."""
        return self.folded(pool, _rows(self.identification, pool, self.reference))

    def folded(self, pool: Pool, plain: SamplesOf) -> PhasedProducts:
        """The same from rows that are made already."""
        return gather_products(
            pool.observation,
            self.model.signals,
            RegressorInputs(self.recordings, self.identification.preprocessing, self.reference),
            pool.n_base,
            samples_of=self.change(pool.observation, plain),
        )

    def add_findings(self, findings: Sequence[Finding]) -> ChangedRows:
        """The same, with the torque predicted by the model with these findings in it."""
        found = [finding.judged.candidate.choice for finding in findings]
        preprocessing = self.identification.preprocessing
        return replace(
            self,
            reference=improve_reference(
                self.model, found, RegressorInputs(self.recordings, preprocessing, self.reference)
            ).reference,
        )


@dataclass(frozen=True, eq=False)
class Question:
    """What is missing in a model of these recordings? With all that does not depend on what is done to their rows."""

    identification: Identification
    recordings: tuple[Recording, ...]
    pool: Pool
    floor: FloatArray
    plain: SamplesOf

    @classmethod
    def of(cls, identification: Identification, recordings: Sequence[Recording]) -> Question:
        """Everything of the catalogue that could be missing, and what the residual suggests."""
        preprocessing = identification.preprocessing
        comparisons = [compare(identification, recording) for recording in recordings]
        resolved = compute_resolution(comparisons, preprocessing)
        pool = build_pool(identification.model, None, propose_shapes(comparisons, recordings, identification), resolved)
        floor = estimate_sensor_noise(recordings, preprocessing)
        plain = remembered(_rows(identification, pool, identification.estimate.next_reference()))
        return cls(identification, tuple(recordings), pool, floor, plain)

    def named(self, change: Change) -> tuple[str, ...]:
        """Names, with their joints, of all that passes once the rows are changed."""
        rows = ChangedRows(self.identification, self.recordings, self.identification.estimate.next_reference(), change)
        start = self._start(rows.folded(self.pool, self.plain))
        first = score_family(start, self.pool.initial_candidates)
        found = search_findings(start, first, rows, ignore_progress)
        settle_findings(found)
        return tuple(_told(finding) for finding in found.state.findings)

    def kinds_of(self, recording: Recording, samples: FilteredSamples) -> IndexArray:
        """(m, n): whether a joint moves, turns round, stands, or moves beside a halt: each another kind of equation."""
        phases = _phases(self.identification, self.pool, recording)
        found = phases.phases_at(samples.segment, samples.t)
        partial = phases.find_partial_rows(samples.segment, samples.t, found, samples.held)
        return np.where(partial, _PARTIAL, found).astype(np.intp)

    def _start(self, data: PhasedProducts) -> State:
        state = State(data, self.pool, tuple(range(self.pool.n_base)), self.identification.noise, self.floor)
        findings = find_contacts(state, self.identification.preprocessing)
        for finding in findings:
            state = state.add_finding(finding)
        return state.estimate_noise() if findings else state


def _rows(identification: Identification, pool: Pool, reference: ReferenceParameters) -> SamplesOf:
    preprocessing = identification.preprocessing

    def samples_of(recording: Recording) -> Iterable[FilteredSamples]:
        phases = _phases(identification, pool, recording)
        return stream_filtered_samples(pool.observation, recording, preprocessing, reference, phases=phases)

    return samples_of


def _phases(identification: Identification, pool: Pool, recording: Recording) -> RowPhases:
    phases = RowPhases.from_recording(pool.observation, recording, identification.preprocessing)
    return phases.with_friction_of(find_joints_with_friction(pool.observation, pool.n_base))


def _told(finding: Finding) -> str:
    candidate = finding.judged.candidate
    return candidate.effect + (f" on {', '.join(candidate.joints)}" if candidate.joints else "")
