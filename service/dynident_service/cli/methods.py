"""Models, strategies and estimators by the names that are typed."""

from __future__ import annotations

from typing import Any

from dynident.asking import Named
from dynident.errors import DynidentError
from dynident.identification.choices import STEPS
from dynident.identification.methods.bases import ESTIMATORS, MODELS, PRIORS, STRATEGIES
from dynident.validation import Method


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
    found: dict[str, Any] = {}
    for word in text.split("/"):
        kind = next((name for name, words in _KINDS.items() if word in words.names), None)
        if kind is None or kind in found:
            known = "; ".join(f"{name}: {', '.join(words.names)}" for name, words in _KINDS.items())
            raise DynidentError(
                f"cannot read {word!r} in {text!r}; write words of these kinds with / between, one of each at most "
                f"({known})",
                pointer="--methods",
                title="Unusable option",
            )
        found[kind] = word
    if "steps" in found:
        found.setdefault("strategy", "sequential")
    return Method(**found)


_KINDS: dict[str, Named] = {
    "model": MODELS,
    "strategy": STRATEGIES,
    "steps": STEPS,
    "estimator": ESTIMATORS,
    "prior": PRIORS,
}
