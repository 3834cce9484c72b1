"""Is a model fit to weigh loads: are its torques true to scale, and which mass shows above what it leaves anyway."""

from __future__ import annotations

from dynident.effects import LINKS
from dynident.identification.thresholds import LARGEST_TO_WEIGH
from dynident.verdict.evidence import HeldOutEvidence
from dynident.verdict.feed_forward_use import judge_errors
from dynident.verdict.use import DIAGNOSE, GIVE_RECORDINGS, UseFinding

GAINS = (
    "Run the motion of the identification with a load that was weighed: dynident validate MODEL payload LOADED "
    "--unloaded RUN --mass KG."
)
_LEAST_DETERMINED = 0.5
"""Share of the links' parameters that the data have to determine before a load is weighed against them."""


def judge_scale(evidence: HeldOutEvidence) -> list[UseFinding]:
    """List the known loads that came out wrong: then all torques, forces and masses are off by the same factor."""
    step = "Find the drive gains from the runs without and with the load: dynident gains."
    return [UseFinding("no", outcome.judged.reason, step) for outcome in evidence.list_failed("payload")]


def judge_units(evidence: HeldOutEvidence) -> list[UseFinding]:
    """List wrong known loads as limits, for uses in which torques are only compared with torques."""
    sentence = "In the unit of the recorded torque alone: a known load came out wrong, and so are all masses."
    return [UseFinding("limited", sentence, finding.next_step) for finding in judge_scale(evidence)]


def judge_payload(evidence: HeldOutEvidence, mass: float | None) -> list[UseFinding]:
    """Judge the scale of the torques by a known load, and the mass that shows."""
    findings = [*judge_errors(evidence), *judge_scale(evidence)]
    error = evidence.held_out.relative_total
    if error > LARGEST_TO_WEIGH:
        sentence = f"The held-out error is {error:.1%}, above {LARGEST_TO_WEIGH:.0%}: what is left is taken for a load."
        findings.append(UseFinding("no", sentence, DIAGNOSE))
    parameters = evidence.identification.parameters
    links = [
        parameter
        for parameter in parameters
        if parameter.effect == LINKS.effect and parameter.judgement != "zero_in_interval"
    ]
    sure = sum(parameter.judgement == "determined" for parameter in links)
    if not links or sure < _LEAST_DETERMINED * len(links):
        sentence = (
            f"Of the {len(links)} parameters of the links that are not zero the data determine {sure}: a load would be "
            "weighed against uncertain ones."
        )
        findings.append(UseFinding("no", sentence, "Record a longer, designed motion: dynident design."))
    checked = evidence.list_passed("payload")
    if not checked:
        sentence = "Nothing has checked the drive gains: with wrong ones every load is as wrong, and no error shows it."
        findings.append(UseFinding("not_judged", sentence, GAINS))
    if mass is None:
        sentence = "Which mass shows takes a held-out motion that moves the tool."
        return [*findings, UseFinding("not_judged", sentence, GIVE_RECORDINGS)]
    figures = f"Along the held-out motion a load at the tool shows from {mass:.2g} kg on."
    return [*findings, *(UseFinding("yes", outcome.judged.reason) for outcome in checked), UseFinding("yes", figures)]
