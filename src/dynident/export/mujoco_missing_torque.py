"""Simulate a whole identified model in MuJoCo: a passive-force callback adds the effects that MJCF cannot hold.

Friction goes into MuJoCo's own friction constraints, whose limits the callback sets at every step: a joint that stands
is held, and does not tremble about zero velocity. All other effects are passive forces.
"""

from __future__ import annotations

import warnings
from typing import Self

import casadi as ca
import mujoco
import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import get_effect, get_role
from dynident.effects.friction import REFERENCE_TEMPERATURE
from dynident.errors import DynidentError
from dynident.export.feasible_completion import complete_parameters
from dynident.export.feasible_links_and_joints import FeasibleLinks, check_base, check_is_tree
from dynident.export.mjcf import HELD_ROLES, write_mjcf
from dynident.expressions import Program
from dynident.identification import Identification, make_physical
from dynident.identification.identified_models.equation_of_motion import EquationOfMotion, build_equation_of_motion

# Below this velocity (rad/s or m/s) a joint counts as standing, and its friction is that of the start of the motion.
_STANDSTILL = 1e-6
# MuJoCo makes a constraint only where the friction is positive.
_LEAST_FRICTION = 1e-9
_KNOWN = ("q", "dq", "ddq", "time", "period", "temperature", "z", "runs")


def to_mujoco(identification: Identification, *, nearest: bool = False) -> mujoco.MjModel:
    """Return the links, rotors, friction and springs of a model as a MuJoCo model, for use with `MissingTorque`.

    The parameters are those of the whole model. `to_mjcf` differs: it fits friction again without the other effects.
    Where no robot can have them, those of the nearest that can are taken, and a Python warning says what that costs.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.
    nearest : bool
        If no bodies that can exist have the identified parameters, take the nearest that can.

    Returns
    -------
    mujoco.MjModel
        The compiled model. Its user data hold the state of hysteresis.

    Raises
    ------
    DynidentError
        As `to_mjcf` does; or if joints of the robot follow others.
    """
    check_base(identification)
    check_is_tree(identification, "MuJoCo with all effects")
    possible = make_physical(identification)
    if possible.warning:
        warnings.warn(possible.warning, stacklevel=2)
    identification = possible.identification
    standard = complete_parameters(identification, nearest=nearest)
    links = FeasibleLinks(identification, identification, standard, HELD_ROLES)
    spec = mujoco.MjSpec.from_string(write_mjcf(links))
    spec.nuserdata = _State.get_size(build_equation_of_motion(identification.estimate))
    for joint in spec.joints:
        joint.frictionloss = max(joint.frictionloss, _LEAST_FRICTION)
    return spec.compile()


