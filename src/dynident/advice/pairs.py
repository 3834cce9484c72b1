"""Look up which kind of experiment tells two effects apart, as the catalogue of effects says."""

from __future__ import annotations

from dynident.advice.kinds import EXPERIMENTS, Experiment
from dynident.effects import Effect, ExperimentKind, get_effect


def choose_experiment(suspect: str, rival: str | None) -> Experiment:
    """Return the experiment that decides between two effects, between two places of one, or that shows one.

    Parameters
    ----------
    suspect : str
        Id of the effect that was found.
    rival : str or None
        Id of the effect that it may be instead; the same id asks for the place, None for the effect alone.

    Returns
    -------
    Experiment
    """
    effect = get_effect(suspect)
    if suspect == rival:
        return EXPERIMENTS[effect.place_experiment]
    kind = None if rival is None else _find_distinguishing_kind(effect, get_effect(rival))
    return EXPERIMENTS[kind or effect.experiment]


def _find_distinguishing_kind(first: Effect, second: Effect) -> ExperimentKind | None:
    """Return the kind of experiment that tells two effects apart, as either of them names it."""
    for effect, rival in ((first, second), (second, first)):
        for kind, others in effect.told_from.items():
            if rival.id in others:
                return kind
    return None
