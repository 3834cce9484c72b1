"""Which joints stay in an effect of several joints once all else is found."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.outcome_reasons import Reason
from dynident.diagnosis.search import finding_refinement, pruning
from dynident.diagnosis.search.search_state import Finding, State
from dynident.effects import EffectChoice
from dynident.progress import ignore_progress

ARM = tuple(f"joint_{k}" for k in range(1, 7))
WEAK, AGAINST = 1.5, -1.5


@dataclass(frozen=True)
class Gain:
    """What a joint of the group gains by itself: a fifth of its squared error, by this t."""

    candidate: Candidate
    t: float
    drop: float = 0.2

    @property
    def total_gain(self) -> float:
        return self.t

    def is_still_helpful(self, least_drop: float, least_t: float) -> bool:
        return self.drop >= least_drop and self.t >= least_t


@pytest.fixture
def left_of(monkeypatch):
    """Gives the joints that are left of a group whose joints gain by these t, on an arm of six.

    `impossible`: of a change, joints on which nature does not allow what it has become beside all else.
    """

    def left(gains: dict[str, float], impossible: tuple[str, ...] = ()) -> tuple[str, ...]:
        def judge(state: Any, asked: list[Candidate]) -> list[Gain]:
            return [Gain(candidate, gains[candidate.joints[0]]) for candidate in asked]

        monkeypatch.setattr(pruning, "score_all", judge)
        monkeypatch.setattr(pruning, "compute_gain_over_floor", lambda *asked: 1.0)
        monkeypatch.setattr(
            pruning, "is_physically_possible", lambda *asked: asked[-1].candidate.joints[0] not in impossible
        )
        robot = SimpleNamespace(joint_names=ARM, get_movers=lambda name: (ARM.index(name),))
        columns = [SimpleNamespace(link=name) for name in gains]
        observation = SimpleNamespace(robot=robot, columns=columns)
        pool = SimpleNamespace(observation=observation, is_change=lambda candidate: bool(impossible))
        numbers = tuple(range(len(gains)))
        group = Candidate("presliding", tuple(gains), (), numbers)
        found = Finding(cast(Any, SimpleNamespace(candidate=group)), (), 0.001)
        state = State(cast(Any, None), cast(Any, pool), numbers, np.ones(6), np.ones(6), (found,))
        (joints,) = pruning.trim_joints(state)
        return joints

    return left


def test_what_most_gears_have_a_joint_keeps_that_gains_a_little(left_of):
    assert left_of({ARM[0]: WEAK, ARM[1]: 5.0, ARM[2]: 5.0, ARM[3]: 5.0}) == ARM[:4]


def test_a_joint_that_predicts_worse_with_it_goes_though_most_have_it(left_of):
    assert left_of({ARM[0]: AGAINST, ARM[1]: 5.0, ARM[2]: 5.0, ARM[3]: 5.0}) == ARM[1:4]


def test_two_joints_of_six_speak_for_no_third(left_of):
    assert left_of({ARM[0]: WEAK, ARM[1]: 5.0, ARM[2]: 5.0}) == ARM[1:3]


def test_of_a_group_that_hardly_gains_the_best_joint_stays(left_of):
    assert left_of({ARM[0]: WEAK, ARM[1]: 0.5}) == (ARM[0],)


def test_a_joint_that_cannot_have_changed_so_goes_whatever_it_gains(left_of):
    assert left_of({ARM[0]: 5.0, ARM[1]: 5.0, ARM[2]: 5.0}, impossible=(ARM[0],)) == ARM[1:3]


@pytest.fixture
def refine(monkeypatch: pytest.MonkeyPatch):
    """Refines one group of which a joint is impossible at first, or all of it not resolved: what is left, and why."""

    def refine(
        group: Candidate, other: Candidate, unresolved: str = "", *, is_former: bool = False
    ) -> tuple[tuple[EffectChoice, ...], dict[Candidate, Reason]]:
        names = (cast(Any, ScoredStub(other)),)
        equal, former = ((), names) if is_former else (names, ())
        finding = Finding(cast(Any, ScoredStub(group)), equal, 0.001, former=former)
        reason = Reason.build("impossible", parameter="Fs2")
        rounds = iter([{}] if unresolved else [{0: (reason, (ARM[1],))}, {}])

        def build(model: Any, findings: Any, choices: tuple[EffectChoice, ...], *others: Any) -> Any:
            return SimpleNamespace(
                find_impossible=lambda: next(rounds),
                select_needed=lambda *asked: (choices, list(range(len(choices)))),
                select_harmless=lambda order: sorted(order),
            )

        monkeypatch.setattr(finding_refinement, "locate_findings", lambda model, findings, inputs: findings)
        monkeypatch.setattr(finding_refinement, "refine_shapes", lambda model, choices, *others: choices)
        monkeypatch.setattr(finding_refinement, "is_width_resolved", lambda choice, *_: choice.effect != unresolved)
        monkeypatch.setattr(finding_refinement, "improve_reference", lambda model, choices, inputs: inputs)
        monkeypatch.setattr(finding_refinement, "compute_explained_error", lambda *asked: 1.0)
        monkeypatch.setattr(finding_refinement, "RefinedModel", SimpleNamespace(from_choices=build))
        robot = SimpleNamespace(tree=SimpleNamespace(joint_names=ARM))
        nothing, model = cast(Any, SimpleNamespace(preprocessing=None)), SimpleNamespace(robot=robot)
        _, choices, dropped = finding_refinement.refine_findings(
            cast(Any, SimpleNamespace(model=model)), (finding,), nothing, nothing, np.zeros(6), (), ignore_progress
        )
        return choices, dropped

    return refine


@dataclass(frozen=True)
class ScoredStub:
    candidate: Candidate
    p: float = 0.5


def test_an_impossible_joint_of_a_group_is_renamed_alone_and_its_reason_is_kept(refine) -> None:
    group = Candidate("stribeck", ARM[:2], (("vs", 0.1),), (0, 1))
    choices, dropped = refine(group, Candidate("quadratic", ARM[:2], (), (2, 3)))
    assert [(choice.effect, choice.joints) for choice in choices] == [("stribeck", ARM[:1]), ("quadratic", ARM[1:2])]
    assert [(candidate.joints, reason.code) for candidate, reason in dropped.items()] == [(ARM[1:2], "impossible")]


def test_constants_that_the_data_cannot_resolve_give_way_to_an_equal_name(refine) -> None:
    peak = Candidate("stribeck", ARM[:1], (("vs", 0.1),), (0,))
    choices, dropped = refine(peak, Candidate("quadratic", ARM[:1], (), (2,)), unresolved="stribeck")
    assert [(choice.effect, choice.joints) for choice in choices] == [("quadratic", ARM[:1])]
    assert dropped == {peak: Reason.build("not_resolved")}


def test_a_name_that_a_finding_had_before_takes_over_where_no_equal_one_does(refine) -> None:
    peak = Candidate("stribeck", ARM[:1], (("vs", 0.1),), (0,))
    choices, _ = refine(peak, Candidate("quadratic", ARM[:1], (), (2,)), unresolved="stribeck", is_former=True)
    assert [(choice.effect, choice.joints) for choice in choices] == [("quadratic", ARM[:1])]


def test_a_name_of_other_joints_is_not_given_to_the_impossible_one(refine) -> None:
    group = Candidate("stribeck", ARM[:2], (("vs", 0.1),), (0, 1))
    choices, _ = refine(group, Candidate("quadratic", ARM[2:3], (), (2,)))
    assert [(choice.effect, choice.joints) for choice in choices] == [("stribeck", ARM[:1])]
