"""Name the missing physics: rank every effect by what it does to data it was not fitted to, and add what survives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dynident.diagnosis.candidates import Candidate, Pool, build_pool, width_shows
from dynident.diagnosis.compare import Comparison, compare
from dynident.diagnosis.gate import SMALLEST_GAIN_OVER_NOISE, Judged, judge, p_value, simplest
from dynident.diagnosis.residuals import angle_lines, failure_map, noise_floor, unknown_patterns
from dynident.diagnosis.resolution import Resolution, resolution
from dynident.diagnosis.result import Diagnosis, Invisible
from dynident.diagnosis.scoring import Products, held_out_errors, products, score_candidates
from dynident.diagnosis.words import Finding, next_experiment, rank_all, summary, verdict_of
from dynident.effects import EffectChoice, columns_of, effect_by_id
from dynident.identification import Identification, extend
from dynident.identification.shapes import refine_shapes
from dynident.progress import Progress, part, silent
from dynident.recordings import Preprocessing, Recording
from dynident.regressors.model import Model, build_model
from dynident.regressors.observation import Observation
from dynident.regressors.stream import reduce_recordings
from dynident.robot.model import FloatArray
from dynident.threads import single_threaded

DEFAULT_MOST_EFFECTS = 8
_KINDS = ("interleaved", "contiguous")
_VISIBLE = 0.02
_PRUNE_DROP, _PRUNE_T = 0.01, 1.5


@dataclass(frozen=True, eq=False)
class _State:
    """The search so far: the model's columns, the residual (n,) they leave, sensor noise (n,), what was picked."""

    base: tuple[int, ...]
    noise: FloatArray
    floor: FloatArray
    picks: tuple[Finding, ...]


@single_threaded
def diagnose(
    identification: Identification,
    recordings: Sequence[Recording],
    *,
    candidates: Sequence[str] | None = None,
    most_effects: int = DEFAULT_MOST_EFFECTS,
    progress: Progress = silent,
) -> Diagnosis:
    """Find what is missing in an identified model.

    Parameters
    ----------
    identification : Identification
    recordings : sequence of Recording
        The data to learn from; usually those the model was identified on. What is recommended has improved the
        prediction of stretches that were left out of the fit.
    candidates : sequence of effect ids, optional
        Only these effects; the whole catalogue otherwise.
    most_effects : int
        At most so many effects are recommended.
    """
    for index, name in enumerate(candidates or ()):
        effect_by_id(name, f"/candidates/{index}")
    model = identification.model
    comparisons = [compare(identification, recording, part(progress, 0.0, 0.1)) for recording in recordings]
    resolved = resolution(comparisons, identification.preprocessing)
    pool = build_pool(model, candidates, angle_lines(comparisons, model.robot), resolved)
    floor = noise_floor(recordings, identification.preprocessing)
    reference = identification.standard_inertia()
    reduction = reduce_recordings(
        pool.observation, recordings, identification.preprocessing, reference, part(progress, 0.1, 0.5)
    )
    data = products(reduction)
    first = _judge_all(data, pool, tuple(range(pool.n_base)), pool.candidates, identification.statistics.noise)
    start = _State(tuple(range(pool.n_base)), identification.statistics.noise, floor, ())
    picks = _search(data, pool, start, first, most_effects, part(progress, 0.5, 0.8))
    picks, recommended = _refined(identification, picks, recordings, reference, resolved, part(progress, 0.8, 0.9))
    final = _extended_comparisons(identification, recommended, recordings, comparisons, part(progress, 0.9, 1.0))
    unknown = unknown_patterns(final)
    residual = _rms(final)
    ranked = rank_all(picks, first, recommended)
    verdict = verdict_of(recommended, unknown)
    invisible = _invisible(first)
    progress(1.0, "diagnosed")
    return Diagnosis(
        verdict=verdict,
        summary=summary(verdict, ranked, unknown, residual, floor, model),
        noise_floor=floor,
        residual_rms=residual,
        candidates=ranked,
        recommended=recommended,
        unknown=unknown,
        not_visible=invisible,
        failure_map=failure_map(comparisons),
        next_experiment=next_experiment(ranked, invisible, model.effects),
    )


