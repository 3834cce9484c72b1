"""Every threshold that a candidate has to pass to be a finding, with its meaning and reason.

Only the default significance level is elsewhere (`diagnosis/candidates/significance.py`).
"""

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

    A user sets `significance` and `max_effects` with the request. The others are properties of recordings and of
    arms: they hold for all. `list_levels` has the description of each.
    """

    # fmt: off
    significance: float = _declare_level(0.01, "-",
        "Largest p-value of a finding, for all candidates together",
        "The probability that anything is named if nothing is missing", "placebo")
    max_effects: float = _declare_level(100, "-",
        "Largest number of findings, without contacts",
        "The search ends when no candidate passes: only who wants fewer sets fewer")
    least_error_drop: float = _declare_level(0.02, "-",
        "Share of the error on left-out blocks, in N m, that an effect must remove on its joints",
        "Nobody would notice less")
    least_gain_over_noise: float = _declare_level(0.08, "-",
        "Power that an effect must remove, as a share of the power of the sensor noise",
        "Less does not matter in practice; up to a quarter, most names are still right", "smallest_gain")
    least_gain_at_reversals: float = _declare_level(0.3, "-",
        "The same for effects that act where a joint reverses",
        "Small errors of the filtered signals there are of that size")
    most_of_block: float = _declare_level(3.0, "-",
        "Error of a block, relative to a usual block, above which its gain counts no more",
        "A single block with half of all the error must not decide")
    more_for_parameters: float = _declare_level(0.2, "-",
        "Share by which a candidate with more parameters must gain more, to replace a simpler one however unevenly it "
        "gains over the blocks",
        "Candidates with more parameters gain something by these alone")
    least_separability: float = _declare_level(0.02, "-",
        "Share of a candidate's column that must be independent of the model",
        "Below this, the data do not show the effect at all")
    least_reach: float = _declare_level(0.25, "-",
        "Share of a candidate's column that is independent of the model, times the t of its gain",
        "At this value, the uncertainty of its parameter can cause a torque elsewhere of four times the removed one",
        "smallest_gain")
    least_drop_in_runs: float = _declare_level(0.5, "-",
        "Share of the squared error that an effect of some runs alone must remove",
        "The motions of two runs differ, too: parameters of one run alone compensate for what the model lacks")
    least_drop_of_change: float = _declare_level(0.1, "-",
        "The same for an effect of the later recordings, in a comparison of two days",
        "Only one group of runs is tried, not every group")
    shadow: float = _declare_level(0.05, "-",
        "Gain of another effect, as a share of the gain of an effect with an approximate formula, below which it "
        "is taken for the error of this formula",
        "A curve that is wrong by a fifth leaves so much, and its error resembles many effects")
    quiet: float = _declare_level(1e-4, "-",
        "Share of the squared error that is assumed as noise if the torque has none",
        "Simulations have no noise")
    joint_drop: float = _declare_level(0.03, "-",
        "Share of its own squared error that each joint of a group must gain, and each finding when all others "
        "are in the model",
        "A finding or a joint gains less beside all others than by itself")
    clear_t: float = _declare_level(2.0, "-",
        "t of a gain, of a difference of two gains or of a parameter of the wrong sign from which on it counts",
        "One in forty by chance", "equal_terms")
    staying_t: float = _declare_level(1.0, "-",
        "t from which on a joint stays in a group that contains most joints",
        "Five of six such gains are not chance; without it, a recorded UR10e loses the slip of a joint")
    own_drop: float = _declare_level(0.1, "-",
        "Share of the residual under a group's constants that a joint's own constants must remove",
        "Less may be the difference between the values of the grid; without it, a recorded UR10e loses friction of a "
        "joint", "joints_of_a_group")
    sure_t: float = _declare_level(2.5, "-",
        "t of the gain of a finding when all others are in the model, and of a joint's own constants",
        "One in a hundred by chance, and some twelve findings are tested", "joints_of_a_group")
    found_again: float = _declare_level(0.9, "-",
        "Share of the resamples of blocks, and of the runs left out, in which a name must come first again",
        "A name that one draw in ten changes is not certain")
    as_much_as_change: float = _declare_level(0.9, "-",
        "Share of the gain of a change that friction by temperature must explain, to replace the change",
        "Then nothing need have changed")
    still_gains: float = _declare_level(0.5, "-",
        "Share of its gain that a candidate must keep beside another effect, to be a second effect and not a "
        "rival",
        "Two names of the same cause leave little of each other")
    equal_gain: float = _declare_level(0.97, "-",
        "Share of the gain of a finding from which on another name is equivalent",
        "Shape constants between the values of the grid change a gain as much")
    equal_t: float = _declare_level(1.5, "-",
        "t of the difference below which another name is equivalent",
        "One in fifteen by chance; without it, a mass on a link is named a spring that explains as much")
    contends: float = _declare_level(0.7, "-",
        "Share of the chosen name's gain from which on a name is compared with finer constants",
        "A coarse constant costs up to a quarter of a gain; with 0.8, one of seven right names that gained less "
        "on the grid was lost", "equal_terms")
    same_gain: float = _declare_level(0.01, "-",
        "Difference of two gains with finer constants, as a share, that counts as none",
        "Half a step of the constants costs up to half of this, and each is the best of many", "equal_terms")
    harm: float = _declare_level(1.005, "-",
        "Ratio of the errors after and before, of a joint or of all, from which on an increase is noticed",
        "Half a per cent of the error")
    harm_t: float = _declare_level(3.5, "-",
        "t of the increase of a joint's error from which on it is more than chance",
        "Some forty joints and findings are tested: by chance in one of fifty diagnoses")
    confirmed: float = _declare_level(0.5, "-",
        "Share of the squared torque that a finding predicts of held-out rows by which it must lower their squared "
        "error",
        "1 if all of it is right, 0 if half of it is. Effects of three real arms had 0.7 and more, false names on "
        "simulated hobby arms 0.4 and less; a true one on a messy arm had 0.32, so some are lost")
    rows_of_filter: float = _declare_level(10.0, "rows",
        "Number of filtered rows that count as one independent row",
        "Filtered rows are correlated")
    part_to_part: float = _declare_level(1.6, "-",
        "Error on a left-out part of the motion, or on held-out data, over that of the fit",
        "1.0 to 1.25 on sound data, 1.6 to 3 if the motion is too poor to determine the model")
    main_explanation: float = _declare_level(0.5, "-",
        "Share of the squared error that an effect must explain if the motion is too poor",
        "On a clean delta robot, accepted candidates explained 0.03; friction hidden on a passive joint explained "
        "0.91 to 0.95")
    few_waves: float = _declare_level(6.0, "waves a turn",
        "Number of waves below which a ripple resembles a polynomial of the position",
        "Joints turn by less than a whole turn")
    left_over: float = _declare_level(0.12, "-",
        "Share of the removed error that may remain as the same kind of function",
        "If more remains, it is another function")
    much_left_over: float = _declare_level(1.5, "-",
        "The same for any effect of one joint and any variable",
        "The rest is then larger than what the effect explained")
    rival_gain: float = _declare_level(0.7, "-",
        "Share of the gain of a finding from which on an effect that is easily confused with it is a rival, for which "
        "an experiment is designed",
        "A power law with an exponent between the values of the grid gained 0.78 of Stribeck friction, which was "
        "named instead")
    most_blind: float = _declare_level(0.5, "-",
        "Share of the usual effects whose detection limit may be above their usual size",
        "If more than half would not have shown, it says little that nothing was found")
    adequate_over_noise: float = _declare_level(4.0, "-",
        "Largest residual of a moving joint under an adequate model, over the sensor's noise",
        "Up to 1.9 in 72 clean cases, up to 3.8 if arms dwell at many points", "clean_residuals")
    # fmt: on

    @property
    def least_drop(self) -> float:
        """Share of the squared error that an effect must remove on the joint that it improves most."""
        return 1.0 - (1.0 - self.least_error_drop) ** 2

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
