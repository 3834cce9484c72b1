"""The model that is to be identified: effects on a robot, their base parameters, and the W that belongs to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dynident.effects import Column, EffectChoice, Signals, columns_of, effect_by_id
from dynident.errors import DynidentError
from dynident.regressors.base_parameters import DEFAULT_TOLERANCE, BaseParameters, base_parameters
from dynident.regressors.observation import Observation
from dynident.robot.model import FloatArray, Robot


@dataclass(frozen=True, eq=False)
class Model:
    """Chosen effects on one robot.

    `columns` are those of all standard parameters; `base` says which are kept and how the others group into them;
    `observation` is W for the kept ones, in the order of `base.kept`.
    """

    robot: Robot
    effects: tuple[EffectChoice, ...]
    signals: Signals
    columns: tuple[Column, ...]
    base: BaseParameters
    observation: Observation

    @property
    def kept(self) -> tuple[Column, ...]:
        """Columns of the base parameters."""
        return self.observation.columns

    @property
    def n_parameters(self) -> int:
        """Number of base parameters b."""
        return self.base.count

    @property
    def needs_load(self) -> bool:
        """Whether a column rests on the load torque that the rigid body predicts."""
        return any(effect_by_id(choice.effect).needs_load for choice in self.effects)

    @property
    def absorbed(self) -> tuple[Column, ...]:
        """Columns of effects other than the links' and rotors' inertia that dissolve in the base parameters."""
        inertial = ("rigid_body", "rotor_inertia")
        kept = set(self.base.kept)
        return tuple(c for k, c in enumerate(self.columns) if k not in kept and c.effect not in inertial)

    def standard_inertia(self, values: FloatArray) -> FloatArray:
        """Standard inertial parameters (10 n,) with these base parameters (b,), nearest to the description's.

        The base parameters determine the torque; of all standard parameters that give them, those nearest to the
        description's are taken, since effects that reach beyond the base parameters (a tilted base) need a choice.
        """
        rigid = [k for k, column in enumerate(self.columns) if column.effect == "rigid_body"]
        nominal = np.zeros(10 * self.robot.n)
        if self.robot.inertias is not None:
            nominal = self.robot.inertias.reshape(-1).astype(np.float64)
        if not rigid:
            return nominal
        if len(rigid) != 10 * self.robot.n:
            full = np.zeros(10 * self.robot.n)
            for k, position in enumerate(self.base.kept):
                column = self.columns[position]
                if column.effect == "rigid_body":
                    full[self._standard_index(column)] = values[k]
            return full
        inertial = [k for k, column in enumerate(self.kept) if column.effect in ("rigid_body", "rotor_inertia")]
        grouping = self.base.grouping[np.ix_(inertial, rigid)]
        seen = np.any(self.base.written[np.ix_(inertial, rigid)], axis=1)
        gap = values[inertial][seen] - grouping[seen] @ nominal
        return nominal + np.linalg.pinv(grouping[seen]) @ gap

    def _standard_index(self, column: Column) -> int:
        link = self.robot.joint_names.index(column.link)
        names = [spec.name for spec in effect_by_id("rigid_body").parameters]
        return 10 * link + names.index(column.parameter)


def build_model(
    robot: Robot,
    effects: Sequence[EffectChoice],
    *,
    tolerance: float = DEFAULT_TOLERANCE,
    signals: Signals | None = None,
) -> Model:
    """Build the model of effects on a robot.

    Parameters
    ----------
    robot : Robot
    effects : sequence of EffectChoice
    tolerance : float
        Share of a column that may be left beside the others for it to count as dependent on them.
    signals : Signals, optional
        Those of another model of the same robot: its mechanics need not be derived again.

    Raises
    ------
    DynidentError
        For an unknown effect, an unfit joint, an effect chosen twice with the same columns, or no effect at all.
    """
    if not effects:
        raise DynidentError("choose at least one effect, for instance rigid_body", pointer="/effects")
    signals = signals or Signals(robot)
    columns = columns_of(effects, signals)
    seen: dict[tuple[str, tuple[tuple[str, float], ...]], int] = {}
    for column in columns:
        key = (f"{column.effect}.{column.name}", column.shape)
        if key in seen:
            raise DynidentError(
                f"{column.effect} is chosen twice for {column.link or 'the robot'}; name it once", pointer="/effects"
            )
        seen[key] = 1
    base = base_parameters(robot, columns, signals, tolerance=tolerance)
    observation = Observation.of(robot, [columns[k] for k in base.kept], signals)
    return Model(robot, tuple(effects), signals, tuple(columns), base, observation)


def inertial_base_parameters(robot: Robot, *, tolerance: float = DEFAULT_TOLERANCE) -> BaseParameters:
    """The base inertial parameters of a robot: links alone, without rotors and friction."""
    signals = Signals(robot)
    return base_parameters(robot, columns_of([EffectChoice("rigid_body")], signals), signals, tolerance=tolerance)
