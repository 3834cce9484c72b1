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
    found: Identification, parent_id: str | None, parent: Identification | None = None
) -> wire.IdentificationResult:
    """Describe an identified model for the wire, with the models between it and the one that it was made from."""
    return shown(
        wire.IdentificationResult,
        found,
        residual=show_fit(found),
        dependence=parameter_dependence(found).sentences,
        parent_id=parent_id,
        rungs=[] if parent is None else [_step(one) for one in _between(parent, found)],
        effort_units=[joint.effort_unit for joint in found.model.robot.joints],
    )


def describe_essential(found: EssentialPath) -> wire.EssentialView:
    """Describe what is left of a model by backward elimination."""
    left = [one for one in found.identification.parameters if one.essential]
    return shown(wire.EssentialView, found, parameters=left, tables=show_tables(essential_tables(found)))


def identification_tables(found: wire.IdentificationResult) -> Iterator[ReportedTable]:
    """The parameters and the shape constants of a stored result."""
    yield parameter_table("Base parameters", [_parameter(one) for one in found.parameters])
    if found.shape_constants:
        yield shape_table([known(ShapeConstant, one) for one in found.shape_constants], found.joints)


def _parameter(one: wire.ParameterView) -> IdentifiedParameter:
    # Older versions stored no judgement.
    judged = one.judgement or ("determined" if one.well_identified else "uncertain")
    return known(IdentifiedParameter, one, judgement=judged)


def show_fit(found: Identification) -> wire.ErrorsView:
    """Show the errors of a model on the data that it was identified from."""
    return show_errors(found.fit, found.fit_moving, found.noise)


def _between(parent: Identification, found: Identification) -> list[Identification]:
    """The models above `parent` and below `found`, in the order in which they were made."""
    between: list[Identification] = []
    below = found.step.parent
    while below is not None and below is not parent:
        between.insert(0, below)
        below = below.step.parent
    return between


def _step(found: Identification) -> wire.StepView:
    return shown(wire.StepView, found, residual=show_fit(found))


def _preprocessing(request: wire.IdentificationRequest, recordings: Sequence[Recording]) -> Preprocessing | None:
    """The filters that were asked for; None where all of them are left to the data and to what the model explains."""
    asked = request.preprocessing
    given = {} if isinstance(asked, str) else asked.model_dump()
    if all(value == "auto" for value in given.values()):
        return None
    motions, _ = motions_and_friction(recordings)
    return preprocessing_from_request(given, motions)
