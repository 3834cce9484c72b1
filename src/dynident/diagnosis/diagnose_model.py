"""`diagnose`: run a whole diagnosis, from recordings and a model to ranked effects and recommended ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

from dynident.array_types import FloatArray
from dynident.diagnosis.ambiguities import Doubt, find_dependent_findings, find_misnamed, list_doubts
from dynident.diagnosis.candidates.candidate_pool import build_pool
from dynident.diagnosis.changes_between_recordings import (
    add_friction_differences,
    compute_friction_differences,
    list_changes,
    prepare_undisturbed,
    word_changes,
)
from dynident.diagnosis.comparison.measured_against_predicted import Comparison, compare
from dynident.diagnosis.comparison.noise_floor import estimate_sensor_noise
from dynident.diagnosis.conclusion import compute_held_out_ratio, conclude, point_to_check
from dynident.diagnosis.decision_levels import DecisionRules
from dynident.diagnosis.diagnosis_request import DiagnosisChoices, check_recordings
from dynident.diagnosis.diagnosis_result import (
    Change,
    DetectionLimit,
    Diagnosis,
    FrictionDifference,
    Invisible,
    RankedEffect,
)
from dynident.diagnosis.diagnosis_summary import (
    UNDETERMINED,
    compute_residual_over_noise,
    compute_residual_rms,
    rank_findings,
    rank_rejected,
    select_verdict,
    word_summary,
)
from dynident.diagnosis.disturbances import PUSH, select_comparable
from dynident.diagnosis.outcome_reasons import CandidateOutcome, Reason
from dynident.diagnosis.residuals.failure_map_and_unknown_patterns import build_failure_map, find_unknown_patterns
from dynident.diagnosis.residuals.resolution_at_reversals import Resolution, compute_resolution
from dynident.diagnosis.residuals.shape_proposals import ShapeProposals, propose_shapes
from dynident.diagnosis.search.candidate_outcomes import add_limits, list_outcomes, list_untried, score_beside_findings
from dynident.diagnosis.search.comparison_of_rivals import name_findings
from dynident.diagnosis.search.contacts_and_loads import find_contacts, propose_carriers
from dynident.diagnosis.search.detection_limits import compute_detection_limits
from dynident.diagnosis.search.finding_refinement import (
    RecordedSource,
    predict_with_findings,
    refine_constants,
    refine_findings,
)
from dynident.diagnosis.search.forward_selection import (
    EarlierSearch,
    search_findings,
    settle_findings,
)
from dynident.diagnosis.search.identifiability_and_invisible_effects import (
    compute_part_to_part_ratio,
    extend_with_findings,
    find_invisible,
    list_too_large_limits,
    list_unaddable,
)
from dynident.diagnosis.search.pruning import RefinedModel
from dynident.diagnosis.search.search_state import Finding, ScoredFamily, SearchRecord, State, score_family
from dynident.diagnosis.search.static_friction import find_static_friction
from dynident.effects import CATALOGUE, EffectChoice
from dynident.effects.effect_columns import is_lasting_change
from dynident.identification import Identification
from dynident.identification.description_prior import build_prior
from dynident.identification.equations.reduced_recordings import split_friction_tests
from dynident.parallel import single_threaded
from dynident.progress import Progress, ignore_progress, scale_progress
from dynident.recordings import Check, Recording
from dynident.regressors.observation_matrix import RegressorInputs
from dynident.robot.limits_and_drives import split_hardware


@dataclass(frozen=True, eq=False)
class Examination:
    """A diagnosis, its doubts, and the data behind it.

    Parameters
    ----------
    diagnosis : Diagnosis
        The diagnosis.
    doubts : tuple of Doubt
        What it leaves open, most important first.
    identification : Identification
        The model in question, identified on both sets of recordings where there was a baseline.
    comparisons : tuple of Comparison
        Its prediction of each of the recordings.
    recordings : tuple of Recording
        The recordings, without tests of single joints' friction.
    """

    diagnosis: Diagnosis
    doubts: tuple[Doubt, ...]
    identification: Identification
    comparisons: tuple[Comparison, ...]
    recordings: tuple[Recording, ...]


def diagnose(
    identification: Identification,
    recordings: Sequence[Recording],
    choices: DiagnosisChoices | None = None,
    *,
    baseline: Sequence[Recording] = (),
    validation: Sequence[Recording] = (),
    with_limits: bool = True,
    progress: Progress = ignore_progress,
) -> Diagnosis:
    """Find the effects that are missing in an identified model.

    Parameters
    ----------
    identification : Identification
        The identified model.
    recordings : sequence of Recording
        The data to learn from; usually those the model was identified on. A recommended effect has improved the
        prediction of blocks that were left out of the fit. Tests of single joints' friction are left out.
    choices : DiagnosisChoices, optional
        Which effects are tried, and the levels that a request sets.
    baseline : sequence of Recording, optional
        Earlier recordings of the same robot: differences of `recordings` from these are returned as changes. The model
        is then identified on both, and detection limits are those of effects that arms often have.
    validation : sequence of Recording, optional
        Recordings of the same robot that the model was not identified from. They propose nothing, but a finding that
        they do not confirm is none. With a baseline they are not used.
    with_limits : bool
        Whether detection limits are computed: they take a quarter of the time, and change nothing that is recommended.
        Without them a diagnosis that finds nothing cannot tell whether anything is missing.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.

    Returns
    -------
    Diagnosis
        Verdict, ranking, and what the data could not tell.

    Raises
    ------
    DynidentError
        For recordings of poses at rest, in which nothing that is missing shows.
    """
    return examine(
        identification,
        recordings,
        choices,
        baseline=baseline,
        validation=validation,
        with_limits=with_limits,
        progress=progress,
    ).diagnosis


@single_threaded
def examine(
    identification: Identification,
    recordings: Sequence[Recording],
    choices: DiagnosisChoices | None = None,
    *,
    baseline: Sequence[Recording] = (),
    validation: Sequence[Recording] = (),
    checks: Mapping[str, Sequence[Check]] | None = None,
    with_limits: bool = True,
    progress: Progress = ignore_progress,
) -> Examination:
    """Find missing effects as `diagnose` does, and keep what advice on the next experiment needs.

    Parameters
    ----------
    identification : Identification
        The identified model.
    recordings : sequence of Recording
        The data to learn from, as for `diagnose`.
    choices : DiagnosisChoices, optional
        Which effects are tried, and the levels that a request sets.
    baseline, validation : sequence of Recording, optional
        Earlier recordings of the same robot, and held-out ones, as for `diagnose`.
    checks : mapping of str to sequence of Check, optional
        Checks of the `recordings`, by name: a fault that one of them names looks like a missing effect.
    with_limits : bool
        Whether detection limits are computed, as for `diagnose`.
    progress : Progress
        Called with the fraction done and a message; may raise to cancel.

    Returns
    -------
    Examination
        The diagnosis, its doubts, and the data behind it.

    Raises
    ------
    DynidentError
        For recordings of poses at rest, in which nothing that is missing shows.
    """
    check_recordings((*recordings, *baseline))
    choices = choices or DiagnosisChoices()
    candidates = choices.candidates
    # What is said with the request counts more than what was said with the robot.
    has, absent = split_hardware({**identification.model.robot.hardware, **choices.hardware})
    held_out_ratio = compute_held_out_ratio(identification)
    n_later = len(split_friction_tests(recordings)[0])
    undisturbed, since = prepare_undisturbed(identification, recordings, baseline)
    identification, recordings = undisturbed.identification, undisturbed.recordings
    model = identification.model
    comparisons = [compare(identification, recording, scale_progress(progress, 0.0, 0.1)) for recording in recordings]
    resolved = compute_resolution(comparisons, identification.preprocessing)
    tried = candidates or [name for name, effect in CATALOGUE.items() if effect.hardware not in absent]
    # The floor must not depend on the model, in which something may be missing.
    floor = estimate_sensor_noise(recordings, identification.preprocessing)
    rules = choices.rules
    # A difference between days is none of held-out recordings, of which nobody says on which day they were made.
    held_out, cut_sentences = select_comparable(identification, recordings, () if baseline else validation)
    question = _Question(identification, recordings, held_out, comparisons, tried, resolved, floor, since, rules)
    leads = propose_shapes(comparisons, recordings, identification, since)
    leads = replace(leads, carriers=propose_carriers(identification, leads.run_groups, question.inputs))
    search = _search_effects(question, leads, scale_progress(progress, 0.1, 0.5))
    refined = _refine_search(question, leads, search, scale_progress(progress, 0.5, 0.56))
    if refined is not None:
        # Let the rows of the first search go before those of the second are gathered.
        del search
        leads, earlier = refined
        search = _search_effects(question, leads, scale_progress(progress, 0.56, 0.7), earlier)
    family, record = search.family, search.record
    record.state = name_findings(record.rows, record.state)
    findings, recommended, grown, undetermined, final = _refine_findings(
        question, record, scale_progress(progress, 0.7, 0.9)
    )
    unknown = find_unknown_patterns(final)
    # An effect whose residual still depends on the same variable has the wrong name, and misleads later ones.
    wrong = find_misnamed(findings, recommended, unknown, final)
    if wrong:
        dependent = find_dependent_findings(findings, wrong, search.start, family.scored)
        record.dropped.update((findings[k].judged.candidate, Reason.build("superfluous")) for k in dependent)
        record.dropped.update((findings[k].judged.candidate, Reason.build("misnamed")) for k in wrong)
        findings, recommended = _drop_findings(findings, recommended, [*wrong, *dependent])
        findings, recommended, grown, more, final = _identify_with_findings(
            question, record, findings, recommended, scale_progress(progress, 0.9, 1.0)
        )
        undetermined += more
        unknown = find_unknown_patterns(final)
    # Of two days, halts would have to be asked apart.
    if not baseline:
        grown, final, held = find_static_friction(grown, recordings, final, candidates, rules.significance)
        findings = (*findings, *held)
        recommended = (*recommended, *(finding.judged.candidate.choice for finding in held))
        unknown = find_unknown_patterns(final) if held else unknown
    residual = compute_residual_rms(final)
    # Who names the effects to try gets no others.
    contacts = () if candidates and PUSH not in candidates else undisturbed.contacts
    pushes = tuple(finding.judged.candidate.choice for finding in contacts)
    everything, named = (*contacts, *findings), (*pushes, *recommended)
    ranking = _rank_candidates(
        search, everything, named, has, with_limits=with_limits, only_common_limits=bool(baseline)
    )
    ranked, limits = ranking.ranked, ranking.limits
    unknown = (*undisturbed.unexplained_patterns, *unknown)
    # The contacts stand first in the ranking, and are no changes of the robot; `identify_on_both` puts the later
    # recordings last.
    changes, friction = (
        _list_differences(grown, findings, ranked[len(contacts) :], since, recordings, final[-n_later:])
        if baseline
        else (None, ())
    )
    # What changed is no part of the model: that is of both sets of recordings.
    missing = (*pushes, *(choice for choice in recommended if not is_lasting_change(choice, since)))
    verdict = select_verdict(missing, unknown, compute_residual_over_noise(final, floor))
    lasting_effects = [ranked_effect for ranked_effect in ranked if not is_lasting_change(ranked_effect.choice, since)]
    hidden = (*undetermined, *find_invisible(family.scored))
    conclusion = conclude(
        verdict,
        unknown,
        limits if with_limits else None,
        (held_out_ratio, ranking.part_to_part),
        model.robot.joint_names,
        is_given_up=record.is_undetermined,
    )
    pointed = "" if verdict == "adequate" else point_to_check(checks or {})
    if pointed:
        conclusion = replace(conclusion, next_step=f"{pointed} {conclusion.next_step}")
    sentences = [
        *([pointed] if pointed else []),
        *([word_changes(model.robot, changes, friction)] if changes is not None else []),
        *undisturbed.sentences,
        *cut_sentences,
        word_summary(verdict, conclusion, lasting_effects, unknown, residual, floor, model, has),
        *([UNDETERMINED] if record.is_undetermined else []),
    ]
    progress(1.0, "diagnosed")
    diagnosis = Diagnosis(
        # What the residual says is worth nothing where the data do not determine the model.
        verdict="cannot_tell" if conclusion.code == "cannot_tell" else verdict,
        summary=" ".join(sentences),
        noise_floor=floor,
        residual_rms=residual,
        candidates=ranked,
        recommended=missing,
        unknown=unknown,
        not_visible=hidden + list_too_large_limits(limits, hidden, ranking.outcomes),
        failure_map=build_failure_map(comparisons),
        changes=changes,
        friction=friction,
        detection_limits=limits,
        conclusion=conclusion,
        outcomes=(*ranking.outcomes, *list_untried(ranking.outcomes, candidates, model, leads, absent)),
    )
    doubts = list_doubts(findings, recommended, hidden, model.robot, family.scored, candidates or ())
    return Examination(diagnosis, doubts, identification, tuple(comparisons), tuple(recordings))


@dataclass(frozen=True, eq=False)
class _Question:
    """What a search needs besides its proposals: model, data, effects to try, resolution, noise, levels."""

    identification: Identification
    recordings: Sequence[Recording]
    validation: Sequence[Recording]
    comparisons: Sequence[Comparison]
    effects: Sequence[str]
    resolved: Resolution
    floor: FloatArray
    since: tuple[str, ...]
    rules: DecisionRules

    @cached_property
    def inputs(self) -> RegressorInputs:
        """The recordings, with filters and reference of the model, and what the user knows of its parameters."""
        plain = self.identification
        known = build_prior(plain.model, replace(plain.choices.trust, prior=None))
        reference = plain.estimate.next_reference()
        return RegressorInputs(self.recordings, plain.preprocessing, reference, known, kept_rows={})


class _Search(NamedTuple):
    """The state that a search starts from, the candidates' scores there, and what the search found."""

    start: State
    family: ScoredFamily
    record: SearchRecord


