"""Result types of the proposed next experiment."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.diagnosis import Diagnosis
from dynident.excitation import DesignRequest


@dataclass(frozen=True)
class Separation:
    """How well an effect can be told from all else that may explain the same residual.

    `share` is what is left of its column beside the model and its rival; `standard_deviation`, in `unit`, that of the
    parameter which comes out best, infinite where nothing determines it; `t_value` the amplitude found so far over it,
    `None` where none is known.
    """

    parameter: str
    unit: str
    share: float
    standard_deviation: float
    t_value: float | None


@dataclass(frozen=True)
class NextExperiment:
    """A motion that would tell more: why, the design, and what people have to do beside running it.

    `present_separation` is that of the data at hand, `expected_separation` that of these data and the motion together;
    `None` where it rests on more than the motion (a temperature, a touch).
    """

    reason: str
    design: DesignRequest
    present_separation: Separation | None = None
    expected_separation: Separation | None = None
    instructions: tuple[str, ...] = ()

    @property
    def kind(self) -> str:
        """Kind of the design."""
        return self.design.kind


@dataclass(frozen=True, eq=False, repr=False)
class AdvisedDiagnosis(Diagnosis):
    """A diagnosis, and the experiment that would decide what it leaves open, None where a motion decides nothing."""

    next_experiment: NextExperiment | None = None
