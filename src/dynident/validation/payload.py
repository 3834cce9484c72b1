"""Without and with a known load: are the load's parameters found (§12.7)?

The load is weighed twice: with friction that is the same in all runs, and with friction of its own in every run. Where
the motion tells load and friction apart, both give the same mass; where it does not, neither is a measurement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.effects import EffectChoice, effect_by_id
from dynident.errors import DynidentError
from dynident.estimation import EstimationError
from dynident.identification import Identification
from dynident.identification.drive_gains import PayloadEstimate, payload_mass
from dynident.identification.payloads import known_payload
from dynident.progress import Progress, part, silent
from dynident.recordings import Recording
from dynident.threads import single_threaded
from dynident.validation.verdict import Judged

_OF_THE_DRIVES = frozenset(
    {
        "offset",
        "coulomb",
        "viscous",
        "coulomb_asymmetric",
        "viscous_asymmetric",
        "viscous_nonlinear",
        "stribeck",
    }
)
# Estimates whose difference, or half interval, is more than this share of the mass are no measurement of it.
_LARGEST_SHARE = 0.25
# Off by more than this share is wrong, whatever the interval; by less is right: gains are hardly known better.
_AS_STATED = 0.05
_SURE = 1.96


@dataclass(frozen=True, eq=False)
class PayloadValidation:
    """The load of one recording.

    `stated` mass in kg; `together` weighed with friction the same in all runs, `apart` with friction of its own in
    each: None where the data do not determine the model.
    """

    name: str
    stated: float
    together: PayloadEstimate | None
    apart: PayloadEstimate | None
    judged: Judged

    @property
    def identifiable(self) -> bool:
        """Whether the motion tells the load from friction."""
        return _doubt(self.stated, self.together, self.apart) is None

    @property
    def mass(self) -> float | None:
        """What was weighed, kg."""
        return self.together.mass if self.together is not None and self.identifiable else None

    @property
    def half_width(self) -> float | None:
        """Half the 95 % interval, with the difference between the two ways of weighing in it, kg."""
        if self.together is None or self.apart is None or not self.identifiable:
            return None
        return _half_width(self.together, self.apart)


@single_threaded
def validate_payload(
    identification: Identification,
    unloaded: Sequence[Recording],
    loaded: Recording,
    mass: float | None = None,
    progress: Progress = silent,
) -> PayloadValidation:
    """Weigh a known load, and compare.

    Parameters
    ----------
    identification : Identification
        Its effects and filters are used.
    unloaded : sequence of Recording
        Runs without the load, such as those of the identification.
    loaded : Recording
    mass : float, optional
        What the load weighs, in kg, where the recording's metadata do not say.

    Raises
    ------
    DynidentError
        Where no usable mass is stated, or there is no run without the load.
    """
    if mass is not None and not (np.isfinite(mass) and mass > 0):
        raise DynidentError(f"the mass is {mass}; give a number of kg above zero", pointer="/mass")
    stated = known_payload(loaded).mass if mass is None else mass
    plain = tuple(choice for choice in identification.choices.effects if _fits(choice))
    runs = [recording.name for recording in (*unloaded, loaded)]
    apart = tuple(one for choice in plain for one in _in_each(choice, runs))
    found: list[PayloadEstimate | None] = []
    for number, effects in enumerate((plain, apart)):
        part(progress, 0.5 * number, 0.5 * number + 0.5)(0.0, f"weighing the load of {loaded.name}")
        try:
            found.append(
                payload_mass(
                    identification.model.robot,
                    unloaded,
                    loaded,
                    effects=effects,
                    preprocessing=identification.preprocessing,
                )
            )
        except EstimationError:
            found.append(None)
    return PayloadValidation(loaded.name, stated, found[0], found[1], _judged(stated, found[0], found[1]))


def _fits(choice: EffectChoice) -> bool:
    effect = effect_by_id(choice.effect)
    return not (effect.needs_load or effect.in_some_runs or choice.runs)


def _in_each(choice: EffectChoice, runs: Sequence[str]) -> tuple[EffectChoice, ...]:
    """A drive's effect in every run by itself, any other as it is."""
    if choice.effect not in _OF_THE_DRIVES:
        return (choice,)
    return tuple(replace(choice, runs=(run,)) for run in runs)


def _doubt(stated: float, together: PayloadEstimate | None, apart: PayloadEstimate | None) -> str | None:
    """Why the load is not identifiable from these runs; None where it is."""
    if together is None or apart is None:
        return "the runs do not determine the load beside the other parameters"
    gap = abs(together.mass - apart.mass)
    if gap > _LARGEST_SHARE * stated:
        return (
            "the motion does not tell the load from friction: if friction is taken to be the same with and without the "
            f"load, it weighs {together.mass:.3g} kg, if not, {apart.mass:.3g} kg"
        )
    if _SURE * max(together.standard_deviation, apart.standard_deviation) > _LARGEST_SHARE * stated:
        return f"its uncertainty would be {_half_width(together, apart):.2g} kg"
    return None


def _half_width(together: PayloadEstimate, apart: PayloadEstimate) -> float:
    return float(np.hypot(_SURE * together.standard_deviation, together.mass - apart.mass))


def _judged(stated: float, together: PayloadEstimate | None, apart: PayloadEstimate | None) -> Judged:
    doubt = _doubt(stated, together, apart)
    if doubt is not None or together is None or apart is None:
        advice = "Move the last links through more postures, slowly and with the load at different heights."
        said = f"The mass of the load ({stated:.4g} kg) is not identifiable from this motion"
        return Judged("not_evaluated", f"{said}: {doubt}. {advice}")
    half = _half_width(together, apart)
    off = together.mass - stated
    text = f"The load weighs {together.mass:.3f} ± {half:.2g} kg; it is said to be {stated:.4g} kg"
    if abs(off) <= max(half, _AS_STATED * stated):
        return Judged("pass", f"{text}.")
    return Judged(
        "fail",
        f"{text}, {abs(off) / stated:.1%} {'less' if off > 0 else 'more'}: the drive gains are probably too "
        f"{'high' if off > 0 else 'low'} by as much, or the torque is not that of the joints.",
    )
