"""Is a model fit to detect collisions: which force at the tool shows above what the model leaves anyway."""

from __future__ import annotations

from dynident.identification.thresholds import LARGEST_FORCE, LARGEST_FORCE_ANYWHERE
from dynident.verdict.evidence import HeldOutEvidence
from dynident.verdict.feed_forward_use import judge_errors
from dynident.verdict.payload_use import GAINS, judge_scale
from dynident.verdict.tool_loads import FALSE_ALARMS_AN_HOUR, FEWEST_BLOCKS, SEEN, DetectableForce
from dynident.verdict.use import DIAGNOSE, GIVE_RECORDINGS, UseFinding

_LONGER = f"Hold out at least {FEWEST_BLOCKS} s of motion of the joints that carry the tool."


def judge_collision_detection(evidence: HeldOutEvidence, force: DetectableForce | None) -> list[UseFinding]:
    """Judge the force at the tool that a threshold on the residual detects at one false alarm an hour."""
    findings = [*judge_errors(evidence), *judge_scale(evidence)]
    if force is None:
        if not evidence.comparisons:
            return [*findings, UseFinding("not_judged", "A threshold takes the held-out recordings.", GIVE_RECORDINGS)]
        return [*findings, UseFinding("not_judged", "The held-out data are too short to tell a threshold.", _LONGER)]
    figures = (
        f"At {FALSE_ALARMS_AN_HOUR:g} false alarm an hour a force of {force.force:.3g} N at the tool shows ({SEEN:.0%} "
        f"of directions and postures of the held-out motion, {force.seconds:.0f} s)."
    )
    if force.force > LARGEST_FORCE:
        against = f"{figures} Above {LARGEST_FORCE:g} N, which a hand may bear, it saves the machine at best."
        return [*findings, UseFinding("no", against, DIAGNOSE)]
    if force.force > LARGEST_FORCE_ANYWHERE:
        findings.append(
            UseFinding("limited", f"More than the {LARGEST_FORCE_ANYWHERE:g} N that a face may bear.", DIAGNOSE)
        )
    if not evidence.list_passed("payload"):
        findings.append(
            UseFinding("limited", "In N only if the drive gains are right, which nothing has checked.", GAINS)
        )
    return [*findings, UseFinding("yes", figures)]
