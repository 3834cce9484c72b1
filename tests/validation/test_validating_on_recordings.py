"""Direct and cross validation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.measured_arm import with_values

from dynident.errors import DynidentError
from dynident.recordings import low_pass
from dynident.validation import validate_cross, validate_direct


def test_the_direct_error_is_that_of_the_fit(identified, training):
    found = validate_direct(identified, [training])
    assert found.total.relative == pytest.approx(identified.fit.relative)
    assert found.judged.verdict == "pass"
    assert found.recordings[0].name == "training"


def test_the_cross_error_is_that_of_data_that_no_parameter_saw(identified, unseen):
    found = validate_cross(identified, [unseen])
    assert found.total.relative == pytest.approx(identified.held_out.relative)
    assert found.judged.verdict == "pass"
    assert "15\u202f%" in found.judged.reason


def test_several_recordings_count_by_their_squares(identified, training, unseen):
    found = validate_cross(identified, [training, unseen])
    squares = sum(one.errors.squares for one in found.recordings)
    measured = sum(one.errors.measured for one in found.recordings)
    assert found.total.relative == pytest.approx(np.sqrt(squares / measured))


def test_a_model_that_misses_the_limit_fails_and_its_worst_joint_is_named(identified, unseen):
    found = validate_cross(identified, [unseen], limit=0.005)
    worst = identified.model.robot.joint_names[int(np.argmax(found.total.relative))]
    assert found.judged.verdict == "fail"
    assert worst in found.judged.reason


def test_a_joint_where_predicting_nothing_is_as_good_fails(identified, unseen):
    values = identified.values.copy()
    of_last = [k for k, column in enumerate(identified.model.kept) if column.link == "wrist_3_joint"]
    values[of_last] *= -3.0
    spoilt = with_values(identified, values)
    found = validate_cross(spoilt, [unseen], limit=0.9)
    assert found.judged.verdict == "fail"
    assert "wrist_3_joint" in found.judged.reason


def test_a_much_larger_error_than_in_the_fit_fails_even_within_the_limit(identified, unseen):
    flattered = replace(identified)
    # Computed from the data when it is first asked for.
    flattered.__dict__["fit_moving"] = replace(identified.fit_moving, squares=identified.fit_moving.squares / 9.0)
    found = validate_cross(flattered, [unseen])
    assert found.judged.verdict == "fail"
    assert "does not determine" in found.judged.reason


def test_windows_without_samples_end_in_not_evaluated(identified, unseen):
    taps = len(low_pass(100.0, identified.preprocessing.torque_cutoff))
    short = unseen.with_windows(((1.0, 1.0 + 0.5 * taps / 100.0),))
    assert validate_direct(identified, [short]).judged.verdict == "not_evaluated"


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan")])
def test_a_limit_that_is_no_error_is_refused(identified, unseen, limit):
    with pytest.raises(DynidentError) as refused:
        validate_cross(identified, [unseen], limit=limit)
    assert refused.value.pointer == "/limit"


def test_no_recording_is_refused(identified):
    with pytest.raises(DynidentError, match="recording"):
        validate_direct(identified, [])


def test_a_joint_that_is_mostly_unexplained_fails_even_within_the_limit(identified, unseen):
    values = identified.values.copy()
    of_last = [k for k, column in enumerate(identified.model.kept) if column.link == "wrist_3_joint"]
    values[of_last] *= 0.3
    spoilt = with_values(identified, values)
    found = validate_cross(spoilt, [unseen], limit=0.9)
    assert 0.5 < found.total_moving.relative[5] < 1.0
    assert found.judged.verdict == "fail"
    assert "wrist_3_joint" in found.judged.reason