class MissingTorque:
    """Effects of an identified model that MJCF cannot hold, as a passive-force callback of MuJoCo.

    Use it as a context: within it, every step, forward and inverse dynamics of this MuJoCo model contain the effects.
    MuJoCo has one callback in a process; another one that is set is called as well, and set again at the end.

    Parameters
    ----------
    mujoco_model : mujoco.MjModel
        The model of `to_mujoco`.
    identification : Identification
        The identified model that it was made from.
    temperature : (n,), optional
        Temperature of the joints in °C, where effects depend on it; 25 °C by default.
    runs : (r,), optional
        1 for each kind of run that the simulation is one of, 0 for others; 0 by default.

    Raises
    ------
    DynidentError
        If the MuJoCo model lacks joints of the robot or space for the state, an effect needs derivatives of the
        acceleration, or there is another number of temperatures or runs.

    Notes
    -----
    Effects that depend on the acceleration use that of the step before; inverse dynamics uses the given one.
    Hysteresis follows the positions at the times of the steps; choose an integrator that evaluates once a step
    (`implicitfast`, as the model has it, or `Euler`), and let `data.time` advance.

    Examples
    --------
    >>> mujoco_model = to_mujoco(model.identification)              # doctest: +SKIP
    >>> data = mujoco.MjData(mujoco_model)                          # doctest: +SKIP
    >>> with MissingTorque(mujoco_model, model.identification):     # doctest: +SKIP
    ...     mujoco.mj_step(mujoco_model, data)
    """

    def __init__(
        self,
        mujoco_model: mujoco.MjModel,
        identification: Identification,
        *,
        temperature: FloatArray | None = None,
        runs: FloatArray | None = None,
    ) -> None:
        possible = make_physical(identification)
        if possible.warning:
            warnings.warn(possible.warning, stacklevel=2)
        identification = possible.identification
        equation = build_equation_of_motion(identification.estimate)
        foreign = [argument.name for argument in equation.arguments if argument.name not in _KNOWN]
        if foreign:
            raise DynidentError(
                f"an effect of the model depends on {', '.join(foreign)}, which MuJoCo does not have", pointer="effects"
            )
        if mujoco_model.nuserdata < _State.get_size(equation):
            raise DynidentError(
                "the MuJoCo model has no space for the state of the effects; make it with to_mujoco",
                pointer="mujoco_model",
            )
        joints = [mujoco.mj_name2id(mujoco_model, mujoco.mjtObj.mjOBJ_JOINT, n) for n in equation.robot.joint_names]
        if min(joints) < 0:
            missing = equation.robot.joint_names[int(np.argmin(joints))]
            raise DynidentError(f"the MuJoCo model has no joint {missing!r}", pointer="mujoco_model")
        self._model = mujoco_model
        self._positions, self._dofs = mujoco_model.jnt_qposadr[joints], mujoco_model.jnt_dofadr[joints]
        self._n_states = int(equation.z_next.numel())
        self._inputs = [argument.name for argument in equation.arguments if argument.name != "z"]
        self._effects = _build_missing_effects(identification, equation)
        n = equation.robot.n
        n_runs = len(identification.model.observation.runs)
        self._constants = {
            "period": np.array([mujoco_model.opt.timestep]),
            "temperature": _read_vector("temperature", temperature, np.full(n, REFERENCE_TEMPERATURE)),
            "runs": _read_vector("runs", runs, np.zeros(n_runs)),
        }
        self._before: object = None

    def __enter__(self) -> Self:
        self._before = mujoco.get_mjcb_passive()
        mujoco.set_mjcb_passive(self._add)
        return self

    def __exit__(self, *_: object) -> None:
        mujoco.set_mjcb_passive(self._before)

    def _add(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        if callable(self._before):
            self._before(model, data)
        if model is not self._model:
            return
        q, dq, ddq = data.qpos[self._positions], data.qvel[self._dofs], data.qacc[self._dofs]
        direction = np.where(dq < 0, -1.0, 1.0)
        # The sign of a velocity of zero is zero; friction at standstill is that with which the motion would begin.
        moving = np.where(np.abs(dq) < _STANDSTILL, _STANDSTILL * direction, dq)
        signals = {"q": q[None], "dq": moving, "ddq": ddq, "time": np.array([data.time]), **self._constants}
        state = _State(data, len(q), self._n_states)
        z, q_before = state.begin(q)
        torque = self._effects(*(signals[name] for name in self._inputs), z, q_before)[0]
        n = len(q)
        friction, other = torque[:n], torque[n : 2 * n]
        state.end(q, torque[2 * n :])
        # Friction resists up to this limit, whatever the direction. A limit below zero would drive the joint: what
        # is missing from zero is then a passive force.
        coulomb = model.dof_frictionloss[self._dofs]
        limit = np.maximum(coulomb + direction * friction, _LEAST_FRICTION)
        data.qfrc_passive[self._dofs] -= other + friction - direction * (limit - coulomb)
        limits = model.dof_frictionloss.copy()
        limits[self._dofs] = limit
        rows = data.efc_type == mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF
        data.efc_frictionloss[rows] = limits[data.efc_id[rows]]
        if data.nisland:
            # Constraints of bodies that move independently are solved from a copy, which is made already.
            rows = data.iefc_type == mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF
            data.iefc_frictionloss[rows] = limits[data.iefc_id[rows]]


def _read_vector(name: str, values: FloatArray | None, default: FloatArray) -> FloatArray:
    """Return values of the default's shape; an error inside a callback of MuJoCo would end the simulation."""
    if values is None:
        return default
    vector = np.asarray(values, dtype=np.float64)
    if vector.shape != default.shape:
        raise DynidentError(f"{name} has the shape {vector.shape}; give {len(default)} numbers", pointer=name)
    return vector


class _State:
    """Hysteresis in the user data of MuJoCo: it is copied with the data, and a reset of the data clears it.

    It holds, for the step before and for the last evaluation: states z and positions; then the time of the last
    evaluation and whether there was one.
    """

    def __init__(self, data: mujoco.MjData, n: int, states: int) -> None:
        self._time = data.time
        size, user = states + n, data.userdata
        self._before, self._last, self._place = user[:size], user[size : 2 * size], user[2 * size : 2 * size + 2]
        self._states = states

    @staticmethod
    def get_size(equation: EquationOfMotion) -> int:
        """Return the number of entries that the state of a model needs; none without hysteresis."""
        states = int(equation.z_next.numel())
        return 2 * (states + equation.robot.n) + 2 if states else 0

    def begin(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the states (z,) and positions (n,) of the step before positions q (n,)."""
        if not self._states:
            return np.zeros(0), q
        if not self._place[1] or self._time < self._place[0]:
            self._before[: self._states], self._before[self._states :] = 0.0, q
        elif self._time > self._place[0]:
            self._before[:] = self._last
        # Several evaluations at one time all begin with the step before: none counts twice.
        return self._before[: self._states], self._before[self._states :]

    def end(self, q: FloatArray, states: FloatArray) -> None:
        """Remember the states (z,) at positions q (n,)."""
        if self._states:
            self._last[: self._states], self._last[self._states :] = states, q
            self._place[:] = self._time, 1.0


def _build_missing_effects(identification: Identification, equation: EquationOfMotion) -> Program:
    """Return a program of the arguments, and of states and positions before the step.

    It computes the torques of missing friction without hysteresis (n,), those of all the rest (n,), and the states at
    the positions (z,).
    """
    columns = identification.model.observation.columns
    arguments = {argument.name: argument.symbol for argument in equation.arguments}
    states = arguments.pop("z", ca.SX(0, 1))
    values, friction = np.zeros(len(columns)), np.zeros(len(columns), dtype=bool)
    memory = identification.model.signals.memory_symbols
    held = {is_friction: ca.SX.zeros(equation.robot.n, 1) for is_friction in (True, False)}
    for k, (column, value) in enumerate(zip(columns, identification.values, strict=True)):
        effect = get_effect(column.effect)
        if effect.is_inertia and not column.runs:
            continue
        values[k] = value
        friction[k] = effect.is_friction and not ca.depends_on(column.torque, memory)
        # The MuJoCo model has these already.
        if not column.runs and get_role(column) in HELD_ROLES:
            held[bool(friction[k])] += column.torque * value
    # All friction of a joint together does not fall beyond the recorded speeds. What MuJoCo holds of it does not know
    # that, so what is missing is the difference.
    sliding, whole = (
        ca.substitute(equation.effects, equation.base, ca.DM(chosen))
        for chosen in (np.where(friction, values, 0.0), values)
    )
    parts = [sliding - held[True], whole - sliding - held[False]]
    if states.numel():
        parts = [ca.substitute(part, states, equation.z_next) for part in parts]
    return Program([*arguments.values(), states, equation.q_before], ca.densify(ca.vertcat(*parts, equation.z_next)))
