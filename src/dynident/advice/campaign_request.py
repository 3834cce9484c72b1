"""The request of a campaign: goal, robot time, what every motion must keep to; and how long its runs may be.

Holds the default search (2 starts, 6 s at most) and the fewest runs (2).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

from dynident.errors import DynidentError
from dynident.excitation.criteria.criterion_choice import REGION_SPEED
from dynident.excitation.design_request import (
    DesignRequest,
    TrajectoryRequest,
    compute_least_sampling_rate,
    compute_planned_seconds,
)
from dynident.identification.identification_choices import IdentificationChoices
from dynident.number_format import format_count, format_number, format_percent
from dynident.schema.fields import Choice, OneOf, Request, declare_field

DESIGN_STARTS, DESIGN_SECONDS = 2, 6.0
"""Starts of the search for a motion and its longest time, s, where neither is stated: in 9 searches four starts found a
motion that promises more once, and two searches for a Panda with its fingers take 11 to 18 s of processor time."""
DecisionCode = Literal["next_run", "reached", "not_reachable", "out_of_time"]
# Shares of the requested length that a run may have as well. The ends of a shorter run than the second are most of it:
# filters take some tenths of a second from either.
_SHARES = (0.25, 0.5)
_SHORTEST_RUN = 2.0

FEWEST_RUNS = 2
"""Runs before a goal counts as reached: the model has to have predicted a run that it was not fitted to."""
LONGEST_CAMPAIGN = 10_000
"""Largest robot time of a campaign, min: a week."""
GOALS = OneOf(
    Choice("torque", "predicted torque", "The torque of every joint over a region of states, to within the error."),
    Choice("parameters", "parameters", "The named base parameters, each to within the error."),
    Choice("effects", "effects", "Named effects are found, or would have shown at their usual size."),
    Choice("payload", "payload", "Mass and centre of a load on the last link, each to within its own error."),
)


MOTION_WORDS = {
    "duration": "Duration of one period of the longest run, without the moves from and to home; a run may take half or "
    "a quarter of it",
    "periods": "Number of periods of the longest run",
    "time_budget": f"Time limit of each search for a motion; by default {DESIGN_SECONDS:g}, if no number of starts is "
    "stated",
    "starts": f"Number of starts of each search for a motion; by default {DESIGN_STARTS}, or as many as the time "
    "allows",
}
"""What options of a design mean in a campaign, where that is something else than for a single design."""

LOAD_QUANTITIES = {"mass": "Mp", "centre_x": "MXp", "centre_y": "MYp", "centre_z": "MZp"}
"""What can be known of a load, with the parameter of the effect `payload` that tells it."""


MEASURES = {
    "torque": ("Relative error of the predicted torque, worst joint", "worst joint"),
    "parameters": ("Half-width of the 95 % interval over the value, worst parameter", "worst parameter"),
    "effects": ("Smallest size that would have shown over the usual size, worst effect", "worst effect"),
    "payload": ("Half-width of the 95 % interval over the one asked for, worst quantity", "worst quantity"),
}
"""What the errors of each goal are, and what the worst one is of."""


@dataclass(frozen=True)
class CampaignRequest(Request):
    """What a campaign is to reach, and what it may cost.

    Parameters
    ----------
    goal : str
        What is to be known, one of `GOALS`.
    error : float
        Largest relative error of the predicted torque of any joint, or of any named parameter, with 95 % probability.
    parameters : tuple of str
        For the goal "parameters": names of the base parameters.
    decide : tuple of str
        For the goal "effects": ids of the effects.
    quantities : tuple of str
        For the goal "payload": what of the load is to be known, of `LOAD_QUANTITIES`.
    mass_error : float
        Half-width of the 95 % interval of the mass, kg.
    centre_error : float
        Half-width of the 95 % interval of each coordinate of the centre, m.
    unloaded_runs : int
        For the goal "payload": runs that are made before the load is mounted.
    speed : float
        Share of the velocity and acceleration limits up to which the torque is to be predicted.
    minutes : float
        Robot time of all runs together, min.
    runs : int
        Largest number of runs.
    first_speed : float
        Share of the velocity limits that the first run keeps to.
    choices : IdentificationChoices
        How the model is identified.
    design : DesignRequest
        What every motion must keep to: duration, rate, limits, surroundings, home.
    """

    goal: str = declare_field("Goal of the campaign", default="torque", kinds=GOALS)
    error: float = declare_field(
        "Largest relative error of the predicted torque of any joint, or of any named parameter; 0.05 is 5 %",
        default=0.05,
        option="--error",
        above=0,
        at_most=1,
    )
    parameters: tuple[str, ...] = declare_field(
        "For the goal parameters: names of base parameters", default=(), option="--parameter", most=1000
    )
    decide: tuple[str, ...] = declare_field(
        "For the goal effects: ids of the effects whose presence is to be decided", default=(), most=100
    )
    quantities: tuple[str, ...] = declare_field(
        "For the goal payload: mass, centre_x, centre_y or centre_z, in the frame of the last joint",
        default=("mass",),
        option="--quantity",
        most=4,
    )
    mass_error: float = declare_field(
        "For the goal payload: half-width of the 95 % interval of the mass", default=0.1, unit="kg", above=0
    )
    centre_error: float = declare_field(
        "For the goal payload: half-width of the 95 % interval of each coordinate of its centre",
        default=0.01,
        unit="m",
        above=0,
    )
    unloaded_runs: int = declare_field(
        "For the goal payload: runs that are made before the load is mounted", default=2, at_least=1, at_most=100
    )
    speed: float = declare_field(
        "Share of the velocity and acceleration limits up to which the torque is to be predicted; 0.5 is half",
        default=REGION_SPEED,
        above=0,
        at_most=1,
    )
    minutes: float = declare_field(
        "Robot time of all runs together", default=10.0, unit="min", above=0, at_most=LONGEST_CAMPAIGN
    )
    runs: int = declare_field("Largest number of runs", default=100, at_least=1, at_most=10_000)
    first_speed: float = declare_field(
        "Share of the velocity limits that the first run keeps to", default=0.3, above=0, at_most=1
    )
    choices: IdentificationChoices = declare_field(made_by=IdentificationChoices)
    design: DesignRequest = declare_field(made_by=DesignRequest)

    @property
    def fewest_runs(self) -> int:
        """Runs before the goal can be reached."""
        return self.unloaded_runs + 1 if self.goal == "payload" else FEWEST_RUNS

    @property
    def largest_error(self) -> float:
        """The error at which the goal is reached; of effects and payloads, 1 is what was asked for."""
        return 1.0 if self.goal in ("effects", "payload") else self.error


def describe_first_run(goal: str) -> str:
    """Return what is to be done before the first run."""
    return "Make the first run: nothing is known yet." + (" Leave the load off." if goal == "payload" else "")


def describe_broken_promise(promised: float, left: float, name: str) -> str:
    """Return a sentence on a run that left a larger error than promised."""
    return (
        f" The run brought less than promised: {format_percent(left)} on {name}, where {format_percent(promised)} or "
        "less was promised."
    )


def word_larger_error(goal: str) -> str:
    """Return the errors of a goal that may be larger, as an alternative to more time; "" of effects."""
    return {"effects": "", "payload": " or a larger mass_error or centre_error"}.get(goal, " or a larger error")


def word_share(goal: str, error: float) -> str:
    """Return an error in words; of a load it is a share of the uncertainty that was asked for."""
    return format_percent(error) + (" of the uncertainty asked for" if goal == "payload" else "")


def list_targets(request: CampaignRequest, joints: tuple[str, ...]) -> tuple[str, ...]:
    """Return what the errors of a campaign are of: joints, parameters, effects or quantities of a load, by name.

    Parameters
    ----------
    request : CampaignRequest
        What is to be reached.
    joints : tuple of str
        Names of the robot's joints.
    """
    named = {"parameters": request.parameters, "effects": request.decide, "payload": request.quantities}
    return named.get(request.goal, joints)


@dataclass(frozen=True)
class Decision:
    """What to do next, and why.

    Parameters
    ----------
    code : {"next_run", "reached", "not_reachable", "out_of_time"}
        What to do.
    sentence : str
        Why, in words for the user.
    """

    code: DecisionCode
    sentence: str

    @property
    def is_end(self) -> bool:
        """Whether the campaign is over."""
        return self.code != "next_run"


NOTHING_DECIDED = Decision("next_run", "")


def limit_search(design: DesignRequest) -> DesignRequest:
    """Return a design with the default search of a campaign where neither starts nor a time are stated."""
    if design.time_budget is None and design.starts is None:
        return replace(design, starts=DESIGN_STARTS, time_budget=DESIGN_SECONDS)
    return design


def list_designs(longest: DesignRequest) -> tuple[DesignRequest, ...]:
    """Return the designs of runs of several lengths, the shortest first, the requested one last.

    Fewer whole periods come first, then a shorter one. The highest frequency stays where there are more harmonics or
    intervals than usual. Moves from point to point have one length, and so has what would be too fast for the sampling.

    Parameters
    ----------
    longest : DesignRequest
        The requested design.
    """
    return (*_iterate_shorter_designs(longest), longest)


def _iterate_shorter_designs(longest: DesignRequest) -> Iterator[DesignRequest]:
    trajectory = longest.trajectory
    if trajectory.family == "point_to_point":
        return
    for share in _SHARES:
        periods = max(1, math.floor(share * trajectory.periods))
        shortening = min(1.0, share * trajectory.periods / periods)
        if shortening * trajectory.duration * periods < _SHORTEST_RUN:
            continue
        shorter = replace(
            trajectory,
            duration=shortening * trajectory.duration,
            periods=periods,
            harmonics=_shorten_count(trajectory.harmonics, TrajectoryRequest.harmonics, shortening),
            intervals=_shorten_count(trajectory.intervals, TrajectoryRequest.intervals, shortening),
        )
        if compute_least_sampling_rate(shorter) <= shorter.sampling_rate:
            yield replace(longest, trajectory=shorter)


def _shorten_count(count: int, usual: int, shortening: float) -> int:
    return max(min(count, usual), math.ceil(shortening * count))


def select_longest(
    designs: tuple[DesignRequest, ...], seconds: float, following: int, moves: float = 0.0
) -> DesignRequest:
    """Return the longest design that leaves time for the runs that have to follow, or else the shortest.

    Parameters
    ----------
    designs : tuple of DesignRequest
        The designs, the shortest first.
    seconds : float
        Time that is left, s.
    following : int
        Number of runs that have to follow; they may be the shortest.
    moves : float
        Time of the moves of a run from and to home, s.
    """
    reserve = max(following, 0) * (compute_planned_seconds(designs[0]) + moves)
    return next((d for d in designs[::-1] if compute_planned_seconds(d) + moves <= seconds - reserve), designs[0])


def estimate_rest(now: float, promised: float, goal: float, duration: float, runs: int) -> tuple[float, float]:
    """Return by how many runs a goal is missed, and the robot time until it is reached, s, by runs like a planned one.

    What a run tells, in 1 / error², adds up over runs. One run is enough where it reaches the goal.

    Parameters
    ----------
    now, promised, goal : float
        Errors before and after the planned run, and the one that is wanted.
    duration : float
        Time of the planned run, s, its moves from and to home included.
    runs : int
        Number of runs that are left.
    """
    if promised <= goal:
        return 0.0, duration
    before, then, enough = (error**-2 for error in (max(now, goal), promised, goal))
    count = (enough - before) / (then - before) if then > before else math.inf
    return max(count - runs, 0.0), count * duration


def check_time(request: CampaignRequest) -> None:
    """Raise `DynidentError` where the time or the number of runs is too small for what has to be made."""
    run, given = compute_planned_seconds(list_designs(request.design)[0]), 60.0 * request.minutes
    fewest = request.fewest_runs if request.goal == "payload" else 1
    if fewest * run > given or fewest > request.runs:
        runs = "one run takes" if fewest == 1 else f"{fewest} runs, the last with the load, take"
        raise DynidentError(
            f"{runs} {fewest * run:g} s, and all together may take {given:g} s in {format_count(request.runs, 'run')}; "
            "give more minutes, more runs or shorter ones",
            pointer="/minutes",
        )


def check_time_with_moves(request: CampaignRequest, first: float, moves: float) -> None:
    """Raise `DynidentError` where the time is too small once the first motion is designed, and with it the moves.

    Parameters
    ----------
    request : CampaignRequest
        The request.
    first : float
        Time of the first run with its moves, s.
    moves : float
        Time of the moves of a run from and to home, s.
    """
    following, given = request.fewest_runs - 1 if request.goal == "payload" else 0, 60.0 * request.minutes
    needed = first + following * (compute_planned_seconds(list_designs(request.design)[0]) + moves)
    if needed > given:
        runs = f"{following + 1} runs, the last with the load, take {format_number(needed)} s with their"
        if not following:
            slow = format_percent(request.first_speed)
            runs = f"The first run, at {slow} of the velocity limits, takes {format_number(needed)} s with its"
        raise DynidentError(
            f"{runs} moves from and to home, and all runs together may take {format_number(given)} s; give more "
            "minutes or shorter runs.",
            pointer="/minutes",
        )
