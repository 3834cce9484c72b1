"""Where a joint stands all the time, inside of what its friction may hold, a shaking base is still looked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from hidden_effects import BAND, ROBOT, WITH_OFFSET, nothing, recorded
from oracles import fourier_motion

from dynident.diagnosis import compare
from dynident.diagnosis.residuals.vibration import shaking
from dynident.identification import IdentificationChoices, identify


def test_a_joint_without_any_residual_does_not_end_the_search_for_a_vibration() -> None:
    motion = fourier_motion(ROBOT, 30.0, 200.0, 5)
    run = recorded(motion, nothing, 1, "all joints")
    model = identify(ROBOT, [run], [], IdentificationChoices(WITH_OFFSET, preprocessing=BAND))
    one = np.eye(6)[1]
    sweep = replace(motion, q=motion.q * one + 0.3 * (1.0 - one), dq=motion.dq * one, ddq=motion.ddq * one)
    compared = compare(model, recorded(sweep, nothing, 2, "one joint"))
    assert (compared.errors.rms == 0.0).any()
    (found,) = shaking([compared], model.model.signals, model.next_reference(), [4.3])
    assert abs(found - 4.3) <= 0.3
