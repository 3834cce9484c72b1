"""Which kind of experiment tells which effects apart: as the effects themselves say."""

from __future__ import annotations

from dynident.advice.kinds import EXPERIMENTS, Experiment
from dynident.effects import Effect, ExperimentKind, effect_by_id


def experiment_for(suspect: str, rival: str | None) -> Experiment:
    """The experiment that decides between two effects, or between two places of one, or that shows one."""
    effect = effect_by_id(suspect)
    if suspect == rival:
        return EXPERIMENTS[effect.place_experiment]
    told = None if rival is None else _telling(effect, effect_by_id(rival))
    return EXPERIMENTS[told or effect.experiment]


def _telling(one: Effect, other: Effect) -> ExperimentKind | None:
    """The experiment that tells two effects apart, named by either of them."""
    for effect, rival in ((one, other), (other, one)):
        for kind, others in effect.told_from.items():
            if rival.id in others:
                return kind
    return None
