"""Each way in which an effect or an estimator may break what others rely on is told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import casadi as ca
import numpy as np
import pytest

from dynident.array_types import FloatArray
from dynident.effects import CATALOGUE, Effect, ParameterSpec, ShapeSpec, Signals, UsualSize
from dynident.identification.methods.estimator_options import Weighted
from dynident.testing import ConformanceError, check_effect, check_estimator


class Good(Effect):
    """A torque in q̇ (1 + q²): what the others below break."""

    id = "of_the_test"
    title = "Friction that grows to the sides"
    formula = r"F \dot q (1 + q^2)"
    parameters = (ParameterSpec("Fx", "N m s/rad", "at the middle", positive=True),)
    signature = "viscous friction that depends on the position"
    sources = ("this test",)
    is_friction = True

    def columns(self, signals, joints, shape):
        spec = self.parameters[0]
        return [self._column(signals, spec, j, self.torque(signals, j)) for j in joints]

    def torque(self, signals, j):
        return signals.dq[j] * (1 + signals.q[j] ** 2)


def test_an_effect_that_keeps_to_it_passes_and_is_not_left_in_the_catalogue() -> None:
    before = list(CATALOGUE)
    told = check_effect(Good)
    assert told[-1].startswith("found again"), told
    assert list(CATALOGUE) == before


class Nameless(Good):
    signature = ""


class Stranger(Good):
    def torque(self, signals, j):
        return signals.dq[j] * ca.SX.sym("gain")


class Loaded(Good):
    def torque(self, signals, j):
        return signals.load[j] * signals.dq[j]


class Infinite(Good):
    def torque(self, signals, j):
        return signals.dq[j] / ca.fabs(signals.dq[j])


class Driving(Good):
    def torque(self, signals, j):
        return -signals.dq[j]


class Short(Good):
    def columns(self, signals, joints, shape):
        return super().columns(signals, joints[:1], shape)


class Boastful(Good):
    parameters = (ParameterSpec("Fx", "N m s/rad", "at the middle", role="damping"),)


class NoBody(Good):
    """Twice the moment of inertia of a link."""

    parameters = (ParameterSpec("XX", "kg m²", "of the link", role="link"),)

    def columns(self, signals, joints, shape):
        return [
            self._reaching_column(signals, self.parameters[0], j, 2 * signals.mechanics.rows[:, 10 * j]) for j in joints
        ]


class Leaking(Good):
    """Half the energy of a spring."""

    parameters = (ParameterSpec("Fx", "N m/rad", "stiffness"),)

    def columns(self, signals, joints, shape):
        q = signals.q
        return [
            self._column(signals, self.parameters[0], j, q[j], energy=partial(ca.SX, 0.25 * q[j] ** 2)) for j in joints
        ]


class Unfit(Good):
    shapes = (ShapeSpec("p", "-", "exponent", 1.0),)

    def grid(self, robot, joint):
        return [{"p": -1.0}]


class Lost(Good):
    confused_with = ("nothing_that_there_is",)


class Impossible(Good):
    def usual(self, robot, joint):
        return UsualSize({"Fx": -1.0})


class Moody(Good):
    """Another function in a simulator than in W."""

    def torque(self, signals, j):
        return super().torque(signals, j) * (1.0 if type(signals) is Signals else ca.sin(9 * signals.q[j]) ** 2)


@pytest.mark.parametrize(
    ("effect", "why"),
    [
        (Nameless, "does not define its signature"),
        (Stranger, "depend on gain"),
        (Loaded, "predicted torque .signals.load.; state needs_load = True"),
        (Infinite, "are not finite everywhere .standstill included"),
        (Driving, "its column drives the motion"),
        (Short, "sit on"),
        (Boastful, "has the role damping, but its column differs"),
        (NoBody, "has the role link, but its column differs"),
        (Leaking, "does not change by the power of its torque"),
        (Unfit, "p = -1.0 of of_the_test is not admitted by its own ShapeSpec"),
        (Lost, "names 'nothing_that_there_is', which is not another effect"),
        (Impossible, "usual.. of of_the_test gives Fx < 0"),
        (Moody, "its columns do not match the torque of the robot"),
    ],
)
def test_what_is_wrong_with_an_effect_is_said(effect: type[Effect], why: str) -> None:
    with pytest.raises(ConformanceError, match=why):
        check_effect(effect)


@dataclass(frozen=True)
class Changed(Weighted):
    """Weighted least squares with something else in its answer."""

    values: Callable[[FloatArray], FloatArray] = field(default=lambda x: x)
    covariance: Callable[[FloatArray], FloatArray] = field(default=lambda c: c)

    def solve(self, problem):
        fit = super().solve(problem)
        return replace(
            fit,
            solution=replace(fit.solution, values=self.values(fit.solution.values)),
            statistics=replace(fit.statistics, covariance=self.covariance(fit.statistics.covariance)),
        )


@dataclass(frozen=True)
class Spoiling(Weighted):
    """Weighted least squares that does not leave the data alone."""

    def solve(self, problem):
        for equation in problem.data.equations.equations:
            equation.whole_factor[:] *= 2.0
        return super().solve(problem)


DRAWN = np.random.default_rng()


@pytest.mark.parametrize(
    ("estimator", "why"),
    [
        (Changed(values=lambda x: 1.2 * x), "from that of the true parameters"),
        (Changed(values=lambda x: x[:-1]), "estimates for"),
        (Changed(values=lambda x: np.full_like(x, np.nan)), "not finite"),
        (Changed(values=lambda x: x * DRAWN.normal(1, 1e-4, len(x))), "other estimates the second time"),
        (Changed(covariance=lambda c: c + np.triu(c, 1)), "not symmetric"),
        (Changed(covariance=lambda c: -c), "negative"),
        (Changed(covariance=np.ones_like), "times as large"),
        (Spoiling(), "changed the data"),
    ],
)
def test_what_is_wrong_with_an_estimator_is_said(estimator, why: str) -> None:
    with pytest.raises(ConformanceError, match=why):
        check_estimator(estimator)
