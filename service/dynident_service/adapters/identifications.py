"""Identifications between the contract and the science."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from dynident.identification import Identification, IdentificationChoices, IdentifiedParameter
from dynident.identification.equations.data import motions_and_friction
from dynident.identification.shapes.shape_constants import ShapeConstant
from dynident.identification.shapes.shapes import check_choices
from dynident.identification.study.dependence import parameter_dependence
from dynident.identification.study.essential import EssentialPath
from dynident.recordings import Preprocessing, Recording, preprocessing_from_request
from dynident.reports.parameter_tables import essential_tables, parameter_table, shape_table
from dynident.reports.tables import ReportedTable
from dynident.robot import Robot
from dynident_service.adapters.answers import known, show_errors, shown
from dynident_service.adapters.derived import taken
from dynident_service.adapters.tables import show_tables
from dynident_service.models import identifications as wire


def choices_from_request(
    request: wire.IdentificationRequest, robot: Robot, recordings: Sequence[Recording] = ()
) -> IdentificationChoices:
    """Take the choices of a request; `DynidentError` where they do not fit the robot, exist, or are available.

    The preprocessing is left to the data where there are no recordings to choose it from.
    """
    filters = _preprocessing(request, recordings) if recordings else None
    choices = taken(request, IdentificationChoices, preprocessing=filters)
    check_choices(choices.effects, robot)
    return choices


def describe_identification(
    identification: Identification, parent_id: str | None, parent: Identification | None = None
) -> wire.IdentificationResult:
    """Describe an identified model for the wire, with the models between it and the one that it was made from."""
    return shown(
        wire.IdentificationResult,
        identification,
        residual=show_fit(identification),
        dependence=parameter_dependence(identification).sentences,
        parent_id=parent_id,
        rungs=[] if parent is None else [_step(step) for step in _between(parent, identification)],
        effort_units=[joint.effort_unit for joint in identification.model.robot.joints],
    )


def describe_essential(path: EssentialPath) -> wire.EssentialView:
    """Describe what is left of a model by backward elimination."""
    essential_parameters = [parameter for parameter in path.identification.parameters if parameter.essential]
    return shown(wire.EssentialView, path, parameters=essential_parameters, tables=show_tables(essential_tables(path)))


def identification_tables(result: wire.IdentificationResult) -> Iterator[ReportedTable]:
    """The parameters and the shape constants of a stored result."""
    yield parameter_table("Base parameters", [_parameter(parameter) for parameter in result.parameters])
    if result.shape_constants:
        yield shape_table([known(ShapeConstant, constant) for constant in result.shape_constants], result.joints)


def _parameter(parameter: wire.ParameterView) -> IdentifiedParameter:
    # Older versions stored no judgement.
    judgement = parameter.judgement or ("determined" if parameter.well_identified else "uncertain")
    return known(IdentifiedParameter, parameter, judgement=judgement)


def show_fit(identification: Identification) -> wire.ErrorsView:
    """Show the errors of a model on the data that it was identified from."""
    return show_errors(identification.fit, identification.fit_moving, identification.noise)


def _between(parent: Identification, identification: Identification) -> list[Identification]:
    """The models above `parent` and below `found`, in the order in which they were made."""
    between: list[Identification] = []
    ancestor = identification.step.parent
    while ancestor is not None and ancestor is not parent:
        between.insert(0, ancestor)
        ancestor = ancestor.step.parent
    return between


def _step(identification: Identification) -> wire.StepView:
    return shown(wire.StepView, identification, residual=show_fit(identification))


def _preprocessing(request: wire.IdentificationRequest, recordings: Sequence[Recording]) -> Preprocessing | None:
    """The filters that were asked for; None where all of them are left to the data and to what the model explains."""
    stated_filters = request.preprocessing
    filter_values = {} if isinstance(stated_filters, str) else stated_filters.model_dump()
    if all(value == "auto" for value in filter_values.values()):
        return None
    motions, _ = motions_and_friction(recordings)
    return preprocessing_from_request(filter_values, motions)
