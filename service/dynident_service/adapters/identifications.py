"""Identifications between the contract and the science."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.effects import EffectChoice
from dynident.effects.catalogue import check_shape, joints_of
from dynident.estimation import Errors
from dynident.identification import Identification, IdentificationChoices
from dynident.identification.data import parted
from dynident.identification.dependence import ParameterDependence, parameter_dependence
from dynident.identification.essential import EssentialPath
from dynident.identification.result import IdentifiedParameter
from dynident.identification.shape_constants import ShapeConstant
from dynident.identification.shapes import check_shapes_given
from dynident.recordings import Preprocessing, Recording, preprocessing_from_request
from dynident.robot import Robot
from dynident_service.adapters.derived import taken
from dynident_service.adapters.effects import show_choice
from dynident_service.models import identifications as wire
from dynident_service.models.common import EffectChoice as WireEffect


def choices_from_request(
    request: wire.IdentificationRequest, robot: Robot, recordings: Sequence[Recording] = ()
) -> IdentificationChoices:
    """Take the choices of a request; `DynidentError` where they do not fit the robot, exist, or are available.

    The preprocessing is left to the data where there are no recordings to choose it from.
    """
    filters = _preprocessing(request, recordings) if recordings else None
    choices = taken(request, IdentificationChoices, preprocessing=filters)
    check_effects(choices.effects, robot)
    return choices


def check_effects(effects: Sequence[EffectChoice], robot: Robot) -> None:
    """Raise `DynidentError`, which names the field, where an effect cannot sit there or lacks a shape constant."""
    check_shapes_given(effects)
    for index, choice in enumerate(effects):
        pointer = f"/effects/{index}"
        check_shape(choice, pointer)
        joints_of(choice, robot, pointer)


def describe_identification(
    found: Identification, parent_id: str | None, parent: Identification | None = None
) -> wire.IdentificationResult:
    """Describe an identified model for the wire, with the models between it and the one that it was made from."""
    robot = found.model.robot
    return wire.IdentificationResult(
        parameters=[show_parameter(one) for one in found.parameters],
        shape_constants=[show_shape_constant(one) for one in found.shape_constants],
        residual=show_fit(found),
        validation=show_held_out(found),
        converged=found.converged,
        condition_number=finite(found.condition_number),
        n_equations=found.n_equations,
        equations_per_parameter=found.equations_per_parameter,
        effective_rows=[float(value) for value in found.effective_rows],
        inertia_matrix_positive_definite=found.inertia_matrix_positive_definite,
        effects=[show_choice(one) for one in found.choices.effects],
        preprocessing=show_preprocessing(found.preprocessing),
        warnings=list(found.warnings),
        dependence=list(parameter_dependence(found).sentences),
        parent_id=parent_id,
        rungs=[] if parent is None else [_step(one) for one in _between(parent, found)],
        joints=list(robot.joint_names),
        effort_units=[joint.effort_unit for joint in robot.joints],
    )


def show_parameter(one: IdentifiedParameter) -> wire.ParameterView:
    """Show a parameter."""
    low, high = one.interval
    return wire.ParameterView(
        name=one.name,
        value=one.value,
        unit=one.unit,
        standard_deviation=finite(one.standard_deviation),
        relative_standard_deviation=finite(one.relative_standard_deviation),
        well_identified=one.well_identified,
        judgement=one.judgement,
        times_smallest=finite(one.times_smallest),
        effect=one.effect,
        link=one.link,
        grouping=one.grouping,
        shape_parameters=dict(one.shape),
        interval=(finite(low), finite(high)),
        essential=one.essential,
    )


def show_shape_constant(one: ShapeConstant) -> wire.ShapeConstantView:
    """Show a shape constant."""
    return wire.ShapeConstantView(
        effect=one.effect,
        joints=list(one.joints),
        name=one.name,
        unit=one.unit,
        description=one.description,
        value=one.value,
        standard_deviation=finite(one.standard_deviation),
        interval=one.interval,
        judgement=one.judgement,
        note=one.note,
    )


def describe_essential(found: EssentialPath) -> wire.EssentialView:
    """Describe what is left of a model by backward elimination."""
    left = found.identification
    return wire.EssentialView(
        reason=found.reason,
        essential=list(found.essential),
        steps=[
            wire.EssentialStepView(
                name=step.name,
                relative_standard_deviation=finite(step.relative_deviation),
                ratio=finite(step.ratio),
                p_value=step.p_value,
                residual=show_errors(step.fit, step.fit_moving),
                validation=None if step.held_out is None else show_errors(step.held_out, step.held_out_moving),
            )
            for step in found.steps
        ],
        parameters=[show_parameter(one) for one in left.parameters if one.essential],
        residual=show_errors(left.fit, left.fit_moving),
        validation=show_held_out(left),
    )


def describe_correlation(found: ParameterDependence) -> wire.CorrelationView:
    """Describe how estimates depend on one another."""
    return wire.CorrelationView(
        parameters=list(found.names),
        correlation=[numbers(row) for row in found.correlation],
        sentences=list(found.sentences),
    )


def show_fit(found: Identification) -> wire.ErrorsView:
    """Show the errors of a model on the data that it was identified from."""
    return show_errors(found.fit, found.fit_moving, found.noise)


def show_held_out(found: Identification) -> wire.ErrorsView | None:
    """Show the errors of a model on its validation data, where it has any."""
    return None if found.held_out is None else show_errors(found.held_out, found.held_out_moving)


def show_errors(
    errors: Errors, moving: Errors | None = None, sigma: NDArray[np.float64] | None = None
) -> wire.ErrorsView:
    """Show the errors of a model on data: on all rows, and on those where each joint moves."""
    return wire.ErrorsView(
        **show_figures(errors).model_dump(),
        moving=None if moving is None else show_figures(moving),
        sigma=None if sigma is None else numbers(sigma),
    )


def show_figures(errors: Errors) -> wire.ErrorFigures:
    """Show errors on some rows; a joint without any has none."""
    there = errors.counts > 0
    return wire.ErrorFigures(
        rms=numbers(np.where(there, errors.rms, np.nan)),
        relative=numbers(np.where(there, errors.relative, np.nan)),
        relative_total=finite(errors.relative_total) if there.any() else None,
    )


def _between(parent: Identification, found: Identification) -> list[Identification]:
    """The models above `parent` and below `found`, in the order in which they were made."""
    between: list[Identification] = []
    below = found.parent
    while below is not None and below is not parent:
        between.insert(0, below)
        below = below.parent
    return between


def _step(found: Identification) -> wire.StepView:
    return wire.StepView(
        added=[show_choice(one) for one in found.added],
        n_parameters=found.model.n_parameters,
        residual=show_fit(found),
        validation=show_held_out(found),
    )


def show_preprocessing(used: Preprocessing) -> wire.UsedPreprocessing:
    """Show the filters that were used."""
    return wire.UsedPreprocessing(
        position_cutoff=used.position_cutoff,
        torque_cutoff=used.torque_cutoff,
        decimation=used.decimation,
        filter_order=used.filter_order,
        reasons=list(used.reasons),
    )


def effects_in(request: Mapping[str, object]) -> list[WireEffect]:
    """Take the effects out of a stored request."""
    return wire.IdentificationRequest.model_validate(request).effects


def finite(value: float) -> float | None:
    """Give a number, or `None` for what JSON cannot say."""
    return float(value) if math.isfinite(value) else None


def numbers(values: NDArray[np.float64]) -> list[float | None]:
    """Give an array (n,) as JSON numbers."""
    return [finite(value) for value in values.tolist()]


def _preprocessing(request: wire.IdentificationRequest, recordings: Sequence[Recording]) -> Preprocessing:
    asked = request.preprocessing
    motions, _ = parted(recordings)
    return preprocessing_from_request(asked if isinstance(asked, str) else asked.model_dump(), motions)