def _search_effects(
    question: _Question, leads: ShapeProposals, progress: Progress, earlier: EarlierSearch | None = None
) -> _Search:
    """Search all effects on the grid of their shape constants, and settle what was found.

    A search with an earlier one goes on beside what that one found, refined.
    """
    model = question.identification.model
    known, choices = (None, ()) if earlier is None else (earlier.pool, earlier.choices)
    pool = build_pool(model, question.effects, leads, question.resolved, known, choices)
    rows = RecordedSource(model, question.inputs)
    # One pass over the recordings: every score of the search comes from these products.
    data = rows.gather_products(pool, scale_progress(progress, 0.0, 0.5))
    base, plain = tuple(range(pool.n_base)), question.identification
    start = State(data, pool, base, plain.noise, question.floor, (), question.rules)
    # Contacts disturb the model that the search starts from.
    contacts = find_contacts(start, plain.preprocessing)
    for contact in contacts:
        start = start.add_finding(contact)
    start = start.estimate_noise() if contacts else start
    family = score_family(start, pool.initial_candidates, None if earlier is None else earlier.family, ())
    record = search_findings(start, family, rows, scale_progress(progress, 0.5, 1.0), earlier)
    settle_findings(record)
    return _Search(start, family, record)


def _refine_search(
    question: _Question, leads: ShapeProposals, search: _Search, progress: Progress
) -> tuple[ShapeProposals, EarlierSearch] | None:
    """Refine what was found, and propose what it hid in the residual; None where another search would find the same.

    What constants of the grid are off by hides small effects, and gives others the wrong name: a delay beside a slip
    that was a third too short was called friction that depends on the position.
    """
    model, record = question.identification.model, search.record
    if not record.state.findings:
        return None
    findings, choices = refine_constants(model, record.state.findings, question.inputs, question.resolved, progress)
    refined = RefinedModel.from_choices(model, findings, choices, question.since, question.inputs, question.floor)
    left = predict_with_findings(model, refined.state, question.inputs, question.comparisons)
    more_leads = leads.add_lines(left, model.robot)
    # Contacts are found anew at the start of every search.
    lasting = [pair for pair in zip(findings, choices, strict=True) if not pair[0].is_transient]
    before = [finding.judged.candidate.choice for finding in record.added]
    last = [choice for _, choice in lasting]
    # Beside the same constants, and without a new line, it would end where it ended.
    if more_leads is leads and last == before:
        return None
    staying = [finding for finding, _ in lasting]
    return more_leads, EarlierSearch(search.start.pool, search.family, staying, last, record.losses)


