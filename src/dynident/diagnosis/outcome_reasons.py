"""The reason why a candidate is or is not a finding: its code and values, and the sentence for each code."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

from dynident.effects import EffectChoice, get_effect
from dynident.number_format import format_percent

ReasonCode = Literal[
    "accepted",
    "equivalent",
    "explained",
    "not_significant",
    "too_small",
    "not_determined",
    "impossible",
    "unstable",
    "only_at_reversals",
    "superfluous",
    "not_resolved",
    "harmful",
    "misnamed",
    "no_help_once_added",
    "not_confirmed",
    "cannot_be_added",
    "most_effects",
    "undetermined_model",
    "passed_over",
    "not_tried",
]


@dataclass(frozen=True)
class Reason:
    """Why a candidate is a finding, or why it is none.

    Parameters
    ----------
    code : str
        Kind of the reason, such as "too_small".
    step : int, optional
        Rank of the finding that it refers to: its own for one that is accepted.
    values : tuple of (str, float or str)
        Numbers and names that belong to the code, by name; shares are fractions.
    """

    code: ReasonCode
    step: int | None = None
    values: tuple[tuple[str, float | str], ...] = ()

    @classmethod
    def build(cls, code: ReasonCode, step: int | None = None, **values: float | str) -> Reason:
        """Build a reason with its values given by name.

        Parameters
        ----------
        code : str
            Kind of the reason.
        step : int, optional
            Rank of the finding that it refers to.
        **values : float or str
            Values that belong to the code.
        """
        return cls(code, step, tuple(sorted(values.items())))

    @property
    def text(self) -> str:
        """The reason as a sentence, with the size that would have shown where that is known."""
        values = dict(self.values)
        text = _SENTENCES[self.code](self.step, values)
        if "limit" in values:
            unit = "" if values["unit"] == "-" else f" {values['unit']}"
            constants = f" ({values['constants']})" if "constants" in values else ""
            text += f" These recordings would show it from {_number(values['limit'])}{unit} on{constants}."
        return text

    @property
    def brief(self) -> str:
        """The reason in a few words, for a table: "too small", "explained by step 1"."""
        if self.code not in _BRIEF:
            return self.code.replace("_", " ")
        return f"{_BRIEF[self.code]} {'another finding' if self.step is None else f'step {self.step}'}"

    def __str__(self) -> str:
        return self.text

    def __repr__(self) -> str:
        return f"Reason({self.code}: {self.text})"


@dataclass(frozen=True)
class CandidateOutcome:
    """What became of an effect on some joints: its best candidate there, and the reason.

    Parameters
    ----------
    choice : EffectChoice
        The effect with its joints and the shape constants that fit best there.
    error_drop : float
        Share of the error on blocks left out of the fit that it removes beside everything that was found.
    reason : Reason
        Why it is a finding or not.
    """

    choice: EffectChoice
    error_drop: float
    reason: Reason


def find_outcome(outcomes: tuple[CandidateOutcome, ...], effect: str, joint: str = "") -> CandidateOutcome | None:
    """Return the outcome of an effect on a joint; without a joint that of its best place.

    A group of joints answers for each of its joints, and an effect of the whole robot for all.
    """
    own = [outcome for outcome in outcomes if outcome.choice.effect == effect]
    here = [outcome for outcome in own if not joint or not outcome.choice.joints or joint in outcome.choice.joints]
    # What was accepted answers first, then the joint by itself, then a group with this joint.
    return min(
        here,
        key=lambda outcome: (
            outcome.reason.code != "accepted",
            bool(joint) and outcome.choice.joints != (joint,),
            -outcome.error_drop,
        ),
        default=None,
    )


_FEW_JOINTS = 6


def describe_place(joints: Sequence[str]) -> str:
    """Return the names of an effect's joints in words for a sentence; of many joints their number."""
    return (", ".join(joints) if len(joints) <= _FEW_JOINTS else f"{len(joints)} joints") or "the whole robot"


def describe_choice(choice: EffectChoice) -> str:
    """Return an effect and its place in words, to be named in a reason."""
    return f"{get_effect(choice.effect).title} on {describe_place(choice.joints)}"


def build_too_small(measure: str, value: float, least: float) -> Reason:
    """Return the reason that a candidate removes too little of something.

    Parameters
    ----------
    measure : str
        What it has to remove a share of, a key of `_MEASURES`.
    value : float
        The share that it removes.
    least : float
        The share that it has to remove.
    """
    return Reason.build("too_small", measure=measure, share=value, least=least)


_MEASURES = MappingProxyType(
    {
        "error": "the error of its joints on blocks left out of the fit",
        "squared_error": "the squared error, on blocks left out of the fit, of the joint that it helps most",
        "noise": "the power of the sensor noise",
        "runs": "the squared error of the runs that it acts in",
        "joint": "the squared error of one of the joints that it has to act on",
        "moving": "the error on blocks left out of the fit, where joints move",
    }
)
"""What the size of a candidate is measured against."""

