"""Choices of an identification from bodies; views and tables of models, verdicts and ladders; exported files.

Holds how long the header with the notes on an exported file may be.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from dynident.errors import DynidentError, Note
from dynident.export import ExportedFile, ExportFormat, export_model, model_to_document
from dynident.identification import Identification, IdentificationChoices, IdentifiedParameter
from dynident.identification.equations.reduced_recordings import split_friction_tests
from dynident.identification.identified_models.correlated_and_essential_parameters import (
    EssentialPath,
    parameter_dependence,
)
from dynident.identification.identified_models.held_out_gain import find_best_of_errors, list_confirming_rows
from dynident.identification.shape_constant_intervals import ShapeConstant
from dynident.presentation.labels import CONDITION_MEANING
from dynident.presentation.ladder_tables import (
    Step,
    build_ladder_joint_table,
    build_ladder_table,
    build_two_ladders_table,
    describe_last_step,
)
from dynident.presentation.model_tables import (
    ErrorKind,
    build_error_table,
    build_essential_tables,
    build_parameter_table,
    build_quality_table,
    build_shape_table,
)
from dynident.presentation.tables import ReportedTable
from dynident.presentation.validation_and_verdict_tables import build_verdict_tables
from dynident.recordings import Recording, preprocessing_from_request
from dynident.recordings.metadata_revisions import adapt_revision
from dynident.verdict import ModelVerdict, Stop
from dynident.verdict.model_verdict import TESTS
from dynident_service.identifications import wire_types as wire
from dynident_service.identifications.wire_types import (
    IdentificationView,
    LadderStep,
    LadderStepDifference,
    Lineage,
    StepSentence,
)
from dynident_service.measurements.adapters import show_revision, to_recording_metadata
from dynident_service.measurements.wire_types import MeasurementMetadata
from dynident_service.problems import show_remedies
from dynident_service.shared.field_by_field import (
    from_view,
    from_wire_choices,
    show_errors,
    show_tables,
    to_request,
    to_view,
)
from dynident_service.shared.wire_types import EffectChoice, ErrorFigures, ErrorsView

if TYPE_CHECKING:
    from fastapi import Response


def to_choices(request: wire.IdentificationRequest, recordings: Sequence[Recording] = ()) -> IdentificationChoices:
    """Build the choices of an identification from a body.

    Filters are chosen from the recordings; without recordings they are left to the identification.
    """
    stated = request.preprocessing
    values = {} if isinstance(stated, str) else stated.model_dump()
    filters = None
    # The identification chooses the filters of its own data where all are open, and then also says why.
    if recordings and any(value != "auto" for value in values.values()):
        # Tests of friction at constant velocity say nothing about the bandwidth of the motion.
        filters = preprocessing_from_request(values, split_friction_tests(recordings)[0])
    return to_request(request, IdentificationChoices, preprocessing=filters)


def describe_identification(
    identification: Identification, parent_id: str | None, parent: Identification | None = None
) -> wire.IdentificationResult:
    """Build the view of an identified model; with its parent model it has the steps between the two."""
    return to_view(
        wire.IdentificationResult,
        identification,
        residual=show_fit(identification),
        confirmed_by=list_confirming_rows(identification),
        dependence=parameter_dependence(identification).sentences,
        condition_meaning=CONDITION_MEANING,
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


def build_identification_tables(
    result: wire.IdentificationResult, floor: Sequence[float | None] | None = None
) -> Iterator[ReportedTable]:
    """Yield the tables of parameters, shape constants, quality, and errors (with the noise floor where it is known)."""
    kinds = [
        ErrorKind(name, errors.moving or errors, errors)
        for name, errors in (("fit", result.residual), ("held out", result.validation))
        if errors is not None
    ]
    yield build_parameter_table("Base parameters", [_restore_parameter(parameter) for parameter in result.parameters])
    if result.shape_constants:
        yield build_shape_table(
            [from_view(ShapeConstant, constant) for constant in result.shape_constants], result.joints
        )
    yield build_quality_table(
        select_judged(result.residual).relative_total,
        None if result.validation is None else select_judged(result.validation).relative_total,
        [parameter.well_identified for parameter in result.parameters],
        result.equilibrated_condition_number or result.condition_number,
        result.n_equations,
        result.equations_per_parameter,
    )
    yield build_error_table(kinds, result.joints, result.effort_units, floor)


def _restore_parameter(parameter: wire.ParameterView) -> IdentifiedParameter:
    # Models that older versions stored have no judgement; it follows from what they have.
    judgement = parameter.judgement or ("determined" if parameter.well_identified else "uncertain")
    return from_view(IdentifiedParameter, parameter, judgement=judgement)


def _list_steps_between(parent: Identification, identification: Identification) -> list[Identification]:
    """Return the models between `parent` and `identification`, both excluded, in the order they were made."""
    between: list[Identification] = []
    ancestor = identification.step.parent
    while ancestor is not None and ancestor is not parent:
        between.insert(0, ancestor)
        ancestor = ancestor.step.parent
    return between


def _show_step(identification: Identification) -> wire.StepView:
    return to_view(
        wire.StepView,
        identification,
        residual=show_fit(identification),
        confirmed_by=list_confirming_rows(identification),
    )


@dataclass(frozen=True, eq=False)
class OpenedMeasurement:
    """A stored recording that a model was identified from or held against."""

    id: str
    recording: Recording
    metadata: MeasurementMetadata


def show_verdict(verdict: ModelVerdict, measurements: Sequence[OpenedMeasurement] = ()) -> wire.VerdictView:
    """Build the view of a verdict; recordings are named by the ids of the measurements that are given."""
    by_name = {measurement.recording.name: measurement for measurement in measurements}
    stop = None if verdict.stop is None else _show_stop(verdict.stop, by_name.get(verdict.stop.recording or ""))
    common = [
        to_view(
            wire.CommonView,
            overlap,
            held_out_id=_measurement_id(by_name, overlap.held_out),
            fitted_id=_measurement_id(by_name, overlap.fitted),
            detail=str(overlap),
        )
        for overlap in verdict.common
    ]
    uses = [
        to_view(
            wire.UseView,
            use,
            fit=None if use.state == "not_judged" else use.fit,
            test=TESTS[use.use],
            values=verdict.get_values(use.use),
        )
        for use in verdict.uses
    ]
    quoted = [remedy for use in verdict.uses if isinstance(use.reason, Note) for remedy in use.reason.remedies]
    return to_view(
        wire.VerdictView,
        verdict,
        uses=uses,
        stop=stop,
        common=common,
        remedies=show_remedies(quoted),
        tables=show_tables(build_verdict_tables(verdict)),
    )


def _measurement_id(measurements: Mapping[str, OpenedMeasurement], name: str) -> str:
    return measurements[name].id if name in measurements else name


def _show_stop(stop: Stop, measurement: OpenedMeasurement | None) -> wire.StopView:
    cure = stop.apply
    if cure is not None and measurement is not None:
        # The cure refers to the recording as it was read. The revision has to change what was stated about the file.
        cure = adapt_revision(cure, to_recording_metadata(measurement.metadata), measurement.recording.joint_names)
    return wire.StopView(
        cause=stop.cause,
        measurement_id=stop.recording if measurement is None else measurement.id,
        apply=None if cure is None else show_revision(cure),
        remedies=show_remedies(stop.remedies),
    )


NOTES_HEADER = "Dynident-Notes"
# Many proxies refuse headers above 4 or 8 kB in total. Files of text have all notes at their head; JSON has none.
_LONGEST = 3000


def export_file(model: Identification, format: ExportFormat, nearest: bool, shown: dict[str, object]) -> ExportedFile:
    """Export a model, or its nearest feasible parameters; the format "json" includes what the service shows of it.

    Raises `DynidentError`, whose pointer is the query's parameter, where the format cannot hold the model.
    """
    try:
        file = export_model(model, format, nearest=nearest)
    except DynidentError as error:
        raise DynidentError(error.detail, pointer=error.pointer.removeprefix("/"), title=error.title) from error
    if format != "json":
        return file
    # What the service shows stands beside the model, so that `model_from_json` reads the file, too.
    content = json.dumps({**shown, "model": model_to_document(model)}, indent=1, allow_nan=False)
    return replace(file, content=content.encode())


def build_file_response(file: ExportedFile) -> Response:
    """Build the response with a file to be saved; its notes are a JSON list of sentences in a header."""
    # The command line uses this module, too, and should not load what only the service needs.
    from fastapi import Response

    headers = {"Content-Disposition": f'attachment; filename="{file.name}"'}
    if file.notes:
        headers[NOTES_HEADER] = _shorten_notes(file.notes)
    if file.held_out_error is not None:
        headers["X-Held-Out-Error"] = f"{file.held_out_error:.6g}"
    return Response(file.content, media_type=file.media_type, headers=headers)


def _shorten_notes(notes: Sequence[str]) -> str:
    """Return as many notes as a header may hold, as JSON in ASCII."""
    # Whole sentences: as many from the front as fit.
    for count in range(len(notes), 0, -1):
        shortened = list(notes[:count])
        if count < len(notes):
            shortened.append(f"{len(notes) - count} more in the file")
        if len(text := json.dumps(shortened)) <= _LONGEST:
            return text
    return json.dumps([f"{len(notes)} notes in the file"])


T = TypeVar("T", int, float)


def build_steps_of_views(views: Sequence[IdentificationView]) -> list[LadderStep]:
    """Build the steps of a ladder of stored models, the first one first, with the intermediate ones of extensions."""
    steps: list[LadderStep] = []
    for view in views:
        # An extension by several effects has made models on its way, which are steps as well.
        steps += _build_intermediate_steps(view, steps[-1] if steps else None)
        steps.append(_build_own_step(view, steps[-1] if steps else None))
    return mark_best_step(steps)


def mark_best_step(steps: Sequence[LadderStep]) -> list[LadderStep]:
    """Return a ladder with its best step marked, and the later steps that increase the validation error."""
    totals = [None if step.validation is None else select_judged(step.validation).relative_total for step in steps]
    known_totals = [total for total in totals if total is not None]
    preferred = [bool(step.confirmed_by or step.removed) for step in steps]
    # Only where every step has a validation error: a step without one could be the best.
    marks = find_best_of_errors(known_totals, preferred) if len(known_totals) == len(steps) else None
    if marks is None:
        return list(steps)
    return [
        step.model_copy(update={"best": k == marks.best, "rises": k in marks.rises}) for k, step in enumerate(steps)
    ]


def select_judged(errors: ErrorsView) -> ErrorFigures:
    """Return the errors that models are compared by: of moving rows; where none are known, of all rows."""
    return errors if errors.moving is None or errors.moving.relative_total is None else errors.moving


def to_step(ladder_step: LadderStep, fit: ErrorsView) -> Step:
    """Convert a stored step of a ladder, whose errors of the fit are known, for its tables."""
    held_out = ladder_step.validation
    return Step(
        from_wire_choices(ladder_step.added),
        from_wire_choices(ladder_step.removed),
        ladder_step.n_parameters,
        select_judged(fit),
        None if held_out is None else select_judged(held_out),
        None if held_out is None else held_out.relative_total,
        ladder_step.confirmed_by or (),
    )


def add_ladder_tables(lineage: Lineage, joints: Sequence[str], parent_id: str | None = None) -> Lineage:
    """Return ladders with their steps in words and their tables, as far as their models are identified.

    The last step is described against the model `parent_id`, since an extension by several effects has a step for
    each; by default against the step before.
    """
    ladders = [
        [(step, to_step(step, step.residual)) for step in items if step.residual is not None]
        for items in (lineage.items, lineage.against or [])
    ]
    for ladder_step, step in (pair for ladder in ladders for pair in ladder):
        ladder_step.change = step.describe_change(joints)
    own, other = ([step for _, step in ladder] for ladder in ladders)
    if not own:
        return lineage
    tables = [build_ladder_table(own, joints), build_ladder_joint_table(own, joints)]
    if other:
        tables.append(build_two_ladders_table(("this ladder", "the other"), (own, other), joints))
    ids = [ladder_step.id for ladder_step, _ in ladders[0]]
    sentence = None
    if len(own) > 1:
        sentence = describe_last_step(own, joints, ids.index(parent_id) if parent_id in ids[:-1] else None)
    last_step = None if sentence is None else to_view(StepSentence, sentence)
    return lineage.model_copy(update={"tables": show_tables(tables), "last_step": last_step})


def _build_intermediate_steps(view: IdentificationView, below: LadderStep | None) -> list[LadderStep]:
    """Build the steps between a model and its parent; an extension by several effects has one for each."""
    steps: list[LadderStep] = []
    for number, step in enumerate(view.result.rungs if view.result is not None else [], start=1):
        under = steps[-1] if steps else below
        ladder_step = LadderStep(
            **dict(step),
            id=f"{view.id}/{number}",
            part_of=view.id,
            name=view.name,
            parent_id=None if under is None else under.id,
            status=view.status,
            removed=[],
            effects=[*([] if under is None else under.effects), *step.added],
        )
        steps.append(ladder_step)
    return steps


def _build_own_step(view: IdentificationView, below: LadderStep | None) -> LadderStep:
    result = view.result
    effects = view.request.effects if result is None else result.effects
    return LadderStep(
        id=view.id,
        name=view.name,
        parent_id=view.parent_id if below is None else below.id,
        status=view.status,
        added=_last_added(view, effects, below),
        removed=view.removed,
        effects=effects,
        n_parameters=None if result is None else len(result.parameters),
        residual=None if result is None else result.residual,
        validation=None if result is None else result.validation,
        confirmed_by=None if result is None else result.confirmed_by,
    )


def _last_added(view: IdentificationView, effects: list[EffectChoice], below: LadderStep | None) -> list[EffectChoice]:
    """Return what the last step added, with the shape constants that were found."""
    # The steps below have the first of the requested effects; the rest of the list is new at this step.
    if not view.added or view.result is None or below is None:
        return view.added
    return effects[len(below.effects) :]


def compare_ladders(own: Sequence[LadderStep], other: Sequence[LadderStep], same_data: bool) -> Lineage:
    """Compare two ladders step by step; `same_data` says whether all their models rest on the same recordings."""
    # Ladders of one robot may begin with the same models: the last pair of equal ids is where they part.
    shared = [a.id for a, b in zip(own, other, strict=False) if a.id == b.id]
    return Lineage(
        items=list(own),
        against=list(other),
        common_ancestor=shared[-1] if shared else None,
        differences=[_show_difference(k, a, b) for k, (a, b) in enumerate(zip_longest(own, other), start=1)],
        same_data=same_data,
    )


def _show_difference(number: int, own: LadderStep | None, other: LadderStep | None) -> LadderStepDifference:
    differences: dict[str, Any] = {}
    for kind in ("residual", "validation"):
        shown = [getattr(step, kind, None) for step in (own, other)]
        moving = [getattr(errors, "moving", None) for errors in shown]
        for name, (a, b) in ((kind, shown), (f"{kind}_moving", moving)):
            if a is None or b is None:
                differences |= {name: None, f"{name}_total": None}
                continue
            differences[name] = [_subtract(*both) for both in zip(a.relative, b.relative, strict=True)]
            differences[f"{name}_total"] = _subtract(a.relative_total, b.relative_total)
    return LadderStepDifference(
        rung=number,
        id=own.id if own else None,
        against_id=other.id if other else None,
        n_parameters=_subtract(own.n_parameters if own else None, other.n_parameters if other else None),
        **differences,
    )


def _subtract(a: T | None, b: T | None) -> T | None:
    return None if a is None or b is None else a - b


def build_steps(
    identification: Identification, name: str, other_ladder: tuple[Identification, str] | None = None
) -> list[LadderStep]:
    """Build the steps of a ladder from a model in a file; the models before it are called name/1, name/2, ….

    Steps at which another ladder has the same model take that ladder's ids, so that `compare_ladders` sees what
    they share.
    """
    models = list(identification.ladder())
    ids = _step_ids(name, len(models))
    if other_ladder is not None:
        others = list(other_ladder[0].ladder())
        for k, (model, other) in enumerate(zip(models, others, strict=False)):
            # Models in files have no ids: they are the same if their choices and all their values are.
            if model.choices != other.choices or not np.array_equal(model.values, other.values):
                break
            ids[k] = _step_ids(other_ladder[1], len(others))[k]
    steps = [
        to_view(
            LadderStep,
            model,
            id=identifier,
            name=identifier,
            parent_id=ids[k - 1] if k else None,
            status="succeeded",
            residual=show_fit(model),
            confirmed_by=list_confirming_rows(model),
        )
        for k, (identifier, model) in enumerate(zip(ids, models, strict=True))
    ]
    return mark_best_step(steps)


def _step_ids(name: str, count: int) -> list[str]:
    return [*(f"{name}/{k}" for k in range(1, count)), name]


def show_fit(identification: Identification) -> ErrorsView:
    """Build the view of the errors on the data that a model was identified from."""
    return show_errors(identification.fit, identification.fit_moving, identification.noise)
