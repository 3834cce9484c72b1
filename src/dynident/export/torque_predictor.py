"""Predict torque by a model along a motion, or step by step with hysteresis states."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import ReferenceParameters
from dynident.effects.hysteresis_states import MemoryStates
from dynident.errors import DynidentError
from dynident.identification import Identification
from dynident.regressors.model_structure import Model
from dynident.regressors.observation_matrix import NOTHING_FURTHER, FurtherSignals, Observation
from dynident.robot.robot_model import Robot


@dataclass(frozen=True, eq=False)
class PredictingModel:
    """A model that predicts torque.

    Parameters
    ----------
    model : Model
        Robot and effects.
    values : (b,)
        Base parameters.
    reference : ReferenceParameters
        Parameters for the predicted loads that effects depend on.
    """

    model: Model
    values: FloatArray
    reference: ReferenceParameters

    @classmethod
    def from_identification(cls, identification: Identification) -> PredictingModel:
        """Return the predicting part of an identified model."""
        return cls(identification.model, identification.values, identification.estimate.reference)

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self.model.robot

    @property
    def observation(self) -> Observation:
        """W for the base parameters."""
        return self.model.observation

    def torque(
        self,
        q: FloatArray,
        dq: FloatArray,
        ddq: FloatArray,
        *,
        sliding: bool = False,
        further: FurtherSignals = NOTHING_FURTHER,
    ) -> FloatArray:
        """Predict torque along a motion: W χ of [12.4], m samples of one run in the order of time.

        Parameters
        ----------
        q, dq, ddq : (m, n)
            Positions, velocities and accelerations: rad, rad/s, rad/s² of revolute joints; m, m/s, m/s² of prismatic
            ones.
        sliding : bool
            Predict every sample by itself, as if its joints had long moved in the direction of their velocity: the
            steady state of hysteresis.
        further : FurtherSignals, optional
            Higher derivatives, time, temperature, run; `build_torque_formula` tells which of them a model needs.

        Returns
        -------
        (m, n)
            Torques in N m, or forces in N.

        Raises
        ------
        DynidentError
            For a single sample of a model with hysteresis, whose torque depends on the path before it.
        """
        if sliding:
            return self._compute_torque(q, dq, ddq, self.observation.compute_sliding_states(dq), further)
        # Any state before it could be meant: a guess would be wrong by the whole stroke of the hysteresis.
        if len(q) == 1 and self.observation.memory:
            joints = sorted({self.robot.joint_names[signal.joint] for signal in self.observation.memory})
            raise DynidentError(
                f"the torque of this model depends on the path before a sample (hysteresis on {', '.join(joints)}); "
                "a single sample has no path: make a predictor() once and call its step() for every sample, or ask "
                "for the torque in steady motion (sliding=True)",
                pointer="q",
                title="Path needed",
            )
        return self.predictor().torque(q, dq, ddq, further=further)

    def predictor(self) -> TorquePredictor:
        """Return a predictor for a motion that comes step by step; it carries the hysteresis along."""
        return TorquePredictor(self)

    def _compute_torque(
        self, q: FloatArray, dq: FloatArray, ddq: FloatArray, states: FloatArray, further: FurtherSignals
    ) -> FloatArray:
        entries = self.observation.evaluate(q, dq, ddq, reference=self.reference, memory=states, further=further)
        torque = self.observation.compute_torque(entries, self.values)
        # Of a joint whose torque was not recorded a part of the parameters is known, and no sum of them.
        return np.where(self.observation.robot.has_torque, torque, np.nan)


class TorquePredictor:
    """Predictor of torque along one motion that comes step by step, as in a controller.

    Hysteresis depends on the path, so the predictor carries its state from call to call. The torque does not depend on
    the pieces in which a motion comes.

    Parameters
    ----------
    model : PredictingModel
        Model that predicts.

    Examples
    --------
    >>> predictor = model.predictor()  # doctest: +SKIP
    >>> predictor.reset()              # a new motion begins                      # doctest: +SKIP
    >>> tau = predictor.step(q, dq, ddq)  # (n,), once for every sample           # doctest: +SKIP
    """

    def __init__(self, model: PredictingModel) -> None:
        self._model = model
        self._states = MemoryStates(model.observation.memory)

    def __repr__(self) -> str:
        robot = self._model.robot
        return (
            f"TorquePredictor({robot.name}: {robot.n} joints; step(q, dq, ddq) once a sample, reset() before a motion)"
        )

    def reset(self) -> None:
        """Begin a new motion, with every joint relaxed."""
        self._states.restart()

    def step(
        self, q: FloatArray, dq: FloatArray, ddq: FloatArray, *, further: FurtherSignals = NOTHING_FURTHER
    ) -> FloatArray:
        """Predict the torque (n,) of the next sample; q, dq, ddq (n,)."""
        rows = [np.asarray(values, dtype=np.float64)[None] for values in (q, dq, ddq)]
        n = self._model.robot.n
        for name, row in zip(("q", "dq", "ddq"), rows, strict=True):
            if row.shape != (1, n):
                raise DynidentError(
                    f"{name} has the shape {row.shape[1:]}; give ({n},), one value a joint", pointer=name
                )
        return np.asarray(self.torque(*rows, further=further)[0])

    def torque(
        self, q: FloatArray, dq: FloatArray, ddq: FloatArray, *, further: FurtherSignals = NOTHING_FURTHER
    ) -> FloatArray:
        """Predict the torque (m, n) of the next m samples; q, dq, ddq (m, n)."""
        # The order matters: states are those after the step to these positions, which the next call goes on from.
        states = self._states.push(self._model.observation.robot.positions(q))
        return self._model._compute_torque(q, dq, ddq, states, further)
