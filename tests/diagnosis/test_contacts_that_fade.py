"""A contact that was found first is asked for again beside all that was found after it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from dynident.diagnosis.candidates.candidate_pool import Candidate
from dynident.diagnosis.candidates.significance import FamilywiseLevels
from dynident.diagnosis.search import candidate_outcomes, contacts_and_loads
from dynident.diagnosis.search.search_state import Finding, ScoredFamily, SearchRecord, State
from dynident.recordings import Preprocessing

CONTACT = Candidate("external_contact", (), (("t0", 1.0), ("t1", 2.0)), (3, 4, 5))
FRICTION = Candidate("presliding", ("joint_1",), (("d0", 0.01), ("law", 1.0)), (6,))
MODEL = (0, 1, 2)


def found(candidate: Candidate) -> Finding:
    return Finding(cast(Any, SimpleNamespace(candidate=candidate)), (), 0.001)


def stated(columns: tuple[int, ...], findings: tuple[Finding, ...], data: Any = None) -> State:
    return State(data, cast(Any, None), columns, np.ones(6), np.ones(6), findings)


@pytest.fixture
def left(monkeypatch):
    """Gives what is left of a search's findings where a contact shows, or does not, beside the model's columns."""

    def of(findings: tuple[Candidate, ...], shows: bool) -> tuple[State, list[tuple[int, ...]]]:
        asked: list[tuple[int, ...]] = []

        def find(state: State, preprocessing: Any) -> tuple[Finding, ...]:
            asked.append(state.base)
            return (found(CONTACT),) if shows else ()

        monkeypatch.setattr(contacts_and_loads, "find_contacts", find)
        columns = (*MODEL, *(k for candidate in findings for k in candidate.columns))
        state = stated(columns, tuple(found(candidate) for candidate in findings))
        return contacts_and_loads.drop_faded_contacts(state, Preprocessing(10.0, 10.0, 5)), asked

    return of


def test_a_contact_that_friction_explains_goes_with_its_columns(left):
    state, asked = left((CONTACT, FRICTION), shows=False)
    assert [finding.judged.candidate for finding in state.findings] == [FRICTION]
    assert state.base == (*MODEL, *FRICTION.columns)
    assert asked == [(*MODEL, *FRICTION.columns)]


def test_a_contact_that_still_shows_stays_where_it_was_in_order(left):
    state, _ = left((CONTACT, FRICTION), shows=True)
    assert [finding.judged.candidate for finding in state.findings] == [CONTACT, FRICTION]
    assert set(state.base) == {*MODEL, *CONTACT.columns, *FRICTION.columns}


def test_a_contact_alone_is_not_asked_for_twice(left):
    state, asked = left((CONTACT,), shows=False)
    assert [finding.judged.candidate for finding in state.findings] == [CONTACT]
    assert not asked


@pytest.mark.parametrize(("seconds", "asked"), [(0.08, 0), (0.2, 0), (0.5, 1)])
def test_a_burst_no_longer_than_what_a_filter_makes_of_a_step_is_no_contact(monkeypatch, seconds, asked):
    tried: list[Candidate] = []

    def try_one(rows: Any, state: State, candidate: Candidate, independent: float) -> Any:
        tried.append(candidate)
        return SimpleNamespace(candidate=candidate, drop=0.0, t=0.0), 1.0

    monkeypatch.setattr(contacts_and_loads, "_test_contact", try_one)
    burst = Candidate("external_contact", (), (("t0", 1.0), ("t1", 1.0 + seconds)), (3, 4, 5))
    data = SimpleNamespace(select_for_candidates=lambda columns, signs: None)
    pool = SimpleNamespace(candidates=(burst, FRICTION))
    state = State(cast(Any, data), cast(Any, pool), MODEL, np.ones(6), np.ones(6))
    contacts_and_loads.find_contacts(state, Preprocessing(10.0, 10.0, 5))
    assert len(tried) == asked


def test_where_a_contact_was_dropped_after_the_search_no_finding_is_left(monkeypatch):
    levels = FamilywiseLevels(1.0, 1.0)
    start = stated((*MODEL, *CONTACT.columns), (found(CONTACT),))
    monkeypatch.setattr(candidate_outcomes, "list_columns_with_findings", lambda pool, base, choices: base)
    monkeypatch.setattr(candidate_outcomes, "score_family", lambda *_: ScoredFamily((), levels))
    record = SearchRecord(start, cast(Any, None))
    final = candidate_outcomes.score_beside_findings(start, record, (), (), ScoredFamily((), levels))
    assert final.state.findings == ()
