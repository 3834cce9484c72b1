"""Is a model fit for feed forward: how much torque it leaves to the controller, by joint and phase."""

from __future__ import annotations

import numpy as np

from dynident.identification.thresholds import LARGEST_ERROR, LARGEST_OF_JOINT, NOTABLE_OF_JOINT
from dynident.verdict.evidence import HeldOutEvidence
from dynident.verdict.use import DIAGNOSE, GIVE_RECORDINGS, State, UseFinding

_PRESLIDING = "Find what is missing, most often presliding friction: dynident diagnose MODEL RUN."


def judge_errors(evidence: HeldOutEvidence) -> list[UseFinding]:
    """Judge the held-out error, all rows together and each joint where it moves: every use rests on these."""
    error, each, joints = evidence.held_out.relative_total, evidence.joint_errors, evidence.joints
    findings = []
    # Written so that nan counts as too large.
    if not error <= LARGEST_ERROR:
        findings.append(UseFinding("no", f"The held-out error is {error:.1%}, above {LARGEST_ERROR:.0%}.", DIAGNOSE))
    bad = [f"{joints[j]} ({each[j]:.0%})" for j in range(len(joints)) if not each[j] <= LARGEST_OF_JOINT]
    if bad:
        sentence = f"Where they move, joints are above {LARGEST_OF_JOINT:.0%}: {', '.join(bad)}."
        findings.append(
            UseFinding("no", sentence, f"Find what is missing on {bad[0].split(' (')[0]}: dynident diagnose MODEL RUN.")
        )
    if evidence.never_moving:
        names = ", ".join(evidence.never_moving)
        sentence = f"Nothing is told of {names}, which never moves in the held-out data."
        findings.append(UseFinding("limited", sentence, f"Hold out a motion of all joints: {names} stands."))
    return findings


def judge_feed_forward(evidence: HeldOutEvidence) -> list[UseFinding]:
    """Judge the error while joints move, reverse, and start: the worst joint counts."""
    error, each, joints = evidence.held_out.relative_total, evidence.joint_errors, evidence.joints
    worst = int(np.argmax(each))
    figures = [f"moving {each[worst]:.0%} ({joints[worst]})"]
    findings = judge_errors(evidence)
    notable = [
        f"{joints[j]} {each[j]:.0%}" for j in range(len(joints)) if NOTABLE_OF_JOINT < each[j] <= LARGEST_OF_JOINT
    ]
    if notable:
        sentence = f"Much is left to the controller while they move: {', '.join(notable)}."
        findings.append(UseFinding("limited", sentence, DIAGNOSE))
    remembers = bool(evidence.identification.model.signals.memory_signals)
    # The first phase, moving, is judged by the joints' errors above, on all rows of the held-out data.
    for phase in evidence.phases[1:]:
        if np.isnan(phase.share).all():
            continue
        joint = int(np.nanargmax(phase.share))
        share = float(phase.share[joint])
        if share <= NOTABLE_OF_JOINT:
            figures.append(f"{phase.name} {share:.0%} ({joints[joint]})")
            continue
        state: State = "no" if share > LARGEST_OF_JOINT else "limited"
        sentence = f"{phase.name.capitalize()} {joints[joint]} is off by {share:.0%} of its torque."
        findings.append(UseFinding(state, sentence, DIAGNOSE if remembers else _PRESLIDING))
    if not evidence.phases:
        sentence = "What is left where joints reverse and start takes the held-out recordings."
        findings.append(UseFinding("limited", sentence, GIVE_RECORDINGS))
    good = f"The held-out error is {error:.1%}; the worst joint {', '.join(figures)}."
    return [*findings, UseFinding("yes", good)]
