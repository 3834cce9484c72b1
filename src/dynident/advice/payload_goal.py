"""The goal payload of a campaign: mass and centre of a load that is mounted after some runs without it.

The load is an effect of the loaded runs alone, so that it is what the last link has there beyond the runs without it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from dynident.advice.campaign_request import LOAD_QUANTITIES, CampaignRequest
from dynident.array_types import FloatArray, IndexArray
from dynident.effects import EffectChoice, choose_payload, get_role
from dynident.errors import DynidentError
from dynident.estimation.parameter_covariance import NORMAL_95
from dynident.excitation.design_observation_matrix import DesignModel, build_design_model
from dynident.identification import Identification
from dynident.number_format import format_number
from dynident.recordings import Recording
from dynident.robot import Robot

_CONFIDENCE = 0.975
_PLANNED = "planned run"
_UNITS = {"mass": "kg", "centre_x": "m", "centre_y": "m", "centre_z": "m"}


@dataclass(frozen=True, eq=False)
class PayloadErrors:
    """Uncertainty of a load, each quantity's over the one that was asked for.

    Parameters
    ----------
    quantities : tuple of str
        What is to be known: mass, centre_x, …
    indices : (1 + k,)
        Columns of the model: of the mass, and of the first moment of each quantity.
    values : (1 + k,)
        Their values, kg and kg m.
    freedom : (1 + k,)
        Degrees of freedom of their variances.
    tolerances : (k,)
        Half-widths that were asked for, kg and m.
    """

    quantities: tuple[str, ...]
    indices: IndexArray
    values: FloatArray
    freedom: FloatArray
    tolerances: FloatArray

    def compute_errors(self, covariance: FloatArray) -> FloatArray:
        """Return the half-widths (k,) of the 95 % intervals, each as a share of the one asked for."""
        return np.asarray(self._compute_half_widths(covariance) / self.tolerances)

    def describe(self, covariance: FloatArray) -> str:
        """Return the load in words: each quantity with the half-width of its interval."""
        if not self._shows_mass(covariance):
            return f"the runs show no load yet (mass {format_number(float(self.values[0]))} kg)"
        of_moments = self.values[1:] / self.values[0]
        estimates = [
            self.values[0] if name == "mass" else moment
            for name, moment in zip(self.quantities, of_moments, strict=True)
        ]
        return ", ".join(
            f"{name.replace('_', ' ')} {format_number(float(value))} ± {format_number(float(width), 2)} {_UNITS[name]}"
            for name, value, width in zip(
                self.quantities, estimates, self._compute_half_widths(covariance), strict=True
            )
        )

    def _shows_mass(self, covariance: FloatArray) -> bool:
        deviation = float(np.sqrt(max(covariance[self.indices[0], self.indices[0]], 0.0)))
        return bool(self.values[0] > NORMAL_95 * deviation)

    def _compute_half_widths(self, covariance: FloatArray) -> FloatArray:
        mass, moments = self.values[0], self.values[1:]
        part = covariance[np.ix_(self.indices, self.indices)]
        is_shown, is_mass = self._shows_mass(covariance), np.array(self.quantities) == "mass"
        slopes = np.zeros((len(self.quantities), len(self.indices)))
        slopes[is_mass, 0] = 1.0
        for k in np.flatnonzero(~is_mass & is_shown):
            # The centre is the first moment over the mass.
            slopes[k, 0], slopes[k, 1 + k] = -moments[k] / mass**2, 1.0 / mass
        deviations = np.sqrt(np.maximum(np.einsum("ka,ab,kb->k", slopes, part, slopes), 0.0))
        freedom = np.where(is_mass, self.freedom[0], np.minimum(self.freedom[0], self.freedom[1:]))
        widths = np.asarray(scipy.stats.t.ppf(_CONFIDENCE, freedom) * deviations)
        # A load of no mass has its centre anywhere.
        widths[~is_mass & (not is_shown)] = np.inf
        return widths


def choose_load(loaded: Sequence[Recording]) -> EffectChoice:
    """Return the load as an effect of the loaded runs; of the run that is planned, where there is none yet."""
    return replace(choose_payload(_PLANNED), runs=tuple(recording.name for recording in loaded) or (_PLANNED,))


def has_load(effects: Sequence[EffectChoice]) -> bool:
    """Return whether a load is among effects: of those that a campaign identifies, it alone acts in some runs only.

    Parameters
    ----------
    effects : sequence of EffectChoice
        The effects of a model.
    """
    return any(choice.runs for choice in effects)


def name_as_loaded(recording: Recording, earlier: Sequence[Recording]) -> Recording:
    """Return a recording with the load under the name of the run before it, in which a model knows the load.

    Parameters
    ----------
    recording : Recording
        The recording of a run with the load.
    earlier : sequence of Recording
        The runs before it.
    """
    return replace(recording, name=earlier[-1].name)


def name_load_parameters(robot: Robot, request: CampaignRequest) -> tuple[str, ...]:
    """Return the names of the base parameters that tell the quantities of a load.

    Parameters
    ----------
    robot : Robot
        The robot.
    request : CampaignRequest
        What is to be known of the load.

    Raises
    ------
    DynidentError
        For no quantity, one that does not exist, or one that no motion of this robot shows.
    """
    words = ", ".join(LOAD_QUANTITIES)
    if not request.quantities or len(set(request.quantities)) < len(request.quantities):
        raise DynidentError(f"name what is to be known of the load, each once: {words}", pointer="/quantities")
    for name in request.quantities:
        if name not in LOAD_QUANTITIES:
            raise DynidentError(f"a load has no {name}; choose of {words}", pointer="/quantities")
    model = build_design_model(robot, (*request.choices.effects, choose_load(())), other_runs=True)
    shown = _find_load_columns(model)
    needed = {"mass": "Mp"} | {name: LOAD_QUANTITIES[name] for name in request.quantities}
    for name, parameter in needed.items():
        if parameter not in shown:
            raise DynidentError(
                f"no motion of this robot shows the {name.replace('_', ' ')} of a load on its last link apart from the "
                "rest of the load",
                pointer="/quantities",
            )
    return tuple(shown[parameter] for parameter in needed.values())


def _find_load_columns(model: DesignModel) -> dict[str, str]:
    """Return the names of base parameters that are one parameter of the load alone, by that parameter."""
    return {
        model.columns[k].parameter: model.columns[k].name
        for row, k in zip(model.base.grouping, model.base.kept, strict=True)
        if get_role(model.columns[k]) == "load" and np.count_nonzero(row) == 1
    }


def select_payload_errors(identification: Identification, request: CampaignRequest) -> PayloadErrors | None:
    """Select the parameters of a model that tell a load; None before the first loaded run."""
    places = {
        column.parameter: k
        for k, column in enumerate(identification.model.kept)
        if get_role(column) == "load" and column.runs
    }
    parameters = ("Mp", *(LOAD_QUANTITIES[name] for name in request.quantities))
    if not all(parameter in places for parameter in parameters):
        return None
    indices = np.array([places[parameter] for parameter in parameters], dtype=np.intp)
    return PayloadErrors(
        request.quantities,
        indices,
        identification.values[indices],
        identification.statistics.freedom[indices],
        np.array([request.mass_error if name == "mass" else request.centre_error for name in request.quantities]),
    )


def add_load(request: CampaignRequest, recordings: Sequence[Recording]) -> CampaignRequest:
    """Return the request with the load among its effects, once there are loaded runs."""
    loaded = recordings[request.unloaded_runs :]
    if request.goal != "payload" or not loaded:
        return request
    choices = request.choices
    return replace(request, choices=replace(choices, effects=(*choices.effects, choose_load(loaded))))
