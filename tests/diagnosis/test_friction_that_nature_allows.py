"""No friction of a negative size, neither in what is named nor in what it stands beside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.hidden_effects import BAND, NAMES, experiment, on_joint

from dynident.diagnosis.candidates.candidate_pool import build_pool
from dynident.diagnosis.search.physical_plausibility import find_impossibility, is_physically_possible
from dynident.diagnosis.search.search_state import gather_state, score_all
from dynident.regressors.observation_matrix import RegressorInputs

LAWS = {
    "bend": lambda q, v, load: 9.0 * np.sqrt(np.abs(v)) * np.sign(v) - 15.0 * v,
    "square": lambda q, v, load: 9.0 * v * np.abs(v),
}


@pytest.mark.parametrize(
    ("hidden", "effect", "shape", "possible"),
    [
        # A root less a large multiple of the velocity bends like a Stribeck peak, and would drive a fast joint.
        ("bend", "viscous_nonlinear", {"p": 0.5}, False),
        ("square", "viscous_nonlinear", {"p": 2.0}, True),
    ],
)
def test_a_bend_that_needs_negative_viscous_friction_beside_it_is_not_possible(hidden, effect, shape, possible):
    run = experiment(on_joint(0, LAWS[hidden]))
    found = run.identification
    pool = build_pool(found.model, [effect])
    reference = found.estimate.next_reference()
    state = gather_state(found.model, pool, RegressorInputs([run.training], BAND, reference), found.noise)
    own = [
        candidate
        for candidate in pool.candidates
        if candidate.joints == (NAMES[0],) and shape.items() <= dict(candidate.shape).items()
    ]
    best = max(score_all(state, own), key=lambda item: item.drop)
    assert best.drop > 0.1
    assert is_physically_possible(state, best) == possible


def test_an_error_of_a_zero_position_that_standing_feet_do_not_allow_is_not_possible():
    run = experiment(on_joint(1, lambda q, v, load: 9.0 * np.sin(2.0 * q)))
    found = run.identification
    pool = build_pool(found.model, ["encoder_zero_error"])
    reference = found.estimate.next_reference()
    # With a tenth of the noise the errors that the torques ask for are certain.
    inputs, noise = RegressorInputs([run.training], BAND, reference), 0.1 * found.noise
    state = gather_state(found.model, pool, inputs, noise)
    limits = {(candidate.effect, candidate.joints[0]): 1e-6 for candidate in pool.candidates}
    bounded = gather_state(found.model, replace(pool, largest=limits), inputs, noise)
    scored = [item for item in score_all(state, pool.candidates) if find_impossibility(state, item) is None]
    reasons = [str(reason.values) for item in scored if (reason := find_impossibility(bounded, item)) is not None]
    assert reasons
    assert all("larger than standing feet allow (1e-06 rad)" in reason for reason in reasons)
