"""`Model`: effects on a robot with their columns, base parameters and W; built and extended."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import cast

import numpy as np

from dynident.array_types import FloatArray
from dynident.effects import (
    DRIVE_ROLES,
    LINKS,
    Column,
    Effect,
    EffectChoice,
    ReferenceParameters,
    Role,
    RunSignal,
    Signals,
    build_columns,
    get_effect,
    get_role,
)
from dynident.effects.predicted_torque_expressions import CarriedInertia
from dynident.errors import DynidentError
from dynident.recordings import Recording
from dynident.regressors.base_parameters import (
    DEFAULT_TOLERANCE,
    BaseParameters,
    evaluate_at_random_states,
    find_base_parameters,
    select_base,
)
from dynident.regressors.observation_matrix import Observation
from dynident.regressors.row_phases import build_rest_observation
from dynident.robot.pseudo_inertia import estimate_inertia_errors, estimate_rotor_inertias
from dynident.robot.robot_model import INERTIAL_NAMES, Robot

# Choices of effects whose columns are kept at hand for a model; a diagnosis asks for some 600.
_MOST_CHOICES = 10_000
# Rows of the random observation matrix for every column: twice as many as would do.
_STATES_PER_COLUMN = 2


def extend_model(model: Model, added: Sequence[EffectChoice], *, tolerance: float = DEFAULT_TOLERANCE) -> Model:
    """Return a model with more effects.

    Its base parameters are those of the given model and, behind them, those of the new columns that are independent:
    of dependent columns the earlier one is kept.

    Parameters
    ----------
    model : Model
        The model to extend.
    added : sequence of EffectChoice
        The effects to add, in order.
    tolerance : float
        Share of a column that may be left outside the others for it to count as dependent on them.

    Returns
    -------
    Model
        It shares the compiled observation matrix of the given one. Of an extension that was asked for lately, it is at
        hand, as `get_model` says.

    Raises
    ------
    DynidentError
        For an unknown effect, an unfit joint, or an effect chosen twice with the same columns.
    """
    if not added:
        raise DynidentError("choose at least one effect to add", pointer="/effects")
    meant, geometry = _find_meant_effects(added), _read_geometry(model.robot)
    return _extend_model_once(model.original, tuple(added), meant, tolerance, geometry).with_own_signals()


@lru_cache(maxsize=32)
def _extend_model_once(
    model: Model, added: tuple[EffectChoice, ...], _meant: tuple[Effect, ...], tolerance: float, _geometry: bytes
) -> Model:
    signals = model.signals.copy()
    new = build_columns(added, signals)
    columns = (*model.columns, *new)
    check_columns(columns)
    whole = model.observation.extend(new, signals)
    n_states = _STATES_PER_COLUMN * whole.n_columns // model.robot.n + 20
    names = tuple(column.name for column in whole.columns)
    # At other states a column that is nearly dependent may pass for a dependent one: those of the model stay.
    selection = select_base(evaluate_at_random_states(whole, n_states), names, tolerance, model.n_parameters)
    fresh = [k - model.n_parameters for k in selection.kept if k >= model.n_parameters]
    observation = whole
    # The first extension has dependent columns among the new ones: another one without them is needed.
    if len(fresh) < len(new):
        observation = model.observation.extend([new[k] for k in fresh], signals)
    effects = (*model.effects, *added)
    return Model(model.robot, effects, signals, columns, _extend_base_parameters(model, selection, names), observation)


def _extend_base_parameters(model: Model, selection: BaseParameters, names: tuple[str, ...]) -> BaseParameters:
    """Return base parameters of all columns, from those of the model and the new ones behind its kept columns."""
    before, b, c = model.base, model.n_parameters, len(model.columns)
    shape = (selection.count, c + len(names) - b)
    grouping, written = np.zeros(shape), np.zeros(shape, dtype=bool)
    grouping[:b, :c], written[:b, :c] = before.grouping, before.written
    grouping[:, c:], written[:, c:] = selection.grouping[:, b:], selection.written[:, b:]
    return BaseParameters(
        names=before.names + names[b:],
        kept=before.kept + tuple(k - b + c for k in selection.kept if k >= b),
        grouping=grouping,
        written=written,
        without_effect=before.without_effect + tuple(k - b + c for k in selection.without_effect),
        rank=before.rank + selection.rank - b,
    )


# Where parameters of the motors' torque stand in `ReferenceParameters`; the rotors' are found with the links'.
_DRIVE_ROWS: dict[Role | None, int] = {role: row for row, role in enumerate(DRIVE_ROLES) if role != "rotor"}


@dataclass(frozen=True, eq=False)
class Model:
    """Chosen effects on one robot.

    Parameters
    ----------
    robot : Robot
        The robot, with its description's inertial parameters where they are known.
    effects : tuple of EffectChoice
        The chosen effects, in order.
    signals : Signals
        The symbols that the columns are made of.
    columns : tuple of Column
        Columns of all standard parameters.
    base : BaseParameters
        Which columns are kept, and how the others group into them.
    observation : Observation
        W of the kept columns, in the order of `base.kept`.
    """

    robot: Robot
    effects: tuple[EffectChoice, ...]
    signals: Signals
    columns: tuple[Column, ...]
    base: BaseParameters
    observation: Observation

    def __repr__(self) -> str:
        effects = ", ".join(dict.fromkeys(choice.effect for choice in self.effects))
        return f"Model({self.robot.name}: {self.n_parameters} base parameters of {effects})"

    @property
    def kept(self) -> tuple[Column, ...]:
        """Columns of the base parameters."""
        return self.observation.columns

    @property
    def original(self) -> Model:
        """The model that this one is a copy of, with signals that nobody adds to."""
        return cast("Model", self.__dict__.get("_original", self))

    def with_own_signals(self) -> Model:
        """Return a copy that shares everything but the hysteresis states and runs that are added to its signals."""
        own = copy.copy(self)
        own.__dict__.update(signals=self.signals.copy(), _original=self)
        return own

    @property
    def at_rest(self) -> Observation:
        """The friction of the kept columns where each joint is about to move, in either direction: (2 n, b)."""
        return self.original._observation_at_rest

    @cached_property
    def _observation_at_rest(self) -> Observation:
        return build_rest_observation(self.robot, self.kept, self.signals)

    @property
    def n_parameters(self) -> int:
        """Number of base parameters b."""
        return self.base.count

    @property
    def is_at_rest(self) -> bool:
        """Whether it has links, but none of their moments of inertia: only what shows while the robot stands."""
        links = [column for column in self.columns if get_role(column) == "link"]
        return bool(links) and not any(
            get_role(column) == "link" and column.parameter in INERTIAL_NAMES[:6] for column in self.kept
        )

    @property
    def needs_load(self) -> bool:
        """Whether a column depends on the load torque that the rigid body predicts."""
        return any(get_effect(choice.effect).needs_load for choice in self.effects)

    @property
    def absorbed_columns(self) -> tuple[Column, ...]:
        """Columns of effects other than the links' and rotors' inertia that dissolve in the base parameters."""
        return self._find_dropped_columns(hidden=False)

    @property
    def hidden_columns(self) -> tuple[Column, ...]:
        """Columns of effects, rotors among them, that only the equations of joints without torque would show."""
        return self._find_dropped_columns(hidden=True)

    def _find_dropped_columns(self, *, hidden: bool) -> tuple[Column, ...]:
        base_columns, silent = set(self.base.kept), self.robot.joints_without_torque
        columns = [column for k, column in enumerate(self.columns) if k not in base_columns]
        if hidden:
            return tuple(c for c in columns if c.link in silent and get_role(c) != "link")
        return tuple(c for c in columns if c.link not in silent and not get_effect(c.effect).is_inertia)

    def compute_standard_inertia(self, values: FloatArray) -> FloatArray:
        """Return standard inertial parameters of all links that have these base parameters, near the description's.

        The base parameters determine the torque; of all standard parameters that give them, those nearest to the
        description's are taken, since effects that reach beyond the base parameters (a tilted base) need a choice.
        Near is measured by how far a description is usually off; of rotors, which it does not know, anything is near.

        Parameters
        ----------
        values : (b,)
            Base parameters.

        Returns
        -------
        (10 N,)
            Link by link, in the order of `INERTIAL_NAMES`.
        """
        return self._solve_inertial_parameters(values)[0]

    def describe_base_parameters(self) -> FloatArray | None:
        """Return the base parameters (b,) of the links in the robot's description; None where it gives no masses."""
        described = self.robot.inertias
        if described is None or not np.any(described[:, 9] > 0.0):
            return None
        standard, links = np.zeros(len(self.columns)), described.reshape(-1)
        for k, column in enumerate(self.columns):
            if get_role(column) == "link":
                standard[k] = links[self._standard_index(column)]
        return np.asarray(self.base.grouping @ standard)

    def _solve_inertial_parameters(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return standard inertial parameters (10 N,) and, if all links are in the model, rotors' inertias."""
        none = np.zeros(0)
        rigid = [k for k, column in enumerate(self.columns) if get_role(column) == "link"]
        described = self.robot.inertias
        links = np.zeros(10 * self.robot.tree.n) if described is None else described.reshape(-1).astype(np.float64)
        if not rigid:
            return links, none
        # Coordinates of a base that moves carry no link, but for the last one: their places stay zero.
        first = len(INERTIAL_NAMES) * self.robot.tree.n_massless
        if len(rigid) != len(links) - first:
            # Only some links' parameters are in the model: the base parameters stand for themselves, all others are
            # zero.
            full = np.zeros(len(links))
            for k, position in enumerate(self.base.kept):
                column = self.columns[position]
                if get_role(column) == "link":
                    full[self._standard_index(column)] = values[k]
            return full, none
        rotors = [k for k, column in enumerate(self.columns) if get_role(column) == "rotor"]
        inertial = [k for k, column in enumerate(self.kept) if get_effect(column.effect).is_inertia]
        everything = rigid + rotors
        # Base parameters of friction are left out, and so are standard parameters of other effects.
        grouping = self.base.grouping[np.ix_(inertial, everything)]
        # Base parameters in which no link and no rotor takes part give no equation.
        has_inertia = np.any(self.base.written[np.ix_(inertial, everything)], axis=1)
        nominal = np.concatenate([links[first:], np.zeros(len(rotors))])
        of_rotors = estimate_rotor_inertias(self.robot.tree)[[self._joint_index(k) for k in rotors]]
        scale = np.concatenate([estimate_inertia_errors(self.robot.tree).reshape(-1)[first:], of_rotors])
        gap = values[inertial][has_inertia] - grouping[has_inertia] @ nominal
        # The minimum-norm correction of the nominal values, in units of their usual errors, that gives the base
        # parameters.
        solution = nominal + scale * (np.linalg.pinv(grouping[has_inertia] * scale, rcond=1e-9) @ gap)
        return np.concatenate([links[:first], solution[: len(rigid)]]), solution[len(rigid) :]

    def build_reference(self, values: FloatArray) -> ReferenceParameters:
        """Return the parameters that torque is predicted with.

        Parameters
        ----------
        values : (b,)
            Base parameters.

        Returns
        -------
        ReferenceParameters
            Standard inertial parameters of links, and of what they carry in some runs; Ia, Fc, Fv and b of driven
            joints.
        """
        names = self.robot.joint_names
        links, inertias_of_rotors = self._solve_inertial_parameters(values)
        drives = np.zeros((len(DRIVE_ROLES), self.robot.n))
        rotors = [k for k, column in enumerate(self.columns) if get_role(column) == "rotor"]
        for value, k in zip(inertias_of_rotors, rotors, strict=False):
            if self.columns[k].link in names:
                drives[0, names.index(self.columns[k].link)] = value
        carried: dict[tuple[str, ...], FloatArray] = {}
        # Values of one role on a joint add up, such as those of friction in all runs and in some of them.
        for column, value in zip(self.kept, values, strict=True):
            if get_role(column) == "load":
                inertias = carried.setdefault(column.runs, np.zeros((self.robot.tree.n, len(INERTIAL_NAMES))))
                place = (
                    self.robot.tree.joint_names.index(column.link),
                    INERTIAL_NAMES.index(column.parameter.removesuffix("p")),
                )
                inertias[place] += value
            row = _DRIVE_ROWS.get(get_role(column))
            if row is not None and column.link in names:
                drives[row, names.index(column.link)] += value
        loads = tuple(CarriedInertia(runs, inertias) for runs, inertias in carried.items())
        rotors_of_joints, dry, damping, constant = drives
        return ReferenceParameters(links.reshape(-1, 10), rotors_of_joints, dry, damping, constant, loads)

    def _joint_index(self, column: int) -> int:
        return self.robot.tree.joint_names.index(self.columns[column].link)

    def _standard_index(self, column: Column) -> int:
        link = self.robot.tree.joint_names.index(column.link)
        return 10 * link + INERTIAL_NAMES.index(column.parameter)


def build_model(
    robot: Robot,
    effects: Sequence[EffectChoice],
    *,
    tolerance: float = DEFAULT_TOLERANCE,
    signals: Signals | None = None,
    base: BaseParameters | None = None,
) -> Model:
    """Build the model of effects on a robot.

    Parameters
    ----------
    robot : Robot
        The robot that the effects act on.
    effects : sequence of EffectChoice
        The chosen effects, in the order of preference: of dependent columns the earlier one is kept.
    tolerance : float
        Share of a column that may be left outside the others for it to count as dependent on them.
    signals : Signals, optional
        Those of another model of the same robot: its mechanics need not be derived again.
    base : BaseParameters, optional
        Those of the same effects on the same robot, where they are known.

    Returns
    -------
    Model
        With compiled W of its base parameters.

    Raises
    ------
    DynidentError
        For an unknown effect, an unfit joint, an effect chosen twice with the same columns, or no effect at all.
    """
    if not effects:
        raise DynidentError(f"choose at least one effect, for instance {LINKS.effect}", pointer="/effects")
    signals = signals or Signals(robot)
    columns = build_columns(effects, signals)
    check_columns(columns)
    base = base or find_base_parameters(robot, columns, signals, tolerance=tolerance)
    observation = Observation.from_columns(robot, [columns[k] for k in base.kept], signals)
    return Model(robot, tuple(effects), signals, tuple(columns), base, observation)


def get_model(robot: Robot, effects: Sequence[EffectChoice], *, tolerance: float = DEFAULT_TOLERANCE) -> Model:
    """Return a model as `build_model` does; of a robot and effects that were asked for lately, it is at hand.

    Parameters
    ----------
    robot : Robot
        The robot that the effects act on.
    effects : sequence of EffectChoice
        The chosen effects, in the order of preference.
    tolerance : float
        Share of a column that may be left outside the others for it to count as dependent on them.

    Returns
    -------
    Model
        Its symbols and compiled columns are shared; hysteresis states and runs that are added to it are its own.

    Raises
    ------
    DynidentError
        As `build_model` does.
    """
    meant = _find_meant_effects(effects)
    # A robot is known by its identity, and what is written into its arrays makes another one of it.
    geometry = _read_geometry(robot)
    known = _build_model_once(robot, tuple(effects), meant, tolerance, geometry)
    if known.signals.n_built > _MOST_CHOICES:
        _build_model_once.cache_clear()
        _extend_model_once.cache_clear()
        known = _build_model_once(robot, tuple(effects), meant, tolerance, geometry)
    return known.with_own_signals()


@lru_cache(maxsize=16)
def _build_model_once(
    robot: Robot, effects: tuple[EffectChoice, ...], _meant: tuple[Effect, ...], tolerance: float, _geometry: bytes
) -> Model:
    return build_model(robot, effects, tolerance=tolerance)


def _find_meant_effects(choices: Sequence[EffectChoice]) -> tuple[Effect, ...]:
    """Return the effects themselves: one of the user's own may have been registered anew under its name."""
    return tuple(get_effect(choice.effect, f"/effects/{k}") for k, choice in enumerate(choices))


def _read_geometry(robot: Robot) -> bytes:
    """Return what the arrays hold that columns are built from."""
    arrays = [
        array
        for tree in (robot, robot.tree)
        for array in (tree.gravity, *(each for joint in tree.joints for each in (joint.placement, joint.axis)))
    ]
    return b"".join(np.asarray(array).tobytes() for array in arrays)


def check_columns(columns: Sequence[Column]) -> None:
    """Raise where an effect is chosen twice with the same columns."""
    keys = set()
    for column in columns:
        if column.key in keys:
            raise DynidentError(
                f"{column.effect} is chosen twice for {column.link or 'the robot'}; name it once", pointer="/effects"
            )
        keys.add(column.key)


def find_inertial_base_parameters(robot: Robot) -> BaseParameters:
    """Return the base inertial parameters of a robot: links alone, without rotors and friction."""
    signals = Signals(robot)
    return find_base_parameters(robot, build_columns([LINKS], signals), signals)


def is_in_run(signal: RunSignal, recording: Recording, segment: int) -> float:
    """Return whether a segment of a recording is one of a signal's runs, as a number.

    Parameters
    ----------
    signal : RunSignal
        Labels of runs, or none for recordings that are marked as carrying a payload.
    recording : Recording
        The recording.
    segment : int
        Number of the segment.

    Returns
    -------
    float
        1 if it is one of them, else 0.
    """
    if not signal.runs:
        return float(recording.payload is not None)
    return float(bool({recording.name, recording.name_segment(segment)} & set(signal.runs)))
