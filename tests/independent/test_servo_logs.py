"""An SO-101 in MuJoCo, recorded as LeRobot does it: commands and encoders of its servos at 30 Hz, and no torque."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.servo_arm import GAIN, draw_arm, draw_commands, record, write_log

import dynident as dy
from dynident.recordings import RecordingMetadata


@pytest.mark.slow
@pytest.mark.parametrize("seed", [46, pytest.param(47, marks=pytest.mark.thorough)])
def test_an_arm_is_identified_from_what_its_servos_were_told_to_do(tmp_path: Path, seed: int) -> None:
    arm, described = draw_arm(seed), dy.load_robot("so101")
    ranges = np.array([joint.limits.position for joint in described.joints])
    logs = []
    for name, duration, number in (("fit", 90.0, seed), ("other", 60.0, 1000 + seed)):
        commands = draw_commands(ranges, duration, number)
        logs.append(write_log(tmp_path / f"{name}.csv", record(arm, commands), commands))
    found = dy.inspect(logs[0], described)
    assert [question.field for question in found.questions] == ["drives"]
    robot = dy.load_robot("so101", drive_gains=[GAIN] * 6)
    metadata = RecordingMetadata(effort_kind="position_command")
    first, other = (dy.read_recordings(log, robot=robot, metadata=metadata) for log in logs)
    model = dy.identify(robot, first, validation=other)
    values = {parameter.name: parameter.value for parameter in model.identification.parameters}
    coulomb, viscous = (np.array([values[f"{kind}{joint}"] for joint in range(1, 7)]) for kind in ("Fc", "Fv"))
    assert coulomb == pytest.approx(arm.coulomb, rel=0.2)
    assert viscous == pytest.approx(arm.speed_torque, rel=0.05)
    # No parameters leave less of the held-out torque than those that are fitted to it.
    floor = dy.identify(robot, other).identification.fit.rms
    held_out = model.identification.held_out
    assert held_out is not None
    assert (held_out.rms <= 1.3 * floor).all()
