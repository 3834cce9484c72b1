"""All levels of the decision: what a candidate has to reach to be a finding, each with its meaning and its reason."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from inspect import cleandoc


@dataclass(frozen=True)
class Level:
    """Description of a level of the decision.

    Parameters
    ----------
    name : str
        Name of the field of `DecisionRules`.
    value : float
        The value that is in use.
    unit : str
        Unit of the value; "-" for shares and ratios.
    meaning : str
        What is compared with it.
    reason : str
        Why it has its value.
    script : str
        The benchmark that calibrates it; empty where it is a matter of judgement.
    """

    name: str
    value: float
    unit: str
    meaning: str
    reason: str
    script: str = ""


def _declare_level(default: float, unit: str, meaning: str, reason: str, script: str = "") -> float:
    level: float = field(
        default=default, metadata={"unit": unit, "meaning": meaning, "reason": reason, "script": script}
    )
    return level


@dataclass(frozen=True)
class DecisionRules:
    """Every level of the decision what is missing in a model.

    A user sets `significance` and `most_effects` with the request. The others are properties of recordings and of
    arms: they hold for all. `list_levels` has the description of each.
    """

    # fmt: off
    significance: float = _declare_level(0.01, "-",
        "Largest p-value of a finding, among all that is tried together",
        "How often anything at all may be named where nothing is missing", "placebo")
    most_effects: float = _declare_level(12, "-",
        "Largest number of findings, contacts not counted",
        "Two for each joint of a usual arm: a search ends where nothing more passes, this only bounds its time")
    least_error_drop: float = _declare_level(0.02, "-",
        "Share of the held-out error, in N m, that an effect removes where it is said to be",
        "Less nobody would notice")
    least_drop: float = _declare_level(0.04, "-",
        "The same as a share of the squared error of the joint that it helps most",
        "Twice the share of the error, which is its root")
    least_gain_over_noise: float = _declare_level(0.08, "-",
        "Share of the sensor noise's own power that an effect removes",
        "Less is no matter to anybody; up to a quarter most names are right ones still", "smallest_gain")
    least_gain_at_reversals: float = _declare_level(0.3, "-",
        "The same for effects that show where a joint reverses",
        "Small errors of the filtered signals there are of that size")
    most_of_block: float = _declare_level(3.0, "-",
        "Error of a block, over a usual one's, above which its gain counts no more",
        "One block with half of all the error must not decide")
    much_more: float = _declare_level(0.2, "-",
        "Share of its gain by which a candidate beats a simpler one, however unevenly",
        "Candidates with more parameters gain something by these alone")
    hardly_more: float = _declare_level(0.02, "-",
        "Share of its gain by which a candidate does not beat a simpler one, however evenly",
        "Constants between those of the grid cost as much")
    least_separability: float = _declare_level(0.02, "-",
        "Share of a column that is left beside the model",
        "Below, the data do not show the effect at all")
    least_reach: float = _declare_level(0.25, "-",
        "Share of a column that is left beside the model, times the t of what it gains",
        "What a parameter leaves open makes one over this as much torque elsewhere as the candidate removes here",
        "smallest_gain")
    blurred_separability: float = _declare_level(0.2, "-",
        "Share of a sensitivity's column that is left beside the model below which it has to gain much",
        "Its parameter reaches far beyond what the data say")
    blurred_drop: float = _declare_level(0.25, "-",
        "Share of the squared error that such a sensitivity removes",
        "What is hardly separable has to gain much")
    least_drop_in_runs: float = _declare_level(0.5, "-",
        "Share of the squared error that an effect of some runs alone removes",
        "The motions of two runs differ, too: parameters of one run alone make up for what the model lacks")
    least_drop_of_change: float = _declare_level(0.1, "-",
        "The same for what the later runs have",
        "It is asked of these runs alone, not of every group of runs")
    shadow: float = _declare_level(0.05, "-",
        "Share of what an effect of a rough formula explains that anything beside it explains",
        "A curve that is off by a fifth of itself leaves so much, and it looks like many things")
    quiet: float = _declare_level(1e-4, "-",
        "Share of the squared error that serves as noise where the torque has none",
        "Simulations have no noise")
    joint_drop: float = _declare_level(0.03, "-",
        "Share of its own squared error that each joint of a group gains, and a finding beside all others",
        "What a finding or a joint adds beside all others is smaller than what it explains by itself")
    joint_t: float = _declare_level(2.0, "-",
        "t of the gain of a joint of a group",
        "One in forty by chance")
    large_joint_drop: float = _declare_level(0.3, "-",
        "Share of its error from which on a smaller t of a joint will do",
        "An effect that shows at few places is there all the same")
    large_joint_t: float = _declare_level(1.5, "-",
        "t of the gain of a joint that gains so much",
        "One in fifteen by chance, and the gain is large")
    staying_t: float = _declare_level(1.0, "-",
        "t from which on a joint stays in a group that most joints are in",
        "Five of six such gains are none of chance")
    own_drop: float = _declare_level(0.1, "-",
        "Share of what a group's constants leave on a joint that constants of its own remove",
        "Less may be no more than that a group's constants lie between the values of the grid", "joints_of_a_group")
    own_t: float = _declare_level(2.5, "-",
        "t of what constants of its own gain on a joint",
        "One in a hundred by chance", "joints_of_a_group")
    one_by_one: float = _declare_level(1.3, "-",
        "Times its gain that the joints of a group would gain each by itself for it to be dropped",
        "A group is one effect with common constants")
    staying_finding_t: float = _declare_level(2.5, "-",
        "t of the gain of a finding beside all others",
        "One in a hundred by chance: some twelve findings are asked")
    found_again: float = _declare_level(0.9, "-",
        "Share of the resamples of blocks, and runs left out, in which a name comes first again",
        "A name that one draw of the blocks in ten changes is not sure")
    more_for_parameters: float = _declare_level(0.2, "-",
        "Share by which a candidate with more parameters gains more to take the place of a simpler one",
        "Candidates with more parameters gain something by these alone")
    as_much_as_change: float = _declare_level(0.9, "-",
        "Share of what a change explains that warmth explains to replace it",
        "It leaves nothing that need have changed")
    still_gains: float = _declare_level(0.5, "-",
        "Share of its gain that a candidate keeps beside another effect to be one beside it, and no rival",
        "Two names of the same thing leave little of each other")
    equal_gain: float = _declare_level(0.97, "-",
        "Share of the gain of a finding from which on another name is as good",
        "Constants between those of the grid cost as much")
    equal_t: float = _declare_level(1.5, "-",
        "t of the difference below which another name is as good",
        "One in fifteen by chance")
    contends: float = _declare_level(0.7, "-",
        "Share of the chosen name's gain from which on a name contends with finer constants",
        "A coarse constant costs up to a quarter of a gain; 0.8 lost one of seven right names that lagged behind",
        "equal_terms")
    same_gain: float = _declare_level(0.01, "-",
        "Share of a gain by which finer constants may differ and say as much",
        "Half a step off costs up to half of this, and each is the best of many", "equal_terms")
    apart_t: float = _declare_level(2.0, "-",
        "t of the difference from which on blocks tell two names apart",
        "One in forty by chance", "equal_terms")
    harm: float = _declare_level(1.005, "-",
        "Times the error of a joint, or of all, from which on anybody would notice that it grew",
        "A two hundredth of the error is noticed")
    harm_t: float = _declare_level(3.5, "-",
        "t of a joint's larger error from which on it is more than chance",
        "Some forty joints and findings are looked at: one in fifty diagnoses would show it")
    given_back: float = _declare_level(0.1, "-",
        "Share of the work that friction may give back",
        "Filters and other errors make some of it")
    wrong_sign: float = _declare_level(2.0, "standard deviations",
        "From which on a parameter of the wrong sign counts",
        "One in forty by chance")
    rows_of_filter: float = _declare_level(10.0, "rows",
        "Filtered rows that are worth one",
        "Filtered rows are correlated: each is worth a tenth")
    part_to_part: float = _declare_level(1.6, "-",
        "Error on a part of the motion that was left out in a row, or on held-out data, over that of the fit",
        "1.0-1.25 on sound data, 1.6-3 where the motion is too poor to determine the model")
    main_explanation: float = _declare_level(0.5, "-",
        "Share of the squared error that an effect explains to be named where the motion is too poor",
        "On a clean delta robot what passed explained 0.03; friction hidden on a passive joint 0.91-0.95")
    few_waves: float = _declare_level(6.0, "waves a turn",
        "Below which a polynomial of the position says much the same",
        "Joints turn by less than a whole turn")
    left_over: float = _declare_level(0.12, "-",
        "Share of what an effect removed that may be left as the same kind of function",
        "More, and it is another function")
    much_left_over: float = _declare_level(1.5, "-",
        "The same for any effect of one joint and any variable",
        "What is left is larger than what the effect explained")
    rival_gain: float = _declare_level(0.95, "-",
        "Share of the gain of a finding from which on a candidate is a rival that an experiment decides",
        "What a simulated model gets wrong elsewhere shifts gains by some percent")
    uneven_rival_gain: float = _declare_level(0.8, "-",
        "The same where blocks disagree which gains more",
        "Where blocks agree which gains more, it is decided already")
    rival_t: float = _declare_level(2.0, "-",
        "t of the difference below which blocks disagree",
        "One in forty by chance")
    confused_rival_gain: float = _declare_level(0.7, "-",
        "The same for effects that the catalogue says are confused with each other",
        "A power law that no grid value met took Stribeck's name at 0.78 of its gain")
    most_blind: float = _declare_level(0.5, "-",
        "Share of the usual effects whose detection limit may be above their usual size",
        "Where more than half would not have shown, that nothing was found says little")
    adequate_over_noise: float = _declare_level(4.0, "-",
        "Times the sensor's noise that an adequate model leaves where a joint moves, at most",
        "Up to 1.9 in 72 clean cases, up to 3.8 where arms dwell at many points", "clean_residuals")
    # fmt: on

    def list_levels(self) -> Iterator[Level]:
        """Yield the levels with their descriptions, in the order of the decision."""
        for each in fields(self):
            yield Level(each.name, float(getattr(self, each.name)), **each.metadata)


def _describe_parameters() -> str:
    """Return the section of the docstring on the parameters, from the fields themselves."""
    rows = []
    for level in DecisionRules().list_levels():
        unit = "" if level.unit == "-" else f" ({level.unit})"
        script = f" (`benchmarks/{level.script}.py`)" if level.script else ""
        rows.append(f"{level.name} : float\n    {level.meaning}{unit}. {level.reason}{script}.")
    return "\n".join(("Parameters", "----------", *rows))


# Each level is described once, beside its value.
DecisionRules.__doc__ = f"{cleandoc(DecisionRules.__doc__ or '')}\n\n{_describe_parameters()}\n"

RULES = DecisionRules()
"""The levels where no request sets others."""
