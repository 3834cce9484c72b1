"""Build a design's criterion: its parameters, weights, a-priori values, rivals and earlier information.

Holds what replaces an unknown a-priori value.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import EffectChoice
from dynident.errors import DynidentError, describe_missing_joint
from dynident.excitation.criteria.criterion_choice import CriterionChoice
from dynident.excitation.criteria.optimality_criteria import (
    Criterion,
    CriterionValues,
    RowStructure,
    build_smooth_criterion,
    compute_true_values,
)
from dynident.excitation.criteria.parameter_variances import ParameterSelection
from dynident.excitation.criteria.prediction_region import Region, compute_moments, draw_region
from dynident.excitation.design_observation_matrix import DesignModel
from dynident.robot.json_fields import join_names, make_pointer

# Of the largest parameter of the same unit: smaller ones cannot be told from zero anyway, and must not rule.
_SMALLEST_SHARE = 0.01
# Where nothing is known: one unit of the parameter.
_WHERE_UNKNOWN = 1.0


def find_a_priori_values(model: DesignModel, choice: CriterionChoice) -> tuple[FloatArray, tuple[str, ...]]:
    """Return |Z| (b,) of the effects' base parameters, and notes on what was assumed.

    Stated values come first, then the description's, never below 1 % of the largest of the same unit; one unit where
    neither has a value.

    Parameters
    ----------
    model : DesignModel
        Model of the design.
    choice : CriterionChoice
        The criterion, whose stated values come first.

    Returns
    -------
    values : (b,)
    notes : tuple of str

    Raises
    ------
    DynidentError
        A stated value is for a parameter that does not exist.
    """
    names = model.parameter_names
    unknown = [name for name in choice.a_priori if name not in names]
    if unknown:
        raise DynidentError(
            f"there is no base parameter {join_names(unknown)}; there are: {join_names(names)}",
            pointer="/criterion/a_priori",
        )
    # The base columns of the effects come first; those behind them only predict torque.
    columns = model.base_columns[: model.n_parameters]
    units = np.array([column.unit for column in columns])
    # Parameters of different units cannot be compared, so that the least value is found unit by unit.
    values = np.abs(model.nominal_values[: model.n_parameters])
    for unit in set(units):
        same = units == unit
        values[same] = np.maximum(values[same], _SMALLEST_SHARE * values[same].max())
    assumed = []
    for k, name in enumerate(names):
        if name in choice.a_priori:
            values[k] = abs(choice.a_priori[name])
        elif values[k] == 0.0:
            values[k] = _WHERE_UNKNOWN
            assumed.append(name)
    note = f"A-priori values of {join_names(assumed)} were not given; 1 was assumed." if assumed else ""
    return values, ((note,) if note else ())


@dataclass(frozen=True, eq=False)
class DesignCriterion:
    """The measure of a motion: a criterion, a-priori magnitudes, and the parameters whose variances count.

    Parameters
    ----------
    choice : CriterionChoice
        The criterion.
    a_priori : (b,)
        Magnitudes |Z| of the parameters.
    deciding : ParameterSelection
        Parameters that the criterion is about, and weights of the joints' rows.
    notes : tuple of str
        What was assumed, in words for the user.
    earlier : (r, b), optional
        Rows besides W / √N that stand for the information of earlier runs.
    structure : RowStructure, optional
        Entries of W that are zero in every motion; none where left out.
    """

    choice: CriterionChoice
    a_priori: FloatArray
    deciding: ParameterSelection
    notes: tuple[str, ...] = ()
    earlier: FloatArray | None = None
    structure: RowStructure | None = None

    @property
    def smooth_criterion(self) -> Criterion:
        """The smooth criterion that is optimised, a function of W / √N."""
        return build_smooth_criterion(
            self.choice, self.a_priori, self.deciding, structure=self.structure, earlier=self.earlier
        )

    def compute_logarithm(self, values: CriterionValues) -> float:
        """Return the logarithm of a motion's criterion, as it is optimised; infinite without full rank."""
        if self.choice.name == "d_optimal":
            # The value is the logarithm of a volume; the criterion is that of the mean variance.
            return values.criterion / len(self.a_priori)
        return float(np.log(values.criterion))

    def evaluate(self, w: FloatArray, n_samples: int) -> CriterionValues:
        """Return the true values of W.

        Parameters
        ----------
        w : (r, b)
            Rows of W.
        n_samples : int
            Number of samples N.

        Returns
        -------
        CriterionValues
            Values by all criteria, without smoothing.
        """
        if self.earlier is not None:
            # The earlier rows belong to W / √N, and `compute_true_values` divides by √N.
            w = np.concatenate([w, np.sqrt(n_samples) * self.earlier])
        return compute_true_values(self.choice, w, n_samples, self.a_priori, self.deciding)


