"""Identifications: choices from request bodies, views and tables of identified models."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from dynident.identification import Identification, IdentificationChoices, IdentifiedParameter
from dynident.identification.equations.reduce_data import split_friction_tests
from dynident.identification.shapes.shape_constants import ShapeConstant
from dynident.identification.shapes.shape_search import check_choices
from dynident.identification.study.dependence import parameter_dependence
from dynident.identification.study.essential_parameters import EssentialPath
from dynident.recordings import Preprocessing, Recording, preprocessing_from_request
from dynident.reports.parameter_tables import build_essential_tables, build_parameter_table, build_shape_table
from dynident.reports.report_tables import ReportedTable
from dynident.robot import Robot
from dynident_service.adapters.requests import to_request
from dynident_service.adapters.serialise import from_view, show_errors, to_view
from dynident_service.adapters.tables import show_tables
from dynident_service.models import identifications as wire


def to_choices(
    request: wire.IdentificationRequest, robot: Robot, recordings: Sequence[Recording] = ()
) -> IdentificationChoices:
    """Build the choices of an identification from a body.

    Parameters
    ----------
    request : IdentificationRequest
        The body.
    robot : Robot
        The robot.
    recordings : sequence of Recording
        Recordings that the filters are chosen from. Without them, the filters are left to the identification.

    Returns
    -------
    IdentificationChoices
        The choices.

    Raises
    ------
    DynidentError
        Where a choice does not exist, is not available, or does not fit the robot.
    """
    filters = _choose_preprocessing(request, recordings) if recordings else None
    choices = to_request(request, IdentificationChoices, preprocessing=filters)
    check_choices(choices.effects, robot)
    return choices


def describe_identification(
    identification: Identification, parent_id: str | None, parent: Identification | None = None
) -> wire.IdentificationResult:
    """Build the view of an identified model.

    Parameters
    ----------
    identification : Identification
        The model.
    parent_id : str, optional
        Id of the model that it was made from.
    parent : Identification, optional
        That model; with it the view has the steps between the two.

    Returns
    -------
    IdentificationResult
        The view.
    """
    return to_view(
        wire.IdentificationResult,
        identification,
        residual=show_fit(identification),
        dependence=parameter_dependence(identification).sentences,
        parent_id=parent_id,
        rungs=[] if parent is None else [_show_step(step) for step in _list_steps_between(parent, identification)],
        effort_units=[joint.effort_unit for joint in identification.model.robot.joints],
    )


def describe_essential(path: EssentialPath) -> wire.EssentialView:
    """Build the view of a backward elimination with the essential parameters."""
    essential_parameters = [parameter for parameter in path.identification.parameters if parameter.essential]
    return to_view(
        wire.EssentialView, path, parameters=essential_parameters, tables=show_tables(build_essential_tables(path))
    )


def build_identification_tables(result: wire.IdentificationResult) -> Iterator[ReportedTable]:
    """Yield the tables of parameters and of shape constants of a stored result."""
    yield build_parameter_table("Base parameters", [_restore_parameter(parameter) for parameter in result.parameters])
    if result.shape_constants:
        yield build_shape_table(
            [from_view(ShapeConstant, constant) for constant in result.shape_constants], result.joints
        )


def _restore_parameter(parameter: wire.ParameterView) -> IdentifiedParameter:
    # Models that older versions stored have no judgement; it follows from what they have.
    judgement = parameter.judgement or ("determined" if parameter.well_identified else "uncertain")
    return from_view(IdentifiedParameter, parameter, judgement=judgement)


def show_fit(identification: Identification) -> wire.ErrorsView:
    """Build the view of the errors on the data that a model was identified from."""
    return show_errors(identification.fit, identification.fit_moving, identification.noise)


def _list_steps_between(parent: Identification, identification: Identification) -> list[Identification]:
    """Return the models between `parent` and `identification`, both excluded, in the order they were made."""
    between: list[Identification] = []
    ancestor = identification.step.parent
    while ancestor is not None and ancestor is not parent:
        between.insert(0, ancestor)
        ancestor = ancestor.step.parent
    return between


def _show_step(identification: Identification) -> wire.StepView:
    return to_view(wire.StepView, identification, residual=show_fit(identification))


def _choose_preprocessing(request: wire.IdentificationRequest, recordings: Sequence[Recording]) -> Preprocessing | None:
    """Return the filters that a body states; None where all of them are chosen by the identification."""
    stated_filters = request.preprocessing
    filter_values = {} if isinstance(stated_filters, str) else stated_filters.model_dump()
    # The identification chooses the filters of its own data, and then also says why.
    if all(value == "auto" for value in filter_values.values()):
        return None
    # Tests of friction at constant velocity say nothing about the bandwidth of the motion.
    motions, _ = split_friction_tests(recordings)
    return preprocessing_from_request(filter_values, motions)
