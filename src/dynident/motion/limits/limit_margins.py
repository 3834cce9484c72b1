"""How near a motion comes to each limit, and the largest amplitude that keeps all of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dynident.array_types import FloatArray
from dynident.motion.collision.constraint_slack import Balance, LoopConstraints, word_fall, word_singularity, word_slip
from dynident.motion.collision.exact_distances import Approach, word_contact
from dynident.motion.collision.free_space import FreeSpace
from dynident.motion.joint_trajectories import Family, Motion
from dynident.motion.limits.bounds import Bounds, ImpossibleLimitsError, TorqueModel
from dynident.motion.limits.postures_within_limits import CENTRAL_SHARE

# Twelve halvings give the amplitude to a four-thousandth; six of a motion that is only compared, to a sixtieth.
_BISECTIONS, _COARSE_BISECTIONS = 12, 6
# Between so many samples a wave of the highest frequency exceeds its value at them by less than a thousandth.
_SAMPLES_PER_WAVE = 80


class AmplitudeScaler:
    """Scales the coefficients of a family to the largest amplitude at which they keep the limits.

    Parameters
    ----------
    family : Family
        Family of trajectories.
    bounds : Bounds
        Limits of the motion.
    model : TorqueModel
        Model that predicts the torque.
    fine : bool
        Whether to look at the motion as closely as its highest frequency needs; coarse is for a first selection.
    """

    def __init__(self, family: Family, bounds: Bounds, model: TorqueModel, *, fine: bool = True) -> None:
        self._bounds, self._model = bounds, model
        self._bisections = _BISECTIONS if fine else _COARSE_BISECTIONS
        count = _SAMPLES_PER_WAVE * family.waves if fine else 2 * _SAMPLES_PER_WAVE
        self._basis = family.basis(np.arange(count) * family.period / count)[:4]

    def scale_down(self, x: FloatArray) -> FloatArray | None:
        """Return coefficients with the amplitude scaled to keep the limits.

        The centre (the offsets) stays, except that it is moved inside the position limits.

        Parameters
        ----------
        x : (m, n)
            Coefficients of the family.

        Returns
        -------
        (m, n) or None
            The scaled coefficients; None where no amplitude keeps the limits.
        """
        b = self._bounds
        scaled = x.copy()
        scaled[0] = np.clip(x[0], b.middle - CENTRAL_SHARE * b.half_range, b.middle + CENTRAL_SHARE * b.half_range)
        # A centre outside of the limits is moved well inside, since there would be no room to swing right at the limit.
        inside = (b.position_low < x[0]) & (x[0] < b.position_high)
        scaled[0, inside] = x[0, inside]
        # Position, velocity, acceleration and jerk are linear in the amplitude, so these limits give the scale
        # directly.
        q, dq, ddq, dddq = self._basis[:, :, 1:] @ scaled[1:]
        # A joint that is locked has neither room nor motion: 0 / 0.
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = min(
                1.0,
                float(np.nanmin((b.position_high - scaled[0]) / np.maximum(q.max(axis=0), 0.0))),
                float(np.nanmin((scaled[0] - b.position_low) / np.maximum(-q.min(axis=0), 0.0))),
                float((b.velocity / np.abs(dq).max(axis=0)).min()),
                float((b.acceleration / np.abs(ddq).max(axis=0)).min()),
                float((b.jerk / np.abs(dddq).max(axis=0)).min()),
            )
        amplitude = self._find_amplitude(scaled[0], q, dq, ddq, scale)
        if amplitude is None:
            return None
        scaled[1:] *= amplitude
        return scaled

    def _find_amplitude(
        self, centre: FloatArray, q: FloatArray, dq: FloatArray, ddq: FloatArray, most: float
    ) -> float | None:
        """Return the largest amplitude up to `most` that keeps torque, power, clearances and followers' limits."""
        bounds = self._bounds
        if not bounds.has_torque_limits and bounds.space is None:
            return most

        def keeps_limits(scale: float) -> bool:
            # Bodies scaled in amplitude by s at unchanged frequency: q̇ and q̈ scale alike.
            positions, velocities = centre + scale * q, scale * dq
            if bounds.has_torque_limits:
                torque = self._model.torque(positions, velocities, scale * ddq)
                if not ((np.abs(torque) <= bounds.torque) & (np.abs(torque * velocities) <= bounds.power)).all():
                    return False
            if not bounds.are_rates_and_balance_kept(positions, velocities, scale * ddq):
                return False
            return bounds.space is None or bool((bounds.space.compute_least_slack(positions) >= 0).all())

        if keeps_limits(most):
            return most
        # At amplitude zero the arm stands still at the centre: if that is not possible, no amplitude is.
        if not keeps_limits(0.0):
            return None
        low, high = 0.0, most
        # Torque and clearances are not linear in the amplitude: bisect. The lower end always keeps the limits.
        for count in range(_BISECTIONS):
            # A coarse search is over once it has an amplitude: a motion that has to be small is not lost.
            if count >= self._bisections and low > 0.0:
                break
            middle = 0.5 * (low + high)
            low, high = (middle, high) if keeps_limits(middle) else (low, middle)
        # Zero would be no motion at all.
        return low or None


