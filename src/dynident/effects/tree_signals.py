"""The signals of the tree that carries the links of a machine whose joints are not all free."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import casadi as ca

from dynident.effects.effect import Column
from dynident.effects.linked import TreeMotion
from dynident.effects.prediction import DRIVE_PARAMETERS
from dynident.effects.signals import MemorySignal, RunSignal, Signals
from dynident.expressions.angles import turned


class TreeSignals(Signals):
    """Signals of the tree that carries a machine's links; what is made of them is seen from its driven joints.

    Parameters
    ----------
    owner : Signals
        Of the driven joints; time, runs, hysteresis states and directions of friction are the same.
    """

    def __init__(self, owner: Signals) -> None:
        linkage = owner.robot.linkage
        assert linkage is not None
        super().__init__(linkage.tree)
        self._owner = owner
        self.time, self.period = owner.time, owner.period
        count = linkage.tree.n
        movers = [min(linkage.movers(j), default=0) for j in range(count)]
        self.temperature = owner.temperature[movers]
        told = owner.predicted
        drives = ca.SX(count, len(DRIVE_PARAMETERS))
        drives[list(linkage.driven), :] = ca.horzcat(*(told.drive(name) for _, name in DRIVE_PARAMETERS))
        self.reference = ca.vertcat(told.inertia, ca.vec(drives))
        self.motion = TreeMotion(linkage, (owner.q, owner.dq, owner.ddq, owner.dddq, owner.ddddq))
        # Where `Robot.positions` has the joints.
        places = [*linkage.driven, *linkage.passive]
        self._place = [places.index(j) for j in range(count)]

    @classmethod
    def of(cls, owner: Signals) -> TreeSignals:
        """Those of the machine of `owner`, made once."""
        if owner.of_tree is None:
            owner.of_tree = cls(owner)
        assert isinstance(owner.of_tree, cls)
        return owner.of_tree

    def seen(self, expression: ca.SX) -> ca.SX:
        """An expression of the tree's motion as one of the driven joints' motion."""
        used = {symbol.name() for symbol in ca.symvar(expression)}
        names = ("dq", "ddq", "dddq", "ddddq")
        mine = [name for name in names if any(s.name() in used for s in ca.symvar(getattr(self, name)))]
        own = [getattr(self, name) for name in mine]
        if any(s.name() in used for s in ca.symvar(self.q)):
            expression = turned(expression, self.q, self.motion.turns)
        if not own:
            return expression
        seen: ca.SX = ca.substitute([expression], own, [ca.densify(getattr(self.motion, name)) for name in mine])[0]
        return seen

    def sign_of(self, velocity: ca.SX) -> ca.SX:
        """The direction of friction at a relative velocity of the tree's joints."""
        return self._owner.sign_of(self.seen(velocity))

    def in_runs(self, signal: RunSignal) -> ca.SX:
        """SX (1, 1): the symbol that is 1 in the signal's runs."""
        return self._owner.in_runs(signal)

    def memory(self, signal: MemorySignal) -> ca.SX:
        """SX (1, 1): the symbol of a hysteresis state."""
        return self._owner.memory(replace(signal, joint=self._place[signal.joint]))

    def columns(self, made: Sequence[Column]) -> list[Column]:
        """Columns of the tree as columns of the driven joints."""
        if not made:
            return []
        torques = self.motion.lowered(self.seen(ca.horzcat(*(column.torque for column in made))))
        return [
            replace(
                column,
                torque=ca.sparsify(torque),
                energy=None if column.energy is None else partial(self._seen_part, column.energy),
                wrench=None if column.wrench is None else partial(self._seen_part, column.wrench),
            )
            for column, torque in zip(made, ca.horzsplit(torques), strict=True)
        ]

    def _seen_part(self, part: Callable[[], ca.SX]) -> ca.SX:
        return self.seen(part())
