"""Signals of the tree that carries the links of a machine with dependent joints."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import casadi as ca

from dynident.effects.closed_loops import TreeMotion
from dynident.effects.effect import Column
from dynident.effects.prediction import DRIVE_PARAMETERS
from dynident.effects.signals import MemorySignal, RunSignal, Signals
from dynident.expressions.angles import substitute_angles


class TreeSignals(Signals):
    """Signals of the tree that carries a machine's links; `columns` projects results to the driven joints.

    Parameters
    ----------
    owner : Signals
        Signals of the driven joints; time, runs, hysteresis states and directions of friction are shared with it.
    """

    def __init__(self, owner: Signals) -> None:
        linkage = owner.robot.linkage
        assert linkage is not None
        # Symbols of its own for the motion of the tree; `to_driven` puts the motion of the driven joints in their
        # place.
        super().__init__(linkage.tree)
        self._owner = owner
        self.time, self.period = owner.time, owner.period
        count = linkage.tree.n
        # Temperatures are recorded for driven joints. Any other joint takes that of the first one that moves it.
        movers = [min(linkage.get_movers(j), default=0) for j in range(count)]
        self.temperature = owner.temperature[movers]
        prediction = owner.predicted
        # Motors sit on the driven joints alone: the other joints' drive parameters are zero.
        drives = ca.SX(count, len(DRIVE_PARAMETERS))
        drives[list(linkage.driven), :] = ca.horzcat(
            *(prediction.get_drive_parameter(name) for _, name in DRIVE_PARAMETERS)
        )
        self.reference = ca.vertcat(prediction.inertia, ca.vec(drives))
        self.motion = TreeMotion(linkage, (owner.q, owner.dq, owner.ddq, owner.dddq, owner.ddddq))
        # Hysteresis states count joints in the order of `Robot.positions`: the driven ones first.
        places = [*linkage.driven, *linkage.passive]
        self._place = [places.index(j) for j in range(count)]

    @classmethod
    def for_machine(cls, owner: Signals) -> TreeSignals:
        """Return the tree's signals for the machine of `owner`; they are built once."""
        if owner.of_tree is None:
            owner.of_tree = cls(owner)
        assert isinstance(owner.of_tree, cls)
        return owner.of_tree

    def to_driven(self, expression: ca.SX) -> ca.SX:
        """Return an expression of the tree's motion as an expression of the driven joints' motion."""
        used = {symbol.name() for symbol in ca.symvar(expression)}
        names = ("dq", "ddq", "dddq", "ddddq")
        used_names = [name for name in names if any(s.name() in used for s in ca.symvar(getattr(self, name)))]
        symbols = [getattr(self, name) for name in used_names]
        # Positions with their cosines and sines, which the closed loops have computed already.
        if any(s.name() in used for s in ca.symvar(self.q)):
            expression = substitute_angles(expression, self.q, self.motion.turns)
        if not symbols:
            return expression
        # Only derivatives that occur are substituted: the others, up to the fourth, need not even be built.
        value: ca.SX = ca.substitute(
            [expression], symbols, [ca.densify(getattr(self.motion, name)) for name in used_names]
        )[0]
        return value

    def sign_of(self, velocity: ca.SX) -> ca.SX:
        """Return the direction of friction at a relative velocity of the tree's joints."""
        return self._owner.sign_of(self.to_driven(velocity))

    def in_runs(self, signal: RunSignal) -> ca.SX:
        """Return the symbol SX (1, 1) that is 1 in the signal's runs."""
        return self._owner.in_runs(signal)

    def memory(self, signal: MemorySignal) -> ca.SX:
        """Return the symbol SX (1, 1) of a hysteresis state."""
        # The state of a path does not depend on who asks: it is kept by the machine's own signals.
        return self._owner.memory(replace(signal, joint=self._place[signal.joint]))

    def project_columns(self, tree_columns: Sequence[Column]) -> list[Column]:
        """Return columns of the tree as columns of the driven joints."""
        # All columns at once: they share most of their subexpressions.
        if not tree_columns:
            return []
        torques = self.motion.project_torque(self.to_driven(ca.horzcat(*(column.torque for column in tree_columns))))
        return [
            replace(
                column,
                torque=ca.sparsify(torque),
                energy=None if column.energy is None else partial(self._to_driven_part, column.energy),
                wrench=None if column.wrench is None else partial(self._to_driven_part, column.wrench),
            )
            for column, torque in zip(tree_columns, ca.horzsplit(torques), strict=True)
        ]

    def _to_driven_part(self, part: Callable[[], ca.SX]) -> ca.SX:
        return self.to_driven(part())
