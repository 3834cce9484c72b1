"""Results of a model that need no recordings: parameters, their uncertainty, predicted torque, exports."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, overload

import numpy as np
from numpy.typing import ArrayLike

from dynident.api.motion_arguments import Motion, check_level, read_motion, read_times, resolve_simulation
from dynident.api.named_tables import Table
from dynident.api.parameter_tables import ErrorTable, Parameters, ParameterStatistics
from dynident.array_types import FloatArray
from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.estimation import Errors
from dynident.export.export_request import ENDINGS
from dynident.file_output import check_ending, write_atomically
from dynident.identification import Estimate
from dynident.identification.identified_models.torque_prediction import (
    PredictedTorque,
    check_simulated,
    compute_coriolis_matrix,
    compute_friction,
    compute_gravity,
    compute_mass_matrix,
    predict,
)
from dynident.recordings import Preprocessing, Recording
from dynident.robot import Robot
from dynident.verdict import explain_stop

if TYPE_CHECKING:
    from dynident.export import ExportedFile, TorquePredictor
    from dynident.simulation import Simulated


@dataclass(frozen=True, eq=False)
class ModelResults(ParameterStatistics):
    """Parameters of an identified model, their uncertainty, and what can be computed from them.

    Parameters
    ----------
    identification : Identification
        The model as the library gives it.
    """

    @property
    def _held_out(self) -> tuple[Recording, ...]:
        """Held-out recordings, if there are any."""
        return ()

    @property
    def robot(self) -> Robot:
        """The robot that was identified."""
        return self.identification.model.robot

    @cached_property
    def parameters(self) -> Parameters:
        """The base parameters with their standard deviations and intervals."""
        return Parameters(self.identification.parameters)

    @property
    def effects(self) -> tuple[EffectChoice, ...]:
        """The effects in the model."""
        return self.identification.choices.effects

    @property
    def filters(self) -> Preprocessing:
        """The filters of the recordings, with the reasons for those that were chosen from the data."""
        return self.identification.preprocessing

    @property
    def fit(self) -> Errors:
        """Errors on all rows of the data of the fit: `fit.relative_total`, `fit.relative` (n,) and more."""
        return self.identification.fit

    @property
    def held_out(self) -> Errors | None:
        """Errors on all rows of the validation data; None where there are none."""
        return self.identification.held_out

    @property
    def held_out_moving(self) -> Errors | None:
        """Errors on the validation data where each joint moves, by which models are compared; None without any."""
        return self.identification.held_out_moving

    @cached_property
    def errors(self) -> ErrorTable:
        """Errors joint by joint: in the fit and held out, where the joint moves and on all rows."""
        return ErrorTable.from_identification(self.identification)

    @property
    def warnings(self) -> tuple[str, ...]:
        """The warnings of the identification."""
        return self.identification.warnings

    @overload
    def predict(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        *,
        interval: None = None,
        t: ArrayLike | None = None,
        dt: float | None = None,
    ) -> FloatArray: ...
    @overload
    def predict(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        *,
        interval: float,
        t: ArrayLike | None = None,
        dt: float | None = None,
    ) -> PredictedTorque: ...
    def predict(
        self,
        q: ArrayLike,
        dq: ArrayLike,
        ddq: ArrayLike,
        *,
        interval: float | None = None,
        t: ArrayLike | None = None,
        dt: float | None = None,
    ) -> FloatArray | PredictedTorque:
        """Predict the torque of states, or of a motion over time.

        Parameters
        ----------
        q, dq, ddq : (n,) or (m, n)
            Positions, velocities and accelerations in rad, rad/s and rad/s² (m, m/s and m/s² of joints that slide): one
            state, or m of them.
        interval : float, optional
            Probability of intervals, such as 0.95; None for the torque alone.
        t : (m,), optional
            Times in s, which make the samples one motion. Effects with a memory (hysteresis) or that depend on
            derivatives of the acceleration need it, or `dt`.
        dt : float, optional
            Sampling period in s, instead of `t`.

        Returns
        -------
        array of the shape of q, or PredictedTorque
            Torque in N m, or N; projected as its equations are, if the robot has contacts; NaN for a joint whose torque
            was not recorded. With `interval` an object with `torque`, and `lower` and `upper` of what would be measured
            and filtered as the recordings were: the covariance of the parameters and the variance of the residual.
            `mean_half_width` belongs to the model's own torque, without the residual.

        Raises
        ------
        DynidentError
            For arrays that do not fit, positions that look like degrees, or effects that depend on more than the
            motion.

        Examples
        --------
        >>> model.predict(q, dq, ddq)  # doctest: +SKIP
        >>> torque = model.predict(q, dq, ddq, interval=0.95)  # doctest: +SKIP
        >>> torque.lower, torque.upper  # doctest: +SKIP
        """
        motion = read_motion(self.robot, q=q, dq=dq, ddq=ddq)
        times = read_times(motion, t, dt)
        level = 0.95 if interval is None else check_level(interval, "interval")
        if times is None:
            self._check_no_memory()
        predicted = predict(self._estimate, *motion.arrays, level=level, t=times)
        if interval is None:
            return predicted.torque.reshape(motion.shape)
        return PredictedTorque(
            predicted.torque.reshape(motion.shape),
            predicted.se_mean.reshape(motion.shape),
            predicted.mean_half_width.reshape(motion.shape),
            predicted.half_width.reshape(motion.shape),
            level,
        )

    def true_params(self, parameters: Mapping[str, float] | None = None, *, request: Simulated | None = None) -> Table:
        """Return the base parameters of a virtual robot, to compare those of a simulation with.

        Parameters
        ----------
        parameters, request : mapping of str to float, Simulated
            As `DesignedMotion.simulate` was given them.

        Returns
        -------
        Table
            By the names of `params`; effects that the virtual robot does not have are 0. NaN stands where it has the
            effect with other shape constants, or in other runs alone: their parameters are other ones.

        Examples
        --------
        >>> error = model.params["Fc1"] - model.true_params({"Fc1": 3.0})["Fc1"]  # doctest: +SKIP
        """
        from dynident.simulation import compute_true_parameters

        # The motion and the rate of the sensors change no parameter.
        simulation = resolve_simulation(self.robot, parameters, request, None)
        model = self.identification.model
        standard = compute_true_parameters(self.robot, simulation, model.columns)
        unknown = np.isnan(standard)
        values = model.base.grouping @ np.where(unknown, 0.0, standard)
        values[model.base.written[:, unknown].any(axis=1)] = np.nan
        return self._label({"value": values}, "True base parameters")

    def predictor(self) -> TorquePredictor:
        """Return a predictor for a controller, which carries the memory of hysteresis along.

        Returns
        -------
        TorquePredictor
            Call `step(q, dq, ddq)` once a sample, and `reset()` before a new motion.

        Examples
        --------
        >>> predictor = model.predictor()  # doctest: +SKIP
        >>> torque = predictor.step(q, dq, ddq)  # (n,), once for every sample  # doctest: +SKIP
        """
        # Imported here: a model that is not exported needs none of the formats and of their packages.
        from dynident.export import PredictingModel

        return PredictingModel.from_identification(self.identification).predictor()

    def gravity(self, q: ArrayLike) -> FloatArray:
        """Return the torque that holds the links at rest.

        Parameters
        ----------
        q : (n,) or (m, n)
            Positions in rad, or m.

        Returns
        -------
        array of the shape of q
            Torque in N m, or N. Springs, offsets and other effects are not in it.

        Examples
        --------
        >>> model.gravity(q)  # doctest: +SKIP
        """
        return self._compute(compute_gravity, read_motion(self.robot, q=q))

    def mass_matrix(self, q: ArrayLike) -> FloatArray:
        """Return the mass matrix of links and rotors, symmetric.

        Parameters
        ----------
        q : (n,) or (m, n)
            Positions in rad, or m.

        Returns
        -------
        array (n, n) or (m, n, n)
            In kg m² (kg m and kg where joints slide).

        Examples
        --------
        >>> model.mass_matrix(q) @ ddq  # doctest: +SKIP
        """
        return self._compute(compute_mass_matrix, read_motion(self.robot, q=q))

    def coriolis(self, q: ArrayLike, dq: ArrayLike) -> FloatArray:
        """Return the Coriolis matrix C, by Christoffel symbols; C q̇ is the Coriolis and centrifugal torque.

        Parameters
        ----------
        q, dq : (n,) or (m, n)
            Positions and velocities in rad and rad/s, or m and m/s.

        Returns
        -------
        array (n, n) or (m, n, n)
            The matrix of Pinocchio's `computeCoriolisMatrix`.

        Examples
        --------
        >>> model.coriolis(q, dq) @ dq  # doctest: +SKIP
        """
        return self._compute(compute_coriolis_matrix, read_motion(self.robot, q=q, dq=dq))

    def friction(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike | None = None) -> FloatArray:
        """Return the torque of friction.

        Parameters
        ----------
        q, dq : (n,) or (m, n)
            Positions and velocities in rad and rad/s, or m and m/s.
        ddq : (n,) or (m, n), optional
            Accelerations, where friction depends on the load; zero by default.

        Returns
        -------
        array of the shape of q
            Torque in N m, or N. Hysteresis counts as sliding steadily; `predictor` follows it along a path.

        Raises
        ------
        DynidentError
            For friction that depends on temperature, on the time of the session or on the run.

        Examples
        --------
        >>> model.friction(q, dq)  # doctest: +SKIP
        """
        accelerations = np.zeros_like(np.asarray(dq, dtype=np.float64)) if ddq is None else ddq
        return self._compute(compute_friction, read_motion(self.robot, q=q, dq=dq, ddq=accelerations))

    def forward_dynamics(self, q: ArrayLike, dq: ArrayLike, tau: ArrayLike) -> FloatArray:
        """Return the acceleration under motor torques: the right side of a simulation.

        Dry friction jumps where a joint turns round or stops. Integrate in steps of fixed size; integrators that choose
        their steps, such as `scipy.integrate.solve_ivp`, take endlessly many at a joint that stops.

        Parameters
        ----------
        q, dq : (n,) or (m, n)
            Positions and velocities in rad and rad/s, or m and m/s.
        tau : (n,) or (m, n)
            Torques of the motors in N m, or N.

        Returns
        -------
        array of the shape of q
            Accelerations in rad/s², or m/s².

        Raises
        ------
        DynidentError
            For effects that depend on the acceleration or on more than the state, joints without recorded torque, and
            a mass matrix that no robot has.

        Examples
        --------
        >>> for torque in torques:  # one row for each millisecond  # doctest: +SKIP
        ...     dq = dq + 0.001 * model.forward_dynamics(q, dq, torque)
        ...     q = q + 0.001 * dq
        """
        motion = read_motion(self.robot, q=q, dq=dq, tau=tau)
        self._check_no_memory()
        q_rows, dq_rows, torque = motion.arrays
        mass = self._compute(compute_mass_matrix, Motion((q_rows,), q_rows.shape))
        check_simulated(self._estimate, mass)
        rest = predict(self._estimate, q_rows, dq_rows, np.zeros_like(q_rows)).torque
        acceleration = np.asarray(np.linalg.solve(mass, (torque - rest)[..., None])[..., 0], dtype=np.float64)
        again = predict(self._estimate, q_rows, dq_rows, acceleration).torque
        if not np.allclose(again, torque, rtol=1e-6, atol=1e-6 * float(np.abs(mass).max())):
            raise DynidentError(
                "an effect of this model depends on the acceleration, so that this is no explicit function of the "
                "torque; remove it, such as model.remove(…), to simulate the model",
                pointer="tau",
                title="No forward dynamics",
            )
        return np.asarray(acceleration.reshape(motion.shape))

    def export(self, path: str | Path, *, nearest: bool = False, anyway: bool = False) -> ExportedFile:
        """Write the model for another program, in the format that the ending of the path names.

        Parameters
        ----------
        path : path
            .urdf, .xml or .mjcf (MuJoCo), .c, .casadi or .json. C code, CasADi functions and JSON contain every effect;
            URDF and MJCF hold links and rotors as they were identified, and Coulomb and viscous friction (MJCF also
            springs), fitted again where the model has effects that they cannot hold.
        nearest : bool
            URDF and MJCF: where no bodies that can exist have the identified parameters, write the nearest that can.
        anyway : bool
            Write also a model whose error is too large for any use.

        Returns
        -------
        ExportedFile
            What was written, with its error on held-out data and notes on what the format cannot hold. Headers (.h,
            .hpp) of a model with held-out recordings (`validation`) have thresholds for contacts, for one false alarm
            an hour or as few as these recordings can state.

        Raises
        ------
        DynidentError
            For another ending, a folder that does not exist, a model that is not to be used, or one that the format
            cannot hold.

        Examples
        --------
        >>> model.export("arm.urdf").notes  # doctest: +SKIP
        """
        from dynident.export import export_model

        path = check_ending(path, tuple(ENDINGS))
        reason = explain_stop(self.identification)
        if reason and not anyway:
            raise DynidentError(f"{reason}. To write it anyway: export(…, anyway=True)", title="Not fit for use")
        file = export_model(self.identification, ENDINGS[path.suffix.lower()], nearest=nearest, held_out=self._held_out)
        write_atomically(path, file.content)
        return replace(file, name=str(path))

    @property
    def _estimate(self) -> Estimate:
        return self.identification.estimate

    def _compute(self, function: Callable[..., FloatArray], motion: Motion) -> FloatArray:
        self.robot.require_no_contacts("term of its equations alone")
        result = function(self._estimate, *motion.arrays)
        return np.asarray(result[0]) if motion.is_single else result

    def _check_no_memory(self) -> None:
        memory = self.identification.model.observation.memory
        # Rows in any order would give a torque that depends on the order, and one state has no path at all.
        if memory:
            names = self.robot.joint_names
            joints = ", ".join(sorted({names[signal.joint] for signal in memory if signal.joint < len(names)}))
            raise DynidentError(
                f"the torque of this model depends on the path before a state (hysteresis on {joints}): give the "
                "samples of a motion with their times, predict(q, dq, ddq, dt=0.001), or make a predictor() and call "
                "its step() for every sample",
                pointer="q",
                title="Path needed",
            )