class _Refined(NamedTuple):
    """Findings that stay, the model with them, what cannot be added to it, and what that model leaves."""

    findings: tuple[Finding, ...]
    recommended: tuple[EffectChoice, ...]
    grown: Identification
    undetermined: tuple[Invisible, ...]
    final: list[Comparison]


def _refine_findings(question: _Question, record: SearchRecord, progress: Progress) -> _Refined:
    """Refine what was found on all rows, and put it to the test by identifying the model with it."""
    findings, recommended, dropped = refine_findings(
        question.identification,
        record.state.findings,
        question.inputs,
        question.resolved,
        question.floor,
        question.since,
        scale_progress(progress, 0.0, 0.6),
    )
    record.dropped.update(dropped)
    return _identify_with_findings(question, record, findings, recommended, scale_progress(progress, 0.6, 1.0))


def _identify_with_findings(
    question: _Question,
    record: SearchRecord,
    findings: tuple[Finding, ...],
    recommended: tuple[EffectChoice, ...],
    progress: Progress,
) -> _Refined:
    """Identify the model with findings, less those that cannot be added or explain nothing any more in it."""
    identification, recordings = question.identification, question.recordings
    grown, dropped = extend_with_findings(identification, recommended, recordings, question.validation, progress)
    record.dropped.update((findings[k].judged.candidate, reason) for k, reason in dropped.items())
    undetermined = list_unaddable(recommended, dropped)
    findings, recommended = _drop_findings(findings, recommended, list(dropped))
    is_extended = grown is not identification
    final = [compare(grown, recording) for recording in recordings] if is_extended else list(question.comparisons)
    return _Refined(findings, recommended, grown, undetermined, final)


