"""Draw postures that are free of obstacles and held with less than 90 % of the torque; usual home postures."""

from __future__ import annotations

import numpy as np

from dynident.array_types import FloatArray
from dynident.motion.limits.bounds import Bounds, ImpossibleLimitsError, TorqueModel
from dynident.robot.json_fields import make_pointer

# So many random postures leave some that are clear and can be held, even for arms in a narrow place.
_POSTURES = 2000
# Room left for motion around a posture: of the torque, and of the position range.
_HOLDING_SHARE = 0.9
CENTRAL_SHARE = 0.8
# Shares of the ranges around the usual home that are tried in this order where no posture of the whole is clear.
_NEARER_HOME = (0.5, 0.25, 0.12)
# Of the postures that are clear by their capsules, so many are looked at exactly.
_EXACT_POSTURES = 500
# Of half the range: as good as zero.
_NEAR_ZERO = 1e-5
# Postures whose way from home is looked at, and how many have to be reached: with fewer, the home itself is cut off.
_TRIED_WAYS, _ENOUGH_WAYS = 200, 5
_ALONG_A_WAY = np.linspace(0.0, 1.0, 25)


def compute_static_torque(model: TorqueModel, q: FloatArray) -> FloatArray:
    """Return the torque that holds postures.

    Parameters
    ----------
    model : TorqueModel
        Model that predicts the torque.
    q : (m, n)
        Postures, rad or m.

    Returns
    -------
    (m, n)
        Torque, N m or N.
    """
    still = np.zeros_like(q)
    return model.torque(q, still, still)


def draw_holdable_postures(bounds: Bounds, model: TorqueModel, rng: np.random.Generator) -> FloatArray:
    """Return random postures from which a motion can start.

    They are in the inner part of the position ranges, clear of all obstacles, and their weight leaves torque for
    motion. Where some of them can be reached from a usual home by a clear straight path, only these are returned: the
    others may lie where no motion gets to, like an elbow bent the other way.

    Parameters
    ----------
    bounds : Bounds
        Limits of the motion.
    model : TorqueModel
        Model that predicts the torque.
    rng : numpy.random.Generator
        Generator of the postures.

    Returns
    -------
    (m, n)
        At least one posture, rad or m.

    Raises
    ------
    ImpossibleLimitsError
        None of many postures is clear, or can be held; the message names what would touch, or the joint whose torque
        limit is in the way.
    """
    places = CENTRAL_SHARE * rng.uniform(-1.0, 1.0, (_POSTURES, len(bounds.names)))
    around = bounds.middle + bounds.half_range * places
    # Of many joints some pair collides in nearly every posture of the whole ranges, and in fewer near the usual home.
    home = list_usual_homes(bounds)[0]
    for share in _NEARER_HOME:
        if bounds.space is None or (bounds.space.compute_least_slack(around) >= 0).any():
            break
        around = np.clip(
            home + share * bounds.half_range * places,
            bounds.middle - CENTRAL_SHARE * bounds.half_range,
            bounds.middle + CENTRAL_SHARE * bounds.half_range,
        )
    q: FloatArray = _select_reachable(bounds, _select_clear(bounds, around))
    if not np.isfinite(bounds.torque).any():
        return q
    torque = np.abs(compute_static_torque(model, q))
    shares = torque / bounds.torque
    worst = shares.max(axis=1)
    # First those with torque left to accelerate, else those that can be held at all.
    for share in (_HOLDING_SHARE, 1.0 - 1e-6):
        if (worst <= share).any():
            held: FloatArray = q[worst <= share]
            return held
    # The easiest posture shows which joint fails even there.
    best = int(worst.argmin())
    joint = int(shares[best].argmax())
    name = bounds.names[joint]
    raise ImpossibleLimitsError(
        f"No posture can be held: in the easiest of {_POSTURES} the weight of the arm alone needs "
        f"{torque[best, joint]:.3g} from joint '{name}', whose torque limit is {bounds.torque[joint]:.3g}. Raise the "
        "limit, or widen the position limits to postures in which the arm needs less torque.",
        pointer=make_pointer(name, "effort", within="/limits"),
        title="Impossible limits",
    )


def list_usual_homes(bounds: Bounds) -> list[FloatArray]:
    """Return the usual home postures (n,): zero where the ranges contain it, and the middle of the ranges.

    A joint whose range does not contain zero is at its middle in both.
    """
    nearest = np.clip(0.0, bounds.position_low, bounds.position_high)
    return [np.where(np.abs(nearest) <= _NEAR_ZERO * bounds.half_range, nearest, bounds.middle), bounds.middle]


def _select_reachable(bounds: Bounds, q: FloatArray) -> FloatArray:
    """Return those of the first postures (m, n) that a clear straight path joins to a usual home.

    All postures are returned where hardly any is reached.
    """
    if bounds.space is None or bounds.space.constraints is None:
        return q
    candidates = q[:_TRIED_WAYS]
    for home in list_usual_homes(bounds):
        # A home that is blocked itself says nothing of the postures.
        if bounds.space.compute_least_slack(home[None])[0] < 0:
            continue
        ways = home + _ALONG_A_WAY[:, None, None] * (candidates - home)
        slack = (
            bounds.space.compute_least_slack(ways.reshape(-1, q.shape[1])).reshape(len(_ALONG_A_WAY), -1).min(axis=0)
        )
        if np.count_nonzero(slack >= 0) >= _ENOUGH_WAYS:
            reached: FloatArray = candidates[slack >= 0]
            return reached
    return q


def _select_clear(bounds: Bounds, q: FloatArray) -> FloatArray:
    """Return those of postures q (m, n) that are clear of all obstacles."""
    if bounds.space is None:
        return q
    slack = bounds.space.compute_least_slack(q)
    if (slack >= 0).any():
        clear: FloatArray = q[slack >= 0]
        # Capsules do not tell of bodies that are so near each other that theirs always overlap.
        first = clear[:_EXACT_POSTURES]
        is_blocked = bounds.space.find_blocked(first)
        return clear if is_blocked.all() or not is_blocked.any() else first[~is_blocked]
    clearest = q[int(slack.argmax())]
    complaint = bounds.space.find_complaint(clearest[None]) or bounds.space.describe_narrowness(clearest)
    raise ImpossibleLimitsError(
        f"None of {_POSTURES} postures within the position limits is free of collisions: in the best of them, "
        + complaint,
        pointer="/limits" if bounds.space.contacts is None and bounds.space.tool is None else "/surroundings",
        title="Impossible limits",
    )
