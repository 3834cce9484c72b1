"""A load that some runs carry, judged on held-out runs of which nobody has said whether they carry it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.identification import Identification, IdentificationChoices, extend, identify
from dynident.recordings import Preprocessing, Recording

EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous"))
CHOICES = IdentificationChoices(EFFECTS, preprocessing=Preprocessing(15.0, 15.0, 5))
LOAD = np.array([0.06, 0, 0, 0.06, 0, 0.01, 0, 0, 0.4, 4.0])
PAYLOAD = EffectChoice("payload", runs=("carrying",))


def run(name: str, seed: int, carried: float = 0.0) -> Recording:
    robot = arm("ur10")
    motion = fourier_motion(robot, 8.0, 200.0, seed=seed, amplitude=1.2)
    inertias = robot.inertias.copy()
    inertias[-1] += carried * LOAD
    tau = pinocchio_torque(replace(robot, inertias=inertias), motion.q, motion.dq, motion.ddq)
    tau = tau + 1.5 * np.sign(motion.dq) + 2.0 * motion.dq + 0.2 * motion.ddq
    return record(robot, motion, tau + 0.3 * np.random.default_rng(seed).normal(size=tau.shape), name)


TRAINING = [run("empty", 1), run("carrying", 2, 1.0)]


def added(validation: list[Recording], choice: EffectChoice = PAYLOAD) -> tuple[Identification, Identification]:
    plain = identify(arm("ur10"), TRAINING, validation, CHOICES)
    return plain, extend(plain, [choice], TRAINING, validation)


def advice(found: Identification) -> list[str]:
    return [one for one in found.warnings if "Remove it" in one or "held-out runs" in one]


def test_a_load_that_a_held_out_run_carries_too_is_found_there_and_said_so():
    plain, found = added([run("new", 3, 1.0)])
    assert found.choices.effects[-1].runs == ("carrying", "new")
    # A gain that is off scales the load as it scales the torque, whatever the standard deviation says.
    (gains,) = [warning for warning in found.warnings if "drive gains" in warning]
    assert "Mp" in gains
    assert not any("drive gains" in warning for warning in plain.warnings)
    assert found.held_out.relative_total < 0.6 * plain.held_out.relative_total
    (said,) = advice(found)
    assert "also appears in held-out runs and is assumed there: new" in said


def test_of_several_held_out_runs_those_that_carry_it_are_told_from_those_that_do_not():
    _, found = added([run("first", 3, 1.0), run("second", 4), run("third", 5, 1.0)])
    assert found.choices.effects[-1].runs == ("carrying", "first", "third")
    assert found.held_out.relative_total < 1.2 * found.fit.relative_total


def test_a_held_out_run_without_the_load_is_predicted_without_it():
    plain, found = added([run("new", 3)])
    assert found.choices.effects[-1].runs == ("carrying",)
    assert found.held_out.relative_total < plain.held_out.relative_total
    assert advice(found) == []


def test_what_was_said_of_a_held_out_run_is_believed():
    _, found = added([run("new", 3), run("other", 4, 1.0)], replace(PAYLOAD, runs=("carrying", "new")))
    assert found.choices.effects[-1].runs == ("carrying", "new")
    assert any("Held-out data do not confirm" in one for one in found.warnings)


def test_a_load_that_is_not_there_is_not_found_in_held_out_runs_either():
    training, validation = [run("empty", 1), run("carrying", 2)], [run("new", 3)]
    plain = identify(arm("ur10"), training, validation, CHOICES)
    found = extend(plain, [PAYLOAD], training, validation)
    assert found.choices.effects[-1].runs == ("carrying",)
    assert not any("also appears in held-out runs" in one for one in found.warnings)


def test_the_same_choice_identifies_again_with_the_held_out_run_named():
    validation = [run("new", 3, 1.0)]
    _, found = added(validation)
    again = identify(arm("ur10"), TRAINING, validation, replace(CHOICES, effects=found.choices.effects))
    assert again.held_out.relative_total == pytest.approx(found.held_out.relative_total, rel=1e-6)


def test_a_load_in_held_out_runs_alone_is_refused_with_the_runs_to_name():
    with pytest.raises(DynidentError, match=r"only in held-out runs.*empty, carrying") as refused:
        added([run("new", 3, 1.0)], replace(PAYLOAD, runs=("new",)))
    assert refused.value.pointer == "/effects/0/runs"


@pytest.mark.parametrize(
    ("fitted", "carried", "words"), [(0.0, 1.0, "load: 4 kg more on "), (1.0, 0.0, "load: 4 kg less on ")]
)
def test_another_load_in_the_held_out_run_is_told_with_its_mass(fitted: float, carried: float, words: str) -> None:
    found = identify(arm("ur10"), [run("a", 1, fitted)], [run("b", 2, carried)], CHOICES)
    (warning,) = [one for one in found.warnings if "on validation data" in one]
    assert words in warning
    assert "wrist_3_joint" in warning


def test_no_load_is_told_where_something_else_differs() -> None:
    robot, motion = arm("ur10"), fourier_motion(arm("ur10"), 8.0, 200.0, seed=2, amplitude=1.2)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + 1.5 * np.sign(motion.dq) + 2.0 * motion.dq
    pushed = record(robot, motion, tau + 40.0 * np.sin(2.0 * motion.t)[:, None], "b")
    (warning,) = [one for one in identify(robot, [run("a", 1)], [pushed], CHOICES).warnings if "validation data" in one]
    assert "such as another load" in warning


@pytest.mark.parametrize("gains", [1.3 * np.ones(6), np.array([1.0, 1.0, 1.0, 1.6, 1.5, 1.7])])
def test_no_load_is_told_where_factors_of_the_torques_explain_as_much(gains: np.ndarray) -> None:
    robot, motion = arm("ur10"), fourier_motion(arm("ur10"), 8.0, 200.0, seed=2, amplitude=1.2)
    tau = pinocchio_torque(robot, motion.q, motion.dq, motion.ddq) + 1.5 * np.sign(motion.dq) + 2.0 * motion.dq
    scaled = record(robot, motion, (tau + 0.2 * motion.ddq) * gains, "b")
    (warning,) = [one for one in identify(robot, [run("a", 1)], [scaled], CHOICES).warnings if "validation data" in one]
    assert "such as another load" in warning
