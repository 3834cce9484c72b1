"""Result types of the proposed next experiment."""

from __future__ import annotations

from dataclasses import dataclass

from dynident.diagnosis import Diagnosis
from dynident.excitation import DesignRequest


@dataclass(frozen=True)
class Separation:
    """How well an effect can be told from all else that may explain the same residual.

    Parameters
    ----------
    parameter : str
        Name of the parameter of the effect that comes out best.
    unit : str
        Unit of the parameter and of its standard deviation.
    share : float
        Share of the parameter's column that is left beside the model and the rival, 0 to 1.
    standard_deviation : float
        Standard deviation of the parameter; infinite where nothing determines it.
    t_value : float or None
        Amplitude found so far over the standard deviation; None where none is known.
    """

    parameter: str
    unit: str
    share: float
    standard_deviation: float
    t_value: float | None


@dataclass(frozen=True)
class NextExperiment:
    """A motion that would tell more: why, the design, and what people have to do besides running it.

    Parameters
    ----------
    reason : str
        Why this experiment, and what it should give, in words for the user.
    design : DesignRequest
        The request for the motion.
    present_separation : Separation, optional
        How well the data at hand tell the effects apart; None where the answer rests on more than the motion, such as a
        temperature or a touch.
    expected_separation : Separation, optional
        How well these data and the motion together will tell them apart; None as above.
    instructions : tuple of str
        What people have to do besides running the motion.
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
    """A diagnosis, and the experiment that would decide what it leaves open.

    Parameters
    ----------
    verdict : {"adequate", "missing_effect", "unexplained"}
        Whether the model is adequate, lacks an effect, or leaves a residual that no effect explains.
    summary : str
        The result in a few sentences.
    noise_floor : (n,)
        What no model of a joint can explain, N m or N, from the torque above the filter's band.
    residual_rms : (n,)
        Root mean square of the residual of each joint, N m or N.
    candidates : tuple of RankedEffect
        Effects that were tried, the one that explains most first.
    recommended : tuple of EffectChoice
        Effects to be added to the model.
    unknown : tuple of UnknownPattern
        Dependences in the residual that no effect explains.
    not_visible : tuple of Invisible
        Effects that this data could not have shown.
    failure_map : tuple of FailureSpot
        Where the residual of each joint is largest.
    changes : tuple of Change, optional
        What differs from the baseline, empty where nothing does; None where there was no baseline.
    friction : tuple of FrictionDifference
        How much the friction of each joint differs from the baseline's, whether it is among the changes or not.
    outcomes : tuple of Outcome
        What became of every effect on every joint, and why.
    detection_limits : tuple of DetectionLimit
        The smallest size of each effect on each joint that these recordings would have shown.
    conclusion : Conclusion, optional
        What all this says, and the next thing to do.
    next_experiment : NextExperiment, optional
        The proposed experiment; None where a motion decides nothing.
    """

    next_experiment: NextExperiment | None = None