def _rms(comparisons: Sequence[Comparison]) -> FloatArray:
    squares = np.sum([(c.residual**2).sum(axis=0) for c in comparisons], axis=0)
    return np.asarray(np.sqrt(squares / sum(len(c.t) for c in comparisons)), dtype=np.float64)


def _judge_all(
    data: Products, pool: Pool, base: tuple[int, ...], candidates: Sequence[Candidate], noise: FloatArray
) -> list[Judged]:
    columns = np.array(base, dtype=np.intp)
    scores = [score_candidates(data, columns, candidates, noise, kind)[1] for kind in _KINDS]
    return [
        judge(pair, joints_acted_on(pool, candidate), noise)
        for candidate, *pair in zip(candidates, *scores, strict=True)
    ]


def joints_acted_on(pool: Pool, candidate: Candidate) -> tuple[int, ...]:
    """Indices of the joints whose torque a candidate contributes to."""
    acts = np.isin(pool.observation.entry_columns, candidate.columns)
    return tuple(int(j) for j in np.unique(pool.observation.entry_rows[acts]))


def _search(
    data: Products, pool: Pool, state: _State, first: list[Judged], most: int, progress: Progress
) -> tuple[Finding, ...]:
    """Add the best effect that passes the gate, again and again, until none does; then drop what became superfluous."""
    judged = first
    remaining = list(pool.candidates)
    while len(state.picks) < most:
        progress(len(state.picks) / most, f"{len(state.picks)} effects found, {len(remaining)} candidates")
        passing = [item for item in judged if _acceptable(data, pool, state, item, len(judged))]
        if not passing:
            break
        chosen, equal = simplest(passing)
        chosen = _without_idle_joints(data, pool, state, chosen)
        finding = Finding(chosen, equal, p_value(chosen, len(remaining)))
        base = state.base + chosen.candidate.columns
        state = _State(base, _noise(data, base), state.floor, (*state.picks, finding))
        remaining = [c for c in remaining if not _superseded(c, chosen.candidate)]
        if not remaining:
            break
        judged = _judge_all(data, pool, state.base, remaining, state.noise)
    return _pruned(data, pool, state)


def _noise(data: Products, base: tuple[int, ...]) -> FloatArray:
    """(n,): held-out residual of every joint for the model so far."""
    columns = np.array(base, dtype=np.intp)
    squares = held_out_errors(data, columns, np.ones(data.n_joints), "interleaved").sum(axis=0)
    sigma = np.sqrt(squares / data.counts.sum())
    return np.asarray(np.maximum(sigma, 1e-9 * max(float(sigma.max()), 1e-12)))


def _superseded(candidate: Candidate, chosen: Candidate) -> bool:
    """Whether a candidate is the chosen one in other words: the same family on a joint that it already has."""
    if candidate.columns == chosen.columns:
        return True
    if candidate.effect != chosen.effect:
        return False
    if effect_by_id(candidate.effect).shapes and effect_by_id(candidate.effect).shapes[0].proposal == "angle_spectrum":
        return candidate.joints == chosen.joints and candidate.shape == chosen.shape
    return not candidate.joints or bool(set(candidate.joints) & set(chosen.joints))


def _acceptable(data: Products, pool: Pool, state: _State, item: Judged, n_tried: int) -> bool:
    effect = effect_by_id(item.candidate.effect)
    if item.separability < _VISIBLE or not item.passes(effect.scope == "robot", n_tried):
        return False
    if item.gain_over(state.floor, data.counts, whole_robot=effect.scope == "robot") < SMALLEST_GAIN_OVER_NOISE:
        return False
    return not effect.is_friction or _passive(data, pool, state, item)