LimitName = Literal[
    "position_min",
    "position_max",
    "velocity",
    "acceleration",
    "jerk",
    "torque",
    "power",
    "clearance",
    "tool_min",
    "tool_max",
    "condition",
    "balance",
    "friction",
]


@dataclass(frozen=True)
class Margin:
    """How near a motion comes to one limit.

    Parameters
    ----------
    joint : str
        Name of the joint; of a clearance the two bodies, of the tool's range the axis, of the condition the closed
        loops, of balance (centre of pressure from the edge of the support, m) and friction the feet.
    limit : str
        Kind of the limit.
    value : float
        Extreme value of the motion.
    bound : float
        The limit.
    share : float
        Used part of the room: 1 touches the limit. For a position it is counted from the middle of the range.
    """

    joint: str
    limit: LimitName
    value: float
    bound: float
    share: float

    @property
    def complaint(self) -> str:
        """What is wrong where the limit is broken, as a sentence."""
        if self.limit == "clearance":
            return word_contact(self.joint, self.value, self.bound)
        if self.limit in ("tool_min", "tool_max"):
            return f"The {self.joint} would go to {self.value:.4g} m, beyond the end {self.bound:g} m of its range."
        if self.limit in ("balance", "friction"):
            word = word_fall if self.limit == "balance" else word_slip
            return f"On {self.joint}, {word(self.value, self.bound)}"
        if self.limit == "condition":
            complaint = word_singularity(self.value, self.bound)
            return complaint[0].upper() + complaint[1:]
        return f"The {self.limit} limit {self.bound:g} of joint '{self.joint}' would be violated: {self.value:.4g}."


