"""Without and with a known load: is it found, and is it said where it cannot be?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.measured_arm import FC, FV, IA, NOISE, RATE, ROBOT
from support.oracles import fourier_motion, pinocchio_torque, record

from dynident.errors import DynidentError
from dynident.validation import validate_payload

MASS, CENTRE = 3.0, np.array([0.02, -0.01, 0.08])


def carrying(mass: float):
    """The arm with a ball on its last link."""
    inertias = ROBOT.inertias.copy()
    x, y, z = CENTRE
    spread = (CENTRE @ CENTRE) * np.eye(3) - np.outer(CENTRE, CENTRE)
    own = mass * (spread + 1e-3 * np.eye(3))
    added = [own[0, 0], own[0, 1], own[0, 2], own[1, 1], own[1, 2], own[2, 2], mass * x, mass * y, mass * z, mass]
    inertias[-1] += np.array(added)
    return replace(ROBOT, inertias=inertias)


def loaded_run(seed: int = 1, mass: float = MASS, duration: float = 20.0, amplitude: float = 1.2, gain: float = 1.0):
    motion = fourier_motion(ROBOT, duration, RATE, seed, amplitude=amplitude)
    rigid = pinocchio_torque(carrying(mass), motion.q, motion.dq, motion.ddq)
    tau = rigid + IA * motion.ddq + FC * np.sign(motion.dq) + FV * motion.dq
    tau += NOISE * np.random.default_rng(7).normal(size=tau.shape)
    return replace(record(ROBOT, motion, gain * tau, "loaded"), payload={"mass": MASS})


def test_a_known_load_is_found_within_its_interval(identified, training):
    found = validate_payload(identified, [training], loaded_run())
    assert found.judged.verdict == "pass"
    assert found.weighed.identifiable
    low, high = found.weighed.interval
    assert low <= MASS <= high
    assert high - low < 0.2 * MASS


def test_a_load_that_is_not_what_is_said_fails_with_both_numbers(identified, training):
    found = validate_payload(identified, [training], loaded_run(), mass=4.5)
    assert found.judged.verdict == "fail"
    assert "4.5 kg" in found.judged.reason
    assert "too low" in found.judged.reason


def test_torques_that_are_all_too_large_are_suspected_of_their_gains(identified, training):
    source = training.source
    scaled = replace(training, source=replace(source, tau=1.15 * source.tau))
    found = validate_payload(identified, [scaled], loaded_run(gain=1.15))
    assert found.judged.verdict == "fail"
    assert found.weighed.mass == pytest.approx(1.15 * MASS, rel=0.03)
    assert "gains are probably too high" in found.judged.reason
    assert all(found.gains.identifiable)
    off = np.abs(found.gains.factors - 1 / 1.15)
    assert np.all(off < 3.0 * found.gains.standard_deviations / found.gains.stated)
    assert np.median(found.gains.factors) == pytest.approx(1 / 1.15, rel=0.01)


def test_a_load_too_light_for_the_noise_is_not_a_number(identified, training):
    found = validate_payload(identified, [training], loaded_run(mass=0.02), mass=0.02)
    assert found.judged.verdict == "not_evaluated"
    assert found.weighed.mass is None
    assert "0.02 kg cannot be weighed" in found.judged.reason


def test_a_load_that_the_motion_does_not_tell_from_friction_is_not_a_number(identified, training):
    """Friction that is not the same in both runs passes for a load, unless each run has friction of its own."""
    run = loaded_run()
    motion = fourier_motion(ROBOT, 20.0, RATE, 1)
    more = run.source.tau + np.sign(motion.dq) * 40.0 + 60.0 * motion.dq
    spoilt = replace(run, source=replace(run.source, tau=more))
    found = validate_payload(identified, [training], spoilt, mass=0.3)
    assert found.judged.verdict == "not_evaluated"
    assert "friction" in found.judged.reason


@pytest.mark.parametrize(
    ("payload", "mass", "pointer"),
    [(None, None, "/payload"), ({"mass": "heavy"}, None, "/payload/mass"), ({"mass": 1.0}, -1.0, "/mass")],
)
def test_a_load_of_which_nobody_says_the_mass_is_refused(identified, training, payload, mass, pointer):
    with pytest.raises(DynidentError) as refused:
        validate_payload(identified, [training], replace(loaded_run(), payload=payload), mass)
    assert refused.value.pointer == pointer


def test_a_load_without_a_run_without_it_is_refused(identified):
    with pytest.raises(DynidentError, match="without the payload"):
        validate_payload(identified, [], loaded_run())
