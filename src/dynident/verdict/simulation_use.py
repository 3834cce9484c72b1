"""Is a model fit for simulation: can such a robot exist, and does it stay near the real one without a controller?"""

from __future__ import annotations

import numpy as np

from dynident.effects import LINKS
from dynident.errors import DynidentError
from dynident.estimation import compute_errors
from dynident.identification.estimators.feasible import find_nearest_feasible
from dynident.identification.parameters.inertia import compute_smallest_inertia_eigenvalue
from dynident.identification.thresholds import LARGEST_DRIFT, NOTABLE_DRIFT
from dynident.validation.drift import AFTER, Drift, compute_open_loop_drift
from dynident.verdict.evidence import HeldOutEvidence
from dynident.verdict.use import DIAGNOSE, GIVE_RECORDINGS, UseFinding

# Limits of nature that are named; of more their number is said.
_NAMED = 3
_POSTURES = 200
CURE = "Identify again with bodies that can exist: dynident identify … --estimator feasible."


def judge_simulation(evidence: HeldOutEvidence, drift: Drift | None) -> list[UseFinding]:
    """Judge the links, the mass matrix along the motion, and the drift of a simulation without a controller."""
    findings = [*_judge_bodies(evidence), *_judge_mass_matrix(evidence)]
    if drift is not None:
        return [*findings, _judge_drift(drift)]
    if evidence.recordings:
        sentence = "No robot with these parameters makes a step along the held-out motion."
        return [*findings, UseFinding("no", sentence, CURE)]
    sentence = "How far a simulation runs away takes the held-out recordings."
    return [*findings, UseFinding("not_judged", sentence, GIVE_RECORDINGS)]


def compute_drift(evidence: HeldOutEvidence) -> Drift | None:
    """Return the drift along the held-out recordings; None where there are none, or no robot has these parameters."""
    try:
        return compute_open_loop_drift(evidence.identification, evidence.recordings) if evidence.recordings else None
    except DynidentError:
        return None


def _judge_bodies(evidence: HeldOutEvidence) -> list[UseFinding]:
    """Judge whether bodies, rotors and friction that can exist have the parameters; if not, what they would cost."""
    identification = evidence.identification
    if not any(choice.effect == LINKS.effect for choice in identification.model.effects):
        return []
    if identification.estimate.standard is not None and not identification.estimate.not_essential:
        return []  # These standard parameters were looked for among those of bodies that can exist.
    try:
        nearest = find_nearest_feasible(
            identification.model,
            identification.data.equations,
            identification.estimate.solution,
            identification.choices.trust,
        )
    except DynidentError as error:
        return [
            UseFinding("no", f"Whether bodies that can exist have these parameters is not known: {error.detail}.", CURE)
        ]
    if nearest.is_feasible:
        return []
    names = ", ".join(nearest.limits[:_NAMED])
    more = f" and {len(nearest.limits) - _NAMED} more" if len(nearest.limits) > _NAMED else ""
    cost = ""
    if identification.data.held_out is not None:
        after = compute_errors(identification.data.held_out, nearest.values).relative_total
        before = evidence.held_out.relative_total
        cost = f" The nearest that can have a held-out error of {after:.2%} instead of {before:.2%}."
    return [UseFinding("no", f"No bodies that can exist have these parameters ({names}{more}).{cost}", CURE)]


def _judge_mass_matrix(evidence: HeldOutEvidence) -> list[UseFinding]:
    """Judge whether the mass matrix is positive definite along the held-out motion, and in random postures."""
    identification = evidence.identification
    along = np.inf
    if evidence.comparisons:
        q = np.concatenate([comparison.q for comparison in evidence.comparisons])
        along = compute_smallest_inertia_eigenvalue(
            identification.model, identification.values, postures=q[:: max(1, len(q) // _POSTURES)]
        )
    if along <= 0:
        return [UseFinding("no", "Along the held-out motion the mass matrix is not positive definite.", CURE)]
    if identification.worst_inertia_eigenvalue <= 0:
        return [UseFinding("no", "In some postures the mass matrix is not positive definite.", CURE)]
    return []


def _judge_drift(drift: Drift) -> UseFinding:
    share, figures = drift.share, word_drift(drift)
    # Only the two shorter horizons decide: after two seconds most arms have left the motion, whatever the model, as
    # they are unstable without a controller.
    short = share[:2]
    if not np.isfinite(short[0]).all():
        return UseFinding("no", f"Left alone under the measured torque, the simulation diverges. {figures}", CURE)
    if float(np.nanmax(short)) > LARGEST_DRIFT:
        sentence = (
            f"{figures} Above {LARGEST_DRIFT:.0%} of the way within {AFTER[1]:g} s it is no simulation of the robot."
        )
        return UseFinding("no", sentence, DIAGNOSE)
    if float(np.nanmax(short)) > NOTABLE_DRIFT:
        sentence = f"Only with a controller, or for less than {AFTER[1]:g} s: {figures[0].lower()}{figures[1:]}"
        return UseFinding("limited", sentence, DIAGNOSE)
    return UseFinding("yes", figures)


def word_drift(drift: Drift) -> str:
    """Word the drift of the worst joint after each time, in a sentence."""
    phrases = []
    for after, share in zip(AFTER, drift.share, strict=True):
        if np.isnan(share).all():
            continue
        worst = int(np.nanargmax(share))
        size = "all of" if not np.isfinite(share[worst]) else f"{share[worst]:.0%} of"
        phrases.append(f"{size} its way after {after:g} s ({drift.joint_names[worst]})")
    return f"Left alone under the measured torque, the worst joint is off by {', '.join(phrases)}."