def _passive(data: Products, pool: Pool, state: _State, item: Judged) -> bool:
    """Whether friction still takes energy from every joint on the whole, with the candidate's friction among it.

    The work of a joint's friction is measured against the Coulomb column: Σ sign(q̇) τf over each stretch.
    """
    columns = np.array(state.base + item.candidate.columns, dtype=np.intp)
    chi = _fit(data, columns, state.noise)
    all_columns = pool.observation.columns
    for j in item.joints:
        where = data.position[j]
        coulomb = [k for k in columns if all_columns[k].effect == "coulomb" and where[k] >= 0]
        friction = [
            i for i, k in enumerate(columns) if effect_by_id(all_columns[k].effect).is_friction and where[k] >= 0
        ]
        if not coulomb or not friction:
            continue
        places = where[columns[friction]]
        work = data.grams[j][:, where[coulomb[0]], places] @ chi[friction]
        if float(np.minimum(work, 0.0).sum()) < -0.1 * float(np.abs(work).sum()):
            return False
    return True


def _fit(data: Products, columns: np.ndarray[tuple[int], np.dtype[np.intp]], noise: FloatArray) -> FloatArray:
    k = len(columns)
    normal, right = np.zeros((k, k)), np.zeros(k)
    for gram, where, sigma in zip(data.grams, data.position, noise, strict=True):
        have = np.flatnonzero(where[columns] >= 0)
        places = where[columns[have]]
        total = gram.sum(axis=0) / sigma**2
        normal[np.ix_(have, have)] += total[np.ix_(places, places)]
        right[have] += total[places, -1]
    scale = np.sqrt(np.maximum(np.diag(normal), np.finfo(float).tiny))
    return np.asarray(np.linalg.lstsq(normal / np.outer(scale, scale), right / scale, rcond=1e-10)[0] / scale)


def _without_idle_joints(data: Products, pool: Pool, state: _State, chosen: Judged) -> Judged:
    """Take joints out of a group that gain nothing from it."""
    if len(chosen.candidate.joints) < 2:
        return chosen
    effect = effect_by_id(chosen.candidate.effect)
    keep = []
    for name in chosen.candidate.joints:
        j = pool.observation.robot.joint_names.index(name)
        gain = (chosen.before[:, j] - chosen.after[:, j]) / state.noise[j] ** 2
        spread = float(gain.std(ddof=1)) / np.sqrt(len(gain))
        share = float(gain.sum()) / max(float((chosen.before[:, j] / state.noise[j] ** 2).sum()), 1e-300)
        if share >= _PRUNE_DROP and gain.mean() >= _PRUNE_T * spread:
            keep.append(name)
    if not keep or len(keep) == len(chosen.candidate.joints):
        return chosen
    columns = tuple(k for k in chosen.candidate.columns if pool.observation.columns[k].link in keep)
    smaller = Candidate(effect.id, tuple(keep), chosen.candidate.shape, columns)
    return _judge_all(data, pool, state.base, [smaller], state.noise)[0]


def _pruned(data: Products, pool: Pool, state: _State) -> tuple[Finding, ...]:
    """Drop picks that later ones have made superfluous."""
    picks = list(state.picks)
    if len(picks) < 2:
        return tuple(picks)
    for finding in list(picks):
        candidate = finding.judged.candidate
        base = tuple(k for k in state.base if k not in candidate.columns)
        again = _judge_all(data, pool, base, [candidate], state.noise)[0]
        if again.drop < _PRUNE_DROP or again.t < _PRUNE_T:
            picks.remove(finding)
            state = replace(state, base=base)
    return tuple(picks)