TorqueFunction = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""Nominal torque (m, n) at q, q̇, q̈ (m, n)."""


def compute_margins(bounds: Bounds, motions: Iterable[Motion], torque: TorqueFunction | None) -> tuple[Margin, ...]:
    """Return the margins of motions to every limit, joint by joint; motions are evaluated one after another.

    Parameters
    ----------
    bounds : Bounds
        Limits of all joints.
    motions : iterable of Motion
        Motions, or chunks of one; only one at a time is in memory.
    torque : callable or None
        Nominal torque (m, n) at q, q̇, q̈ (m, n); without it torque and power are not checked.

    Returns
    -------
    tuple of Margin
        Margins of the joints first, then of the surroundings.
    """
    n = len(bounds.names)
    low, high = np.full(n, np.inf), np.full(n, -np.inf)
    largest = np.zeros((5, n))
    around = _SurroundingsMargins(bounds.space)
    for motion in motions:
        # Only extremes are kept, so that motions of any length need no memory.
        low, high = np.minimum(low, motion.q.min(axis=0)), np.maximum(high, motion.q.max(axis=0))
        signals = [motion.dq, motion.ddq, motion.dddq]
        if torque is not None and bounds.has_torque_limits:
            load = torque(motion.q, motion.dq, motion.ddq)
            signals += [load, load * motion.dq]
        for row, values in enumerate(signals):
            largest[row] = np.maximum(largest[row], np.abs(values).max(axis=0))
        around.add_motion(motion)
    columns = _build_position_columns(bounds, low, high)
    names: tuple[LimitName, ...] = ("velocity", "acceleration", "jerk", "torque", "power")
    known = (bounds.velocity, bounds.acceleration, bounds.jerk, bounds.torque, bounds.power)
    for name, value, bound in zip(names, largest, known, strict=True):
        columns.append((name, value, bound, _clip_share(value / bound, value <= bound)))
    # The legs that stand do not move: only their torque comes near a limit.
    held = () if bounds.balance is None else bounds.balance.held_names
    of_joints = tuple(
        Margin(name, limit, float(values[j]), float(bound[j]), float(shares[j]))
        for j, name in enumerate(bounds.names)
        for limit, values, bound, shares in columns
        if np.isfinite(bound[j]) and name not in held
    )
    return of_joints + around.collect_margins()


_Column = tuple[LimitName, FloatArray, FloatArray, FloatArray]


def _build_position_columns(bounds: Bounds, low: FloatArray, high: FloatArray) -> list[_Column]:
    middle, half = bounds.middle, bounds.half_range
    low_share = _clip_share((middle - low) / half, low >= bounds.position_low)
    high_share = _clip_share((high - middle) / half, high <= bounds.position_high)
    return [
        ("position_min", low, bounds.position_low, low_share),
        ("position_max", high, bounds.position_high, high_share),
    ]


def _clip_share(share: FloatArray, is_within: NDArray[np.bool_]) -> FloatArray:
    """Return shares of which none is above 1 by rounding alone."""
    # Whether a limit is kept was decided on the values themselves; the share only follows.
    return np.where(is_within, np.minimum(share, 1.0), np.maximum(share, np.nextafter(1.0, 2.0)))


class _SurroundingsMargins:
    """Nearest approaches to the surroundings and extreme positions of tool and followers, over several motions."""

    def __init__(self, space: FreeSpace | None) -> None:
        self._space = space
        self._approaches: list[Approach] = []
        self._low, self._high = np.full(3, np.inf), np.full(3, -np.inf)
        self._followers = None if space is None or space.loops is None else _FollowerMargins(space.loops)
        self._balance = None if space is None or space.balance is None else _BalanceMargins(space.balance)

    def add_motion(self, motion: Motion) -> None:
        """Take a motion into account."""
        if self._space is None:
            return
        q = motion.q
        if self._followers is not None:
            self._followers.add_motion(motion)
        if self._balance is not None:
            self._balance.add_motion(motion)
        if self._space.contacts is not None:
            approaches = self._space.contacts.find_approaches(q)
            before = self._approaches or approaches
            self._approaches = [
                # The order of the bodies is the same for all motions, so that approaches can be compared pair by pair.
                min(pair, key=lambda approach: approach.slack)
                for pair in zip(before, approaches, strict=True)
            ]
        if self._space.tool is not None:
            tool = self._space.locate_tool(q)
            self._low, self._high = np.minimum(self._low, tool.min(axis=0)), np.maximum(self._high, tool.max(axis=0))

    def collect_margins(self) -> tuple[Margin, ...]:
        """Return the margins of every body, and of every stated end of the tool's range."""
        if self._space is None:
            return ()
        margins = [] if self._followers is None else self._followers.collect_margins()
        margins += [] if self._balance is None else self._balance.collect_margins()
        margins += [
            Margin(
                approach.name,
                "clearance",
                approach.distance,
                approach.wanted,
                approach.wanted / approach.distance if approach.distance > 0 else np.inf,
            )
            for approach in self._approaches
        ]
        tool = self._space.tool
        if tool is not None:
            reached_ends = zip(self._low, self._high, strict=True)
            for axis, low, high, reached in zip("xyz", tool.low, tool.high, reached_ends, strict=True):
                # With one end alone there is no range that a share could be of: a metre takes its place.
                size = 1.0 if low is None or high is None else 0.5 * (high - low)
                if low is not None:
                    share = max(0.0, 1.0 - (reached[0] - low) / size)
                    margins.append(Margin(f"tool {axis}", "tool_min", float(reached[0]), low, share))
                if high is not None:
                    share = max(0.0, 1.0 - (high - reached[1]) / size)
                    margins.append(Margin(f"tool {axis}", "tool_max", float(reached[1]), high, share))
        return tuple(margins)


