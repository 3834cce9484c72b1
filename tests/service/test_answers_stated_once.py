"""An answer is read from the result of the science by the names of its fields, and makes the same result again."""

from __future__ import annotations

import math
from dataclasses import fields
from types import SimpleNamespace

import numpy as np
import pytest

from dynident.advice import AdvisedDiagnosis, NextExperiment, Separation
from dynident.diagnosis.diagnosis_result import Adequacy, Change, ChangedValue, RankedEffect
from dynident.effects import EffectChoice
from dynident.estimation import Errors
from dynident.identification.loads.payload_weighing import PayloadVerdict
from dynident.identification.thresholds import ValidationOutcome
from dynident.recordings import Preprocessing
from dynident.schema.fields import resolve_hint
from dynident.validation.direct_and_cross_validation import TorqueValidation
from dynident.validation.filter_choice import FilterTrial
from dynident.validation.known_load_validation import PayloadValidation
from dynident_service.diagnoses import wire_types as diagnoses
from dynident_service.shared.field_by_field import from_view, to_view
from dynident_service.validations import wire_types as validations

CHOICE = EffectChoice("stribeck", ("a",), (("vs", 0.1),), ("run 1",))


def test_what_is_no_number_is_null_and_comes_back() -> None:
    found = RankedEffect(1, CHOICE, math.nan, 0.1, 0.2, 3.0, 0.01, True, "plain", ("dahl",), 0.5)
    told = to_view(diagnoses.Candidate, found)
    assert (told.effect, told.joints, told.shape_parameters, told.runs) == ("stribeck", ["a"], {"vs": 0.1}, ["run 1"])
    assert told.error_before is None
    again = from_view(RankedEffect, told)
    assert again.choice == CHOICE
    assert math.isnan(again.error_before)
    assert again.equivalent == ("dahl",)


def test_what_nothing_determines_comes_back_as_infinite() -> None:
    found = Separation("Fs", "N m", 0.5, math.inf, None)
    assert to_view(diagnoses.Separation, found).standard_deviation is None
    assert from_view(Separation, to_view(diagnoses.Separation, found)) == found
    value = ChangedValue("m", 1.0, "kg", (-math.inf, 2.0))
    assert from_view(ChangedValue, to_view(diagnoses.ChangedValue, value)) == value


def test_a_field_that_is_inherited_has_the_type_of_where_it_is_stated() -> None:
    hints = {one.name: resolve_hint(AdvisedDiagnosis, one) for one in fields(AdvisedDiagnosis)}
    assert hints["verdict"] == Adequacy
    assert hints["next_experiment"] == NextExperiment | None


def test_a_change_is_told_with_the_number_that_says_how_large_it_is() -> None:
    value = ChangedValue("m", 1.0, "kg", (0.0, 2.0))
    change = Change(CHOICE, value, (), 0.2, "plain")
    told = to_view(diagnoses.Change, change, **dict(to_view(diagnoses.ChangedValue, value)))
    assert from_view(Change, told, main=from_view(ChangedValue, told)) == change


def test_errors_have_those_of_moving_rows_beside_them_and_none_where_a_joint_has_no_row() -> None:
    errors = Errors(np.array([1.0, 0.0]), np.array([4.0, 0.0]), np.array([4.0, 0.0]))
    found = TorqueValidation((), errors, errors, 0.1, ValidationOutcome("pass", "It is small."))
    told = to_view(validations.ValidationResult, found, kind="cross")
    assert told.verdict == "pass"
    assert told.total is not None
    assert told.total.moving is not None
    assert told.total.moving.relative == [pytest.approx(0.5), None]


def test_empty_text_and_what_is_missing_on_the_way_have_the_null_or_the_default_of_their_field() -> None:
    trial = FilterTrial(Preprocessing(None, None), None, None, worst="", worst_bias=None)
    told = to_view(validations.FilterTrialView, trial)
    assert (told.worst, told.problem) == (None, None)
    estimate = SimpleNamespace(mass=2.0)
    load = PayloadVerdict(True, "clear", 2.0, (1.0, 3.0), estimate, None)  # type: ignore[arg-type]
    payload = PayloadValidation("run", 2.0, load, None, ValidationOutcome("pass", "It agrees."))
    weighed = to_view(validations.PayloadView, payload, measurement_id="m")
    assert (weighed.gains, weighed.friction_shared, weighed.friction_apart) == ([], 2.0, None)
