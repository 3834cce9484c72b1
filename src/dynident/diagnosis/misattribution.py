"""Find wrong names: an effect that leaves more than it explains, or another function of the position.

Findings that were made beside such a name, and would not have been made without it, go with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import get_args

import numpy as np

from dynident.diagnosis.candidates.significance import SMALLEST_DROP, ScoredCandidate
from dynident.diagnosis.comparing.compare import Comparison
from dynident.diagnosis.result import UnknownPattern, Variable
from dynident.diagnosis.search.state import Finding
from dynident.effects import EffectChoice, get_effect
from dynident.identification import Identification

_LEFT_OVER = 0.12
"""Share of what an effect removed that may be left as the same kind of function: more, and it is another function."""

_KINDS = ("position", "other_joints")
_MUCH_LEFT_OVER = 1.5
"""The same for any effect of one joint and any variable: what is left is larger than what the effect explained."""


def find_misnamed(
    picks: Sequence[Finding],
    recommended: Sequence[EffectChoice],
    unknown: Sequence[UnknownPattern],
    final: Sequence[Comparison],
) -> list[int]:
    """Return the numbers of the findings whose joint still depends on what they should have explained.

    Parameters
    ----------
    picks, recommended : sequences of equal length
        The findings, and how they are recommended.
    unknown : sequence of UnknownPattern
        Patterns of the residual that is left once all findings are in the model.
    final : sequence of Comparison
        The comparisons of that model.

    Returns
    -------
    list of int
        Numbers of the findings, ascending.
    """
    names = final[0].joint_names
    squares = np.sum([(c.counted_residual**2).sum(axis=0) for c in final], axis=0)
    wrong = []
    for number, (finding, choice) in enumerate(zip(picks, recommended, strict=True)):
        judged = finding.judged
        of_position = get_effect(choice.effect).of_position
        if not of_position and len(choice.joints) != 1:
            continue
        # Functions of the position are easily confused, so less of a remainder tells; other effects get the benefit of
        # the doubt.
        least, kinds = (_LEFT_OVER, _KINDS) if of_position else (_MUCH_LEFT_OVER, get_args(Variable))
        # An effect across two joints has one name and acts on both.
        here = [j for j in judged.joints if names[j] in choice.joints or (of_position and len(choice.joints) == 1)]
        for j in here:
            removed = float((judged.before - judged.after)[:, j].sum())
            # A pattern's share is one of the residual that is left, so it is turned into a squared error for the
            # comparison.
            remainders = [p.share * squares[j] for p in unknown if p.joint == names[j] and p.variable in kinds]
            if remainders and max(remainders) > least * removed:
                wrong.append(number)
                break
    return wrong


def is_only_helpful_at_first(before: Identification, after: Identification, choice: EffectChoice) -> bool:
    """Return whether a first-order effect explains nothing any more in the model that is identified with it.

    Its columns are made of the torque that the model without it predicts. Where the motion hardly determines that
    model, the one with it predicts another torque, and the gain is gone: no joint's error falls noticeably, or all of
    them together rise.

    Parameters
    ----------
    before : Identification
        The model without the effect.
    after : Identification
        The model that was identified with it.
    choice : EffectChoice
        The effect.
    """
    if not get_effect(choice.effect).first_order:
        return False
    was, now = before.fit.rms**2, after.fit.rms**2
    noise = np.maximum(before.noise**2, np.finfo(float).tiny)
    return not (now <= (1.0 - SMALLEST_DROP) * was).any() or float((now / noise).sum()) > float((was / noise).sum())


def find_dependent_findings(
    picks: Sequence[Finding], wrong: Sequence[int], first: Sequence[ScoredCandidate]
) -> list[int]:
    """Return the numbers of the findings on the joints of a wrong name that do not pass without it.

    Beside a wrong curve something else may make up for its errors.

    Parameters
    ----------
    picks : sequence of Finding
        The findings.
    wrong : sequence of int
        Numbers of the wrong names.
    first : sequence of ScoredCandidate
        All candidates, scored before anything was found.

    Returns
    -------
    list of int
        Numbers of the findings that go with the wrong names.
    """
    alone = {scored.candidate: scored for scored in first}
    dependent = []
    for number, finding in enumerate(picks):
        mine = finding.judged
        shares_joint = any(set(picks[k].judged.joints) & set(mine.joints) for k in wrong)
        before = alone.get(mine.candidate)
        if shares_joint and number not in wrong and before is not None and not before.is_significant:
            dependent.append(number)
    return dependent
