"""The experiment that would tell apart what the data could not."""

from __future__ import annotations

from collections.abc import Sequence

from dynident.diagnosis.result import Invisible, NextExperiment, RankedEffect
from dynident.effects import EffectChoice

_SLOW = ("stribeck", "presliding", "viscous_nonlinear", "coulomb")


def next_experiment(
    ranked: Sequence[RankedEffect], invisible: Sequence[Invisible], effects: tuple[EffectChoice, ...]
) -> NextExperiment | None:
    """The motion that would tell apart what this data could not."""
    for item in ranked:
        if item.significant and item.equivalent:
            pair = " from ".join([item.effect, " or ".join(item.equivalent)])
            slow = item.effect in _SLOW
            how = "Constant speeds both ways, slow and fast," if slow else "A motion over the whole range"
            return NextExperiment(
                f"{how} would tell {pair}.",
                "constant_velocity" if slow else "optimized",
                (*effects, EffectChoice(item.effect, item.joints, item.shape)),
            )
    if invisible:
        names = ", ".join(sorted({item.effect for item in invisible}))
        return NextExperiment(f"A larger motion would show whether {names} is there.", "optimized", effects)
    return None