class _FollowerMargins:
    """Extreme positions and rates of follower joints, and the worst condition of closed loops, over several motions."""

    def __init__(self, loops: LoopConstraints) -> None:
        self._loops, self._worst = loops, 0.0
        self._fastest = np.zeros((2, 0 if loops.rated is None else len(loops.rated.names)))
        self._low, self._high = np.full(len(loops.names), np.inf), np.full(len(loops.names), -np.inf)

    def add_motion(self, motion: Motion) -> None:
        """Take a motion of the driven joints into account."""
        q = motion.q
        if self._loops.rated is not None:
            self._fastest = np.maximum(self._fastest, self._loops.rated.find_largest(q, motion.dq, motion.ddq))
        at = self._loops.compute_positions(q)
        self._low, self._high = np.minimum(self._low, at.min(axis=0)), np.maximum(self._high, at.max(axis=0))
        self._worst = max(self._worst, float(self._loops.compute_conditions(q).max()))

    def collect_margins(self) -> list[Margin]:
        """Return the margins of every limited joint, and of the loops."""
        low, high = self._loops.low, self._loops.high
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        ends: tuple[tuple[LimitName, FloatArray, FloatArray, FloatArray], ...] = (
            ("position_min", self._low, low, _clip_share((middle - self._low) / half, self._low >= low)),
            ("position_max", self._high, high, _clip_share((self._high - middle) / half, self._high <= high)),
        )
        margins = [
            Margin(name, limit, float(reached[k]), float(bound[k]), float(share[k]))
            for k, name in enumerate(self._loops.names)
            for limit, reached, bound, share in ends
        ]
        rated = self._loops.rated
        if rated is not None:
            kinds: tuple[LimitName, ...] = ("velocity", "acceleration")
            for kind, reached, bound in zip(kinds, self._fastest, (rated.velocity, rated.acceleration), strict=True):
                shares = _clip_share(reached / bound, reached <= bound)
                margins += [
                    Margin(name, kind, float(reached[k]), float(bound[k]), float(shares[k]))
                    for k, name in enumerate(rated.names)
                    if np.isfinite(bound[k])
                ]
        closure, largest = self._loops.linkage.closure, self._loops.largest_condition
        if closure is not None:
            names = ", ".join(loop.name for loop in closure.loops)
            margins.append(Margin(names, "condition", self._worst, largest, self._worst / largest))
        return margins


class _BalanceMargins:
    """Smallest distance of the centre of pressure from the edge, friction and torque of standing legs, over motions."""

    def __init__(self, balance: Balance) -> None:
        self._balance = balance
        self._distance, self._friction = np.inf, 0.0
        self._torque = np.zeros(len(balance.held_names))

    def add_motion(self, motion: Motion) -> None:
        """Take a motion into account, and rest in each of its postures."""
        still = np.zeros_like(motion.q)
        for rates in ((motion.dq, motion.ddq), (still, still)):
            extremes = self._balance.measure(motion.q, *rates)
            self._distance = min(self._distance, extremes.distance)
            self._friction = max(self._friction, extremes.friction)
            self._torque = np.maximum(self._torque, extremes.torque)

    def collect_margins(self) -> list[Margin]:
        """Return the margins of balance, friction, and each limited joint of the legs."""
        standing, limits = self._balance.standing, self._balance.torque_limits
        feet = ", ".join(standing.feet)
        # Without a stated margin, the edge itself must not be crossed: a share of nothing.
        used = standing.margin / self._distance if self._distance > 0 else np.inf
        shares = _clip_share(self._torque / limits, self._torque <= limits)
        return [
            Margin(feet, "balance", self._distance, standing.margin, used),
            Margin(feet, "friction", self._friction, standing.friction, self._friction / standing.friction),
            *(
                Margin(name, "torque", float(self._torque[k]), float(limits[k]), float(shares[k]))
                for k, name in enumerate(self._balance.held_names)
                if np.isfinite(limits[k])
            ),
        ]


def find_tightest(margins: Sequence[Margin]) -> Margin:
    """Return the margin with the largest share."""
    return max(margins, key=lambda margin: margin.share)


def are_limits_kept(margins: Sequence[Margin]) -> bool:
    """Return whether no limit is broken."""
    return find_tightest(margins).share <= 1.0


def build_limit_error(margins: Sequence[Margin]) -> ImpossibleLimitsError:
    """Return the error that names the limit that is broken most."""
    worst = find_tightest(margins)
    # The pointer leads to the part of the request that has to change.
    places = dict.fromkeys(("clearance", "tool_min", "tool_max"), "/surroundings")
    places |= dict.fromkeys(("balance", "friction"), "/standing")
    place = places.get(worst.limit, "/limits")
    return ImpossibleLimitsError(worst.complaint, pointer=place, title="Impossible limits")
