"""The model's torque and its derivatives at one state, for filters that take one sample at a time."""

from __future__ import annotations

import casadi as ca
import numpy as np

from dynident.arrays import FloatArray
from dynident.effects import Signals, build_columns
from dynident.effects.sizes import get_slowest_velocity
from dynident.errors import DynidentError
from dynident.estimation.kalman import TorqueSlopes
from dynident.regressors.model import Model

# Width of the smooth sign(q̇), as a share of the slowest joint's velocity limit: a filter needs its derivative.
_SIGN_WIDTH = 2e-3


class TorqueFunction:
    """Γ(q, q̇, q̈; χ) = W χ of a model, with its derivatives.

    Raises
    ------
    DynidentError
        For an effect that depends on more than q, q̇ and q̈.
    """

    def __init__(self, model: Model) -> None:
        robot, n = model.robot, model.robot.n
        signals = Signals(robot, smooth_sign=_SIGN_WIDTH * get_slowest_velocity(robot))
        all_columns = {column.key: column for column in build_columns(model.effects, signals)}
        columns = [all_columns[column.key] for column in model.kept]
        motion = {symbol.name() for part in (signals.q, signals.dq, signals.ddq) for symbol in ca.symvar(part)}
        for column in columns:
            if {symbol.name() for symbol in ca.symvar(column.torque)} - motion:
                raise DynidentError(
                    f"{column.effect} depends on more than position, velocity and acceleration: a filter that takes "
                    "one sample at a time has no state for it. Leave it out, or choose another estimator",
                    pointer="/estimator",
                    title="Effect without a filter",
                )
        w = ca.densify(ca.horzcat(*(column.torque for column in columns)))
        values = ca.SX.sym("chi", len(columns))
        torque = ca.mtimes(w, values)
        slopes = [ca.densify(ca.jacobian(torque, part)) for part in (signals.q, signals.dq, signals.ddq)]
        # One function for all outputs, with common subexpressions evaluated once: it is called for every sample.
        outputs = ca.cse([ca.horzcat(torque, *slopes, w)])
        self._n = n
        self._function = ca.Function("torque", [signals.q, signals.dq, signals.ddq, values], outputs)
        self._buffer, self._evaluate = self._function.buffer()
        self._inputs = [np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(len(columns))]
        self._out = np.zeros((1 + 3 * n + len(columns), n))
        for k, item in enumerate(self._inputs):
            self._buffer.set_arg(k, memoryview(item))  # type: ignore[call-arg, arg-type]  # the stubs are of C
        self._buffer.set_res(0, memoryview(self._out))  # type: ignore[call-arg, arg-type]

    def __call__(self, q: FloatArray, dq: FloatArray, ddq: FloatArray, values: FloatArray) -> TorqueSlopes:
        """Evaluate at q, dq, ddq (n,) with χ (b,)."""
        for item, value in zip(self._inputs, (q, dq, ddq, values), strict=True):
            item[:] = value
        self._evaluate()
        n, outputs = self._n, self._out.T.copy()  # CasADi's matrices stand column by column
        return TorqueSlopes(
            outputs[:, 0],
            outputs[:, 1 : 1 + n],
            outputs[:, 1 + n : 1 + 2 * n],
            outputs[:, 1 + 2 * n : 1 + 3 * n],
            outputs[:, 1 + 3 * n :],
        )
