"""Models, strategies and estimators by the names that are typed."""

from __future__ import annotations

from typing import TypeVar, get_args

from dynident.errors import DynidentError
from dynident.estimation import CovarianceName
from dynident.identification.choices import EstimatorName, ModelName, PriorName, StepsName, StrategyName
from dynident.validation import Method

_Word = TypeVar("_Word", bound=str)


def method_of(model: str, strategy: str, steps: str, estimator: str, prior: str) -> Method:
    """The method of the options of that name; whether it is available is for the identification to say.

    Raises
    ------
    DynidentError
        With the option that holds no such word.
    """
    return Method(
        model=_word(model, get_args(ModelName), "model"),
        strategy=_word(strategy, get_args(StrategyName), "strategy"),
        estimator=_word(estimator, get_args(EstimatorName), "estimator"),
        prior=_word(prior, get_args(PriorName), "prior") if prior else None,
        steps=_word(steps, get_args(StepsName), "steps"),
    )


def covariance_of(covariance: str) -> CovarianceName:
    """What of the residuals is correlated, by the option of that name.

    Raises
    ------
    DynidentError
        Where it holds no such word.
    """
    return _word(covariance, get_args(CovarianceName), "covariance")


def methods_of(given: list[str]) -> tuple[Method, ...] | None:
    """Methods as `model/strategy/estimator`, each left out or a word of its kind: `filtered`, `sequential/ols`, ….

    Raises
    ------
    DynidentError
        With the word that is none of these.
    """
    texts = [item.strip() for text in given for item in text.split(",") if item.strip()]
    return tuple(_method(text) for text in texts) or None


def _method(text: str) -> Method:
    found: dict[str, str] = {}
    for word in text.split("/"):
        kind = next((name for name, words in _KINDS.items() if word in words), None)
        if kind is None or kind in found:
            known = "; ".join(f"{name}: {', '.join(words)}" for name, words in _KINDS.items())
            raise DynidentError(
                f"cannot read {word!r} in {text!r}; write words of these kinds with / between, one of each at most "
                f"({known})",
                pointer="--methods",
                title="Unusable option",
            )
        found[kind] = word
    if "steps" in found:
        found.setdefault("strategy", "sequential")
    return method_of(
        found.get("model", "dynamic"),
        found.get("strategy", "global"),
        found.get("steps", "link_by_link"),
        found.get("estimator", "wls"),
        found.get("prior", ""),
    )


def _word(text: str, words: tuple[_Word, ...], kind: str) -> _Word:
    for word in words:
        if text == word:
            return word
    raise DynidentError(
        f"there is no {kind} {text!r}; choose from: {', '.join(words)}", pointer=f"--{kind}", title="Unusable option"
    )


_KINDS: dict[str, tuple[str, ...]] = {
    "model": get_args(ModelName),
    "strategy": get_args(StrategyName),
    "steps": get_args(StepsName),
    "estimator": get_args(EstimatorName),
    "prior": get_args(PriorName),
}