def _refined(
    identification: Identification,
    picks: Sequence[Finding],
    recordings: Sequence[Recording],
    reference: FloatArray,
    resolved: Resolution,
    progress: Progress,
) -> tuple[tuple[Finding, ...], tuple[EffectChoice, ...]]:
    """The picks with their shape constants refined, without those that only made up for another's coarse shape.

    A peak of friction whose best width is below what the data resolve made up for sticking, not for Stribeck friction.
    """
    kept = tuple(picks)
    choices = tuple(finding.judged.candidate.choice for finding in kept)
    if not choices:
        return (), ()
    model, preprocessing = identification.model, identification.preprocessing
    choices = refine_shapes(model, choices, recordings, preprocessing, reference, part(progress, 0.0, 0.5))
    visible = [i for i, choice in enumerate(choices) if width_shows(choice, model.robot, resolved)]
    kept, choices = tuple(kept[i] for i in visible), tuple(choices[i] for i in visible)
    while len(kept) > 1:
        needed = _needed(model, kept, choices, recordings, preprocessing, reference)
        if len(needed) == len(kept):
            break
        kept, choices = tuple(kept[i] for i in needed), tuple(choices[i] for i in needed)
        choices = refine_shapes(model, choices, recordings, preprocessing, reference)
    lasting = _lasting(model, choices)
    return tuple(kept[i] for i in lasting), tuple(choices[i] for i in lasting)


def _lasting(model: Model, choices: tuple[EffectChoice, ...]) -> list[int]:
    """Indices of the choices of which at least one column is independent of the model and of those before it."""
    if not choices:
        return []
    grown = build_model(model.robot, model.effects + choices, signals=model.signals)
    independent = {(column.effect, column.name, column.shape) for column in grown.kept}
    return [
        i
        for i, choice in enumerate(choices)
        if any((c.effect, c.name, c.shape) in independent for c in columns_of([choice], model.signals))
    ]


def _needed(
    model: Model,
    picks: Sequence[Finding],
    choices: Sequence[EffectChoice],
    recordings: Sequence[Recording],
    preprocessing: Preprocessing,
    reference: FloatArray,
) -> list[int]:
    """Indices of the picks that still improve the prediction beside the others, with the shapes of `choices`."""
    columns = list(model.kept)
    refined: list[Finding] = []
    for finding, choice in zip(picks, choices, strict=True):
        made = columns_of([choice], model.signals)
        numbers = tuple(range(len(columns), len(columns) + len(made)))
        candidate = Candidate(choice.effect, choice.joints, choice.shape, numbers)
        refined.append(replace(finding, judged=replace(finding.judged, candidate=candidate)))
        columns += made
    observation = Observation.of(model.robot, columns, model.signals)
    pool = Pool(observation, model.n_parameters, tuple(finding.judged.candidate for finding in refined))
    data = products(reduce_recordings(observation, recordings, preprocessing, reference))
    everything = tuple(range(len(columns)))
    still = _pruned(data, pool, _State(everything, _noise(data, everything), np.zeros(data.n_joints), tuple(refined)))
    return [i for i, finding in enumerate(refined) if any(finding is other for other in still)]


def _extended_comparisons(
    identification: Identification,
    recommended: Sequence[EffectChoice],
    recordings: Sequence[Recording],
    comparisons: Sequence[Comparison],
    progress: Progress,
) -> list[Comparison]:
    """The residual that is left once everything recommended is in the model."""
    if not recommended:
        return list(comparisons)
    grown = extend(identification, recommended, recordings, (), progress)
    return [compare(grown, recording) for recording in recordings]


def _invisible(judged: Sequence[Judged]) -> tuple[Invisible, ...]:
    by_effect: dict[tuple[str, tuple[str, ...]], float] = {}
    for item in judged:
        if len(item.candidate.joints) > 1:
            continue
        key = (item.candidate.effect, item.candidate.joints)
        by_effect[key] = max(by_effect.get(key, 0.0), item.separability)
    return tuple(
        Invisible(
            effect,
            joints,
            f"only {share:.1%} of its column is left beside the model on this motion, so it could not have shown",
        )
        for (effect, joints), share in by_effect.items()
        if share < _VISIBLE
    )