def build_design_criterion(
    model: DesignModel,
    choice: CriterionChoice,
    noise: Mapping[str, float],
    *,
    one_equation: bool = False,
    earlier: FloatArray | None = None,
    region: Region | None = None,
) -> DesignCriterion:
    """Return the measure of motions for a criterion on a model.

    Parameters
    ----------
    model : DesignModel
        Model of the design.
    choice : CriterionChoice
        The criterion.
    noise : mapping of str to float
        Standard deviation of each joint's torque noise by joint name, N m or N.
    one_equation : bool
        Whether a sample has one row, not one a joint; the joints' noise then has no part in the criterion.
    earlier : (r, b), optional
        Rows besides W / √N that stand for the information of earlier runs.
    region : Region, optional
        States whose torque is to be predicted, for the criterion "prediction"; by default states within the limits.

    Returns
    -------
    DesignCriterion
        The measure that makes motions comparable; the smaller the better.

    Raises
    ------
    DynidentError
        As in `select_parameters`.
    """
    a_priori, assumed = find_a_priori_values(model, choice)
    notes = assumed if choice.name == "weighted" else ()
    deciding = select_parameters(model, choice, noise)
    if choice.name == "prediction":
        states = region or draw_region(model.robot, {})
        deciding = replace(deciding, moments=compute_moments(model, states).sum(axis=0))
    if one_equation:
        # The row of a sample is a sum over all joints, which the noise of a single joint cannot weigh.
        deciding = replace(deciding, row_weights=np.ones(1))
        return DesignCriterion(choice, a_priori, deciding, notes, earlier)
    return DesignCriterion(choice, a_priori, deciding, notes, earlier, RowStructure.from_entries(model.present_entries))


def add_rivals(effects: tuple[EffectChoice, ...], choice: CriterionChoice) -> tuple[EffectChoice, ...]:
    """Return the effects of a design, with those that its criterion is to separate.

    Parameters
    ----------
    effects : tuple of EffectChoice
        Effects to be identified.
    choice : CriterionChoice
        The criterion.
    """
    if choice.name != "separation":
        return effects
    return effects + tuple(rival for rival in choice.effects if not _is_covered(rival, effects))


def _is_covered(rival: EffectChoice, effects: Sequence[EffectChoice]) -> bool:
    return any(
        effect.effect == rival.effect
        # An effect without joints acts on all of them, and so covers a rival on any.
        and (not effect.joints or (bool(rival.joints) and set(rival.joints) <= set(effect.joints)))
        and effect.shape_values == rival.shape_values
        for effect in effects
    )


def select_parameters(model: DesignModel, choice: CriterionChoice, noise: Mapping[str, float]) -> ParameterSelection:
    """Return the parameters that a criterion is about; all of them for a criterion that names none.

    Parameters
    ----------
    model : DesignModel
        Model of the design.
    choice : CriterionChoice
        The criterion.
    noise : mapping of joint name to N m or N
        Standard deviation of the joints' torque; that of the others counts as 1, or as the mean of those stated.

    Returns
    -------
    ParameterSelection
        Groups of parameters, and the weights of the joints' rows.

    Raises
    ------
    DynidentError
        A parameter does not exist, or no column of an effect is left: no motion can tell it from the others.
    """
    weights = compute_row_weights(model, noise)
    if choice.name == "parameters":
        return ParameterSelection((_find_parameters(model, choice.parameters),), weights)
    if choice.name == "separation":
        groups = [_require_effect_parameters(model, rival, index) for index, rival in enumerate(choice.effects)]
        return ParameterSelection(tuple(groups), weights)
    return ParameterSelection((tuple(range(model.n_parameters)),), weights)


def compute_row_weights(model: DesignModel, noise: Mapping[str, float]) -> FloatArray:
    """Return one over the noise of every joint (n,).

    Parameters
    ----------
    model : DesignModel
        Model of the design.
    noise : mapping of str to float
        Standard deviation of each joint's torque noise by joint name, N m or N.
    """
    for name, value in noise.items():
        at = make_pointer(name, within="/noise")
        if name not in model.robot.joint_names:
            raise DynidentError(
                describe_missing_joint(name, model.robot.joint_names),
                pointer=at,
                title="Unknown joint",
            )
        if not (np.isfinite(value) and value > 0):
            raise DynidentError(f"the noise of joint '{name}' is {value}; it must be a positive number", pointer=at)
    # Joints without a stated noise take the mean of the others: any other number would let them rule, or not count at
    # all.
    typical = float(np.mean(list(noise.values()))) if noise else 1.0
    return np.array([1.0 / noise.get(name, typical) for name in model.robot.joint_names])


def _find_parameters(model: DesignModel, chosen_names: Sequence[str]) -> tuple[int, ...]:
    names = model.parameter_names
    unknown = [name for name in chosen_names if name not in names]
    if unknown:
        raise DynidentError(
            f"there is no base parameter {join_names(unknown)}; there are: {join_names(names)}",
            pointer="/criterion/parameters",
        )
    return tuple(k for k, name in enumerate(names) if name in chosen_names)


def find_effect_parameters(model: DesignModel, choice: EffectChoice) -> tuple[int, ...]:
    """Return the indices of the base parameters that belong to an effect alone; none where it is absorbed.

    Parameters
    ----------
    model : DesignModel
        Model of the design.
    choice : EffectChoice
        The effect with its joints and shape constants.
    """
    return tuple(
        k
        for k, column in enumerate(model.base_columns[: model.n_parameters])
        if column.effect == choice.effect
        and (not choice.joints or not column.link or column.link in choice.joints)
        and set(choice.shape) <= set(column.shape)
    )


def _require_effect_parameters(model: DesignModel, rival: EffectChoice, index: int) -> tuple[int, ...]:
    indices = find_effect_parameters(model, rival)
    if not indices:
        raise DynidentError(
            f"no motion can distinguish {rival.effect} from the rest of the model: its columns depend on the others, "
            "or on signals that a trajectory does not contain",
            pointer=f"/criterion/effects/{index}",
            title="Inseparable effect",
        )
    return indices
