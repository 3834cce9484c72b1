from __future__ import annotations

import threading
import time
from datetime import timedelta
from importlib import import_module
from pathlib import Path

import pytest

from dynident_service.problems import ProblemError, make_problem
from dynident_service.storage import job_queue as ledger_module
from dynident_service.storage.database import BUSY_TIMEOUT_MS, Database, migrate
from dynident_service.storage.job_queue import JobQueue, LostClaim, QueueHealth
from dynident_service.storage.repository_values import NewJob

JOB = NewJob("report", "nowhere:nothing", {"a": 1})


@pytest.fixture
def leases_run_out_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ledger_module, "FIRST_LEASE", timedelta(seconds=-1))
    monkeypatch.setattr(ledger_module, "SECOND_LOOK", -1.0)


def test_jobs_that_others_hold_take_no_slots_of_ours(ledger: JobQueue) -> None:
    for _ in range(5):
        ledger.enqueue(JOB)
    others = ledger.claim(2, own=[])
    ours = ledger.claim(2, own=[])
    assert len(others) == len(ours) == 2
    assert ledger.claim(2, own=[claim.job_id for claim in ours]) == []
    ledger.record_success(ours[0], lambda session: None)
    assert len(ledger.claim(2, own=[claim.job_id for claim in ours])) == 1  # its process may not have told yet


@pytest.mark.parametrize("folder", ["work", "job_functions"])
def test_jobs_that_an_earlier_version_queued_name_functions_that_are_there(ledger: JobQueue, folder: str) -> None:
    former = (
        "comparisons:compare_model",
        "current_models:find_currents",
        "designs:design",
        "diagnoses:diagnose_model",
        "drive_gains:find_gains",
        "identifications:identify_model",
        "identifications:extend_model",
        "identifications:remove_from_model",
        "reports:write_report",
        "series:follow_robot",
        "simulations:measure_virtual_robot",
        "validations:validate_model",
    )
    for function in former:
        ledger.enqueue(NewJob("report", f"dynident_service.{folder}.{function}", {}))
    for claim in ledger.claim(len(former)):
        module, _, name = claim.function.partition(":")
        assert callable(getattr(import_module(module), name))


def test_only_as_many_jobs_are_taken_as_there_are_slots_oldest_first(ledger: JobQueue) -> None:
    ids = [ledger.enqueue(JOB) for _ in range(4)]
    assert len(ledger.claim(slots=2)) == 2
    assert ledger.claim(slots=2) == []
    (third,) = ledger.claim(slots=3)
    taken = {job_id for job_id in ids if ledger.get(job_id).state == "running"}
    assert third.job_id in taken
    assert len(taken) == 3
    assert dict(third.arguments) == {"a": 1}


def test_a_job_whose_lease_ran_out_is_given_to_the_next_and_the_first_holder_is_fenced_off(
    ledger: JobQueue, leases_run_out_at_once: None
) -> None:
    job_id = ledger.enqueue(JOB)
    (first,) = ledger.claim(1)
    (second,) = ledger.claim(1)
    assert (first.job_id, second.job_id) == (job_id, job_id)
    assert second.attempt == first.attempt + 1
    written: list[str] = []
    with pytest.raises(LostClaim):
        ledger.record_success(first, lambda session: written.append("first"))
    with pytest.raises(LostClaim):
        ledger.record_progress(first, 0.5, "still here")
    ledger.record_failure(first, make_problem(500, "late"))
    assert ledger.renew(first) == "lost"
    assert ledger.get(job_id).state == "running"
    ledger.record_success(second, lambda session: written.append("second"))
    assert written == ["second"]
    assert ledger.get(job_id).state == "succeeded"


def test_a_job_whose_workers_keep_dying_is_given_up_with_the_reason(ledger: JobQueue) -> None:
    job_id = ledger.enqueue(JOB)
    for _ in range(2):
        (claim,) = ledger.claim(1)
        ledger.record_death(claim, "its process was killed by SIGKILL")
    job = ledger.get(job_id)
    assert job.state == "failed"
    assert job.error is not None
    assert "SIGKILL" in job.error["detail"]


def test_giving_a_job_back_does_not_count_as_a_death(ledger: JobQueue) -> None:
    job_id = ledger.enqueue(JOB)
    for _ in range(5):
        (claim,) = ledger.claim(1)
        ledger.release(claim)
    assert ledger.get(job_id).state == "queued"


def test_a_job_is_not_given_up_for_what_was_not_its_fault(ledger: JobQueue) -> None:
    job_id = ledger.enqueue(JOB)
    for _ in range(10):
        (claim,) = ledger.claim(1)
        ledger.record_loss(claim, "the database was away")
    (claim,) = ledger.claim(1)
    ledger.record_death(claim, "its process was killed by SIGSEGV")
    assert ledger.get(job_id).state == "queued"
    (claim,) = ledger.claim(1)
    ledger.record_death(claim, "its process was killed by SIGSEGV")
    assert ledger.get(job_id).state == "failed"