def _list_differences(
    grown: Identification,
    findings: Sequence[Finding],
    ranked: Sequence[RankedEffect],
    since: tuple[str, ...],
    recordings: Sequence[Recording],
    later: Sequence[Comparison],
) -> tuple[tuple[Change, ...], tuple[FrictionDifference, ...]]:
    """List what the later recordings have and the baseline has not, and how the friction of every joint differs."""
    grown = add_friction_differences(grown, since, recordings)
    changes = list_changes(grown, findings, ranked[: len(findings)], since)
    return changes, compute_friction_differences(grown, since, later)


class _Ranking(NamedTuple):
    """All effects beside what was found: ranking, outcomes, detection limits, and how parts predict each other."""

    ranked: tuple[RankedEffect, ...]
    outcomes: tuple[CandidateOutcome, ...]
    limits: tuple[DetectionLimit, ...]
    part_to_part: float


def _rank_candidates(
    search: _Search,
    findings: Sequence[Finding],
    choices: Sequence[EffectChoice],
    has: Sequence[str],
    *,
    with_limits: bool,
    only_common_limits: bool,
) -> _Ranking:
    """Score every candidate once more beside all findings, and say what became of it."""
    first, record = search.family.scored, search.record
    final = score_beside_findings(search.start, record, findings, choices, search.family)
    outcomes, beside = list_outcomes(final, record, choices, first)
    limits = compute_detection_limits(final, choices, only_common=only_common_limits) if with_limits else ()
    outcomes = add_limits(outcomes, limits)
    ranked_findings = rank_findings(findings, choices, has)
    ranked = (*ranked_findings, *rank_rejected(outcomes, first, beside, len(ranked_findings)))
    return _Ranking(ranked, outcomes, limits, compute_part_to_part_ratio(final.state))


def _drop_findings(
    findings: tuple[Finding, ...], recommended: tuple[EffectChoice, ...], gone: Sequence[int]
) -> tuple[tuple[Finding, ...], tuple[EffectChoice, ...]]:
    """Return the findings without those of these numbers."""
    remaining = [k for k in range(len(findings)) if k not in gone]
    return tuple(findings[k] for k in remaining), tuple(recommended[k] for k in remaining)