Values = Mapping[str, float | str]


def _word_finding(step: int | None, values: Values) -> str:
    by = str(values.get("by", "another finding"))
    return by if step is None else f"step {step} ({by})"


def _word_accepted(step: int | None, _values: Values) -> str:
    return "Accepted." if step is None else f"Accepted as step {step}."


def _word_equivalent(step: int | None, values: Values) -> str:
    return f"These data cannot distinguish it from {_word_finding(step, values)}."


def _word_explained(step: int | None, values: Values) -> str:
    return (
        f"Explained by {_word_finding(step, values)}: after it was added, {_percent(values['left'])} of what this "
        "effect removes by itself remains."
    )


def _word_not_significant(_step: int | None, values: Values) -> str:
    if float(values["p"]) > float(values["level"]):
        return f"Not significant: p = {_number(values['p'])}, and the level is {_number(values['level'])}."
    return (
        f"Not significant by itself: t = {_number(values['t'])} of its gain on blocks left out of the fit; "
        f"{_number(values['least_t'])} is required."
    )


def _word_too_small(_step: int | None, values: Values) -> str:
    share = max(float(values["share"]), 0.0)
    measure = _MEASURES[str(values["measure"])]
    return f"Too small: it removes {_percent(share)} of {measure}; {_percent(values['least'], 1)} is required."


def _word_not_determined(_step: int | None, values: Values) -> str:
    return (
        f"Not determined by this motion: {_percent(values['share'])} of its column is independent of the model; "
        f"{_percent(values['least'], 1)} is required for a gain like this."
    )


def _word_impossible(_step: int | None, values: Values) -> str:
    if "parameter" not in values:
        return "Physically impossible: with it, the joint's friction would drive the motion."
    value = f"{values['parameter']} would be {_number(values['value'])} {values['unit']}"
    return f"Physically impossible: {value}, which is {values['violates']}."


def _word_unstable(_step: int | None, values: Values) -> str:
    return (
        f"Not stable: it comes first in {_percent(values['share'])} of the resampled data; "
        f"{_percent(values['least'], 1)} is required."
    )


def _word_not_confirmed(_step: int | None, values: Values) -> str:
    share = float(values["share"])
    change = "grows" if share < 0.0 else f"falls by {_percent(share)} of what it would if all of it were right"
    return (
        f"Held-out recordings do not confirm it: their squared error {change}; {_percent(values['least'], 1)} is "
        "required."
    )


_SENTENCES: Mapping[ReasonCode, Callable[[int | None, Values], str]] = MappingProxyType(
    {
        "accepted": _word_accepted,
        "equivalent": _word_equivalent,
        "explained": _word_explained,
        "not_significant": _word_not_significant,
        "too_small": _word_too_small,
        "not_determined": _word_not_determined,
        "impossible": _word_impossible,
        "unstable": _word_unstable,
        "only_at_reversals": lambda step, values: (
            f"It lowers the error at reversals only: where joints move by {_percent(values['share'])}; "
            f"{_percent(values['least'], 1)} is required."
        ),
        "superfluous": lambda step, values: "Superfluous: with the other findings it no longer helps enough.",
        "not_resolved": lambda step, values: (
            "Its best shape constant is finer than the filtered position resolves: its name is not certain."
        ),
        "harmful": lambda step, values: (
            "It makes the prediction of runs, or of parts of the run, that were left out of the fit worse."
        ),
        "misnamed": lambda step, values: (
            "Once it is in the model, the residual still depends on the same variable: the cause is another one."
        ),
        "no_help_once_added": lambda step, values: (
            "It explains a part of the residual, but no longer once the model is identified with it: the motion "
            "hardly determines the torque that it depends on."
        ),
        "not_confirmed": _word_not_confirmed,
        "cannot_be_added": lambda step, values: f"It cannot be added: {values['detail']}",
        "most_effects": lambda step, values: (
            f"The largest number of effects, {_number(values['most'])}, was reached before it."
        ),
        "undetermined_model": lambda step, values: (
            "This motion does not determine the model, and it explains too little to be named all the same."
        ),
        "passed_over": lambda step, values: (
            "The search ended before this effect was tested again. It still passes after the findings were added: "
            "diagnose the extended model."
        ),
        "not_tried": lambda step, values: f"Not tried: {values['why']}.",
    }
)


_BRIEF: Mapping[ReasonCode, str] = MappingProxyType(
    {"accepted": "accepted as", "equivalent": "not distinguishable from", "explained": "explained by"}
)
"""Words before the step that a reason refers to."""


def _percent(value: float | str, digits: int = 2) -> str:
    # Two digits tell a share apart from a threshold near it, which has one or ends in 5.
    return format_percent(float(value), digits)


def _number(value: float | str) -> str:
    return f"{float(value):.3g}"