def test_a_job_that_takes_its_worker_down_again_and_again_is_given_up_in_the_end(ledger: JobQueue) -> None:
    job_id = ledger.enqueue(JOB)
    for _ in range(ledger_module.MOST_LOSSES):
        (claim,) = ledger.claim(1)
        ledger.record_loss(claim, "its worker was lost")
    job = ledger.get(job_id)
    assert job.state == "failed"
    assert job.error is not None
    assert "50 attempts" in job.error["detail"]


def test_a_holder_that_was_away_for_a_moment_keeps_its_job(ledger: JobQueue, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ledger_module, "FIRST_LEASE", timedelta(seconds=-1))
    ledger.enqueue(JOB)
    (claim,) = ledger.claim(1)
    assert ledger.claim(1) == []  # the lease has run out, but was seen so for the first time
    assert ledger.renew(claim) == "held"
    assert ledger.claim(1) == []
    assert ledger.get_standing(claim) == "held"


def test_leases_are_longer_than_anybody_waits_for_a_lock() -> None:
    assert timedelta(seconds=30) <= ledger_module.LEASE
    assert timedelta(milliseconds=BUSY_TIMEOUT_MS) * 1.5 < ledger_module.LEASE


def test_results_and_the_end_of_a_job_are_stored_together_or_not_at_all(ledger: JobQueue) -> None:
    job_id = ledger.enqueue(JOB)
    (claim,) = ledger.claim(1)

    def store(session: object) -> None:
        raise OSError("the disk is full")

    with pytest.raises(OSError, match="disk"):
        ledger.record_success(claim, store)
    assert ledger.get(job_id).state == "running"
    assert [event.event for event in ledger.read_events(job_id)[0]] == ["state", "state"]


def test_cancelling_a_queued_job_needs_no_worker_and_twice_does_no_harm(ledger: JobQueue) -> None:
    job_id = ledger.enqueue(JOB)
    assert ledger.cancel(job_id).state == "cancelled"
    assert ledger.cancel(job_id).state == "cancelled"
    assert ledger.claim(1) == []


def test_a_running_job_that_is_to_be_cancelled_cannot_succeed_any_more(ledger: JobQueue) -> None:
    job_id = ledger.enqueue(JOB)
    (claim,) = ledger.claim(1)
    ledger.cancel(job_id)
    assert ledger.get_standing(claim) == "cancel"
    with pytest.raises(LostClaim):
        ledger.record_success(claim, lambda session: None)
    ledger.record_cancellation(claim)
    assert ledger.get(job_id).state == "cancelled"


def test_cancelling_what_has_ended_is_a_conflict(ledger: JobQueue) -> None:
    job_id = ledger.enqueue(JOB)
    (claim,) = ledger.claim(1)
    ledger.record_success(claim, lambda session: None)
    with pytest.raises(ProblemError) as caught:
        ledger.cancel(job_id)
    assert caught.value.problem.status == 409


def test_the_history_resumes_after_an_event_and_says_when_it_is_over(ledger: JobQueue) -> None:
    job_id = ledger.enqueue(JOB)
    (claim,) = ledger.claim(1)
    ledger.record_progress(claim, 0.25, "a quarter")
    events, ended = ledger.read_events(job_id)
    assert [event.event for event in events] == ["state", "state", "progress"]
    assert not ended
    ledger.record_failure(claim, make_problem(422, "no rows are left"))
    later, ended = ledger.read_events(job_id, after=events[-1].id)
    assert [event.data["state"] for event in later] == ["failed"]
    assert later[0].data["error"]["detail"] == "no rows are left"
    assert ended


def test_several_takers_at_once_never_take_a_job_twice(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'shared.sqlite3'}"
    first = Database(url)
    migrate(first)
    for _ in range(60):
        JobQueue(first).enqueue(JOB)
    taken: list[str] = []

    def take() -> None:
        database = Database(url)
        ledger = JobQueue(database)
        while claims := ledger.claim(slots=1000):
            for claim in claims:
                taken.append(claim.job_id)
                ledger.record_success(claim, lambda session: None)
        database.close()

    threads = [threading.Thread(target=take) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(taken) == len(set(taken)) == 60
    first.close()


def test_the_strain_tells_how_long_the_queue_is_and_why_jobs_were_begun_again(ledger: JobQueue) -> None:
    assert ledger.measure_health() == QueueHealth(0.0, 0, 0)
    ledger.enqueue(JOB)
    time.sleep(0.02)
    assert 0.02 <= ledger.measure_health().oldest_queued < 60
    (claim,) = ledger.claim(1)
    ledger.record_loss(claim, "its worker was lost")
    (claim,) = ledger.claim(1)
    ledger.record_death(claim, "killed")
    (claim,) = ledger.claim(1)
    ledger.record_loss(claim, "its worker was lost")
    (claim,) = ledger.claim(1)
    assert ledger.measure_health() == QueueHealth(0.0, 1, 2)
