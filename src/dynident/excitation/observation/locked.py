"""What motions can show in which some joints move while the others are locked (§12.3.4.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynident.arrays import BoolArray, FloatArray
from dynident.errors import DynidentError
from dynident.excitation.observation.model import JUMP_TIME, DesignModel
from dynident.regressors.base_parameters import select_base
from dynident.regressors.further_signals import FurtherSignals
from dynident.regressors.observation import Observation
from dynident.robot.pointers import join_names

_STATES_PER_COLUMN = 2
_VELOCITY, _ACCELERATION, _JERK, _SNAP = 2.0, 5.0, 20.0, 80.0


def lock_model(model: DesignModel, posture: FloatArray, moving: BoolArray) -> DesignModel:
    """Return the model of the arm whose other joints are locked at a posture (n,): fewer parameters, fewer equations.

    The base parameters are those that the equations of the moving joints determine. The torque of a locked joint is
    held
    by its brake or against an unknown stiction: its equations do not count.

    Raises
    ------
    DynidentError
        The moving joints determine none of the parameters.
    """
    w = _sample_observation(model, posture, moving)
    names = [column.name for column in model.columns]
    visible = select_base(
        w[:, moving, : model.n_chosen].reshape(-1, model.n_chosen), tuple(names[: model.n_chosen])
    ).kept
    if not visible:
        raise DynidentError(
            "the joints that move show none of the parameters; choose other joints or effects",
            pointer="/trajectory/joints",
        )
    # The parameters to identify come first, so that base selection keeps them before those that only predict torque.
    order = [*visible, *(k for k in range(len(names)) if k not in visible)]
    base = select_base(w[:, :, order].reshape(-1, len(order)), tuple(names[k] for k in order))
    columns = tuple(model.columns[k] for k in order)
    return replace(model, columns=columns, n_chosen=len(visible), base=base, counted=moving)


def note_locked_joints(names: Sequence[str], moving: BoolArray) -> str:
    """Return the note that names the locked joints."""
    still = [name for name, moves in zip(names, moving, strict=True) if not moves]
    return (
        f"Locked at home: {join_names(still)}. W has the equations of the joints that move, and the parameters that these "
        "show."
    )


def _sample_observation(model: DesignModel, posture: FloatArray, moving: BoolArray) -> FloatArray:
    """Return W (m, n, c) of all columns at random states of the moving joints."""
    rng = np.random.default_rng(0)
    robot = model.robot
    m = _STATES_PER_COLUMN * len(model.columns) + 20
    low = [-np.pi if joint.kind == "revolute" else (joint.reach or (-1.0, 1.0))[0] for joint in robot.joints]
    high = [np.pi if joint.kind == "revolute" else (joint.reach or (-1.0, 1.0))[1] for joint in robot.joints]
    q = np.where(moving, rng.uniform(low, high, (m, robot.n)), posture)
    largest = np.array([_VELOCITY, _ACCELERATION, _JERK, _SNAP])[:, None, None]
    dq, ddq, dddq, ddddq = moving * largest * rng.uniform(-1, 1, (4, m, robot.n))
    # Some states at rest: what depends on position alone must not hide behind large accelerations.
    dq[::4] *= 0.05
    ddq[::4] = 0.0
    observation = Observation.from_columns(robot, model.columns, model.signals)
    entries = observation.evaluate(
        q,
        dq,
        ddq,
        reference=model.reference,
        memory=rng.uniform(-1, 1, (m, observation.n_memory)),
        further=FurtherSignals(dddq=dddq, ddddq=ddddq, period=JUMP_TIME),
    )
    w = np.zeros((m, robot.n, len(model.columns)))
    w[:, observation.entry_rows, observation.entry_columns] = entries
    return w
