"""Every effect of the catalogue makes equations of the filtered, energy and power models that its torque satisfies."""

from __future__ import annotations

import numpy as np
import pytest
from support.oracles import arm, fourier_motion

from dynident.effects import CATALOGUE, EffectChoice, ReferenceParameters
from dynident.estimation import compute_errors
from dynident.recordings import FurtherColumns, Preprocessing, Recording, filtered_blocks, recording_from_arrays
from dynident.regressors.dynamic_model_rows import SampleFunction
from dynident.regressors.equation_forms import build_filtered_form, build_power_form
from dynident.regressors.filtered_energy_power_rows import (
    filter_with_pole,
    integrate_over_intervals,
    reduce_form,
    stream_equations,
)
from dynident.regressors.model_structure import Model, build_model
from dynident.regressors.observation_matrix import RegressorInputs

ROBOT = arm("ur10")
RATE = 500.0
PREPROCESSING = Preprocessing(None, 5.0, 20)
MOTION = fourier_motion(ROBOT, 20.0, RATE, 2, base_frequency=0.1, amplitude=2.0)
HEAT = 25.0 + np.cumsum(np.abs(MOTION.dq), axis=0) / RATE
REFERENCE = ReferenceParameters(ROBOT.inertias, *np.ones((4, 6)))
EFFECTS = [name for name in sorted(CATALOGUE) if CATALOGUE[name].applicable(ROBOT)]


def recorded(tau: np.ndarray) -> Recording:
    # Two runs of one motion behind each other, so that an effect in one of them is seen to come and go.
    half = len(MOTION.t) // 2
    label = (np.arange(len(MOTION.t)) >= half).astype(np.int64)
    names = {"joint_names": ROBOT.joint_names, "name": "run"}
    return recording_from_arrays(
        MOTION.t, MOTION.q, tau, further=FurtherColumns(temperature=HEAT), segment=label, **names
    )


def with_torque_of(model: Model, values: np.ndarray) -> Recording:
    """The motion with the torque that the dynamic model gives at its samples."""
    silent = recorded(np.zeros_like(MOTION.q))
    entries = SampleFunction(model.observation, REFERENCE, silent)
    torques = [
        model.observation.compute_torque(entries(block), values) for block in filtered_blocks(silent, PREPROCESSING)
    ]
    return recorded(np.concatenate(torques))


@pytest.mark.sweep
@pytest.mark.parametrize("name", EFFECTS)
def test_the_torque_of_an_effect_satisfies_the_equations_of_every_model(name):
    runs = ("run#1",) if CATALOGUE[name].in_some_runs else ()
    model = build_model(ROBOT, [EffectChoice(name, runs=runs)])
    assert model.n_parameters
    values = np.random.default_rng(0).uniform(0.5, 2.0, model.n_parameters)
    inputs = RegressorInputs([with_torque_of(model, values)], PREPROCESSING, REFERENCE)
    power = build_power_form(ROBOT, model.kept, model.signals)
    reductions = {
        "filtered": reduce_form(build_filtered_form(ROBOT, model.kept, model.signals), filter_with_pole(30.0), inputs),
        "energy": reduce_form(power, integrate_over_intervals(0.5), inputs),
        "power": reduce_form(power, stream_equations, inputs),
    }
    for which, reduction in reductions.items():
        assert reduction.n_rows > 100
        assert compute_errors(reduction, values).measured.sum() > 0
        assert compute_errors(reduction, values).relative_total < 1e-3, which
