"""One robot over many days, in another motion on each: what changed is told with the day from which it did."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from support.further_hidden_effects import loaded
from support.hidden_effects import BAND, EFFORT, NAMES, ROBOT, WITH_OFFSET, Hidden, motions, nothing, on_joint, recorded

from dynident.diagnosis.candidates.time_blocks_and_folds import ProductStack
from dynident.diagnosis.diagnosis_result import Change, ChangedValue
from dynident.diagnosis.monitoring import (
    Day,
    Measure,
    ParameterTrack,
    Series,
    SeriesChange,
    build_measure,
    days_from_bytes,
    days_to_bytes,
    find_free_name,
    load_days,
    monitor_days,
    reduce_day,
)
from dynident.diagnosis.monitoring.parameter_tracks import StepProductStack, widen_intervals
from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.estimation import Reduction, concatenate_reductions, solve_weighted, statistics
from dynident.identification import Identification, IdentificationChoices, identify
from dynident.reports.figures.changes import draw_parameter_tracks

CHOICES = IdentificationChoices(WITH_OFFSET, preprocessing=BAND)
COUNT = 5

Hiding = Callable[[int], Hidden]


def worn_from(day: int) -> Hiding:
    law = on_joint(2, lambda q, v, _: 0.3 * EFFORT[2] * (0.04 * np.sign(v) + 0.03 * v))
    return lambda k: law if k >= day else nothing


def loaded_between(first: int, last: int) -> Hiding:
    return lambda k: loaded if first <= k < last else nothing


def made(hiding: Hiding, count: int = COUNT) -> tuple[Identification, Measure, list[Day]]:
    recordings = [recorded(motions(20 + k)[0], hiding(k), 90 + k, f"day {k + 1}") for k in range(count)]
    model = identify(ROBOT, recordings[:1], [], CHOICES)
    measure = build_measure(model)
    return model, measure, [reduce_day(measure, one.name, [one]) for one in recordings]


def told(hiding: Hiding, count: int = COUNT) -> Series:
    _, measure, days = made(hiding, count)
    return monitor_days(measure, days)


@pytest.mark.slow
def test_where_nothing_changed_every_day_agrees() -> None:
    found = told(lambda k: nothing)
    assert found.changes == ()
    assert "no change" in found.summary
    inside = [
        (course.intervals[:, 0] <= 0.04 * EFFORT[j]) & (0.04 * EFFORT[j] <= course.intervals[:, 1])
        for j, name in enumerate(NAMES)
        for course in found.courses
        if (course.effect, course.joint) == ("coulomb", name)
    ]
    assert np.mean(inside) >= 0.8


@pytest.mark.slow
def test_wear_is_told_with_the_day_from_which_it_is_there_and_its_size() -> None:
    found = told(worn_from(3))
    assert {(one.change.choice.effect, one.change.choice.joints) for one in found.changes} <= {
        ("coulomb", NAMES[2:3]),
        ("viscous", NAMES[2:3]),
    }
    coulomb = next(one for one in found.changes if one.change.choice.effect == "coulomb")
    assert (coulomb.earliest, coulomb.since, coulomb.latest) == (3, 3, 3)
    low, high = coulomb.change.main.interval
    assert low <= 0.3 * 0.04 * EFFORT[2] <= high
    assert "from day 4 on" in found.summary
    course = next(one for one in found.courses if one.parameter == "Fc3")
    assert course.varies
    assert course.values[3:].min() > course.values[:3].max()


@pytest.mark.slow
def test_a_tool_that_was_mounted_and_taken_off_again_is_told_as_both() -> None:
    found = told(loaded_between(2, 4), 6)
    masses = [one for one in found.changes if one.change.choice.effect == "payload"]
    assert {one.change.choice.joints for one in masses} == {NAMES[-1:]}
    assert [one.since for one in masses] == [2, 4]
    on, off = (one.change.main for one in masses)
    assert on.interval[0] <= 2.5 <= on.interval[1]
    assert off.value == pytest.approx(-2.5, rel=0.1)


@pytest.mark.slow
def test_one_more_day_costs_its_own_recording_alone_and_says_the_same() -> None:
    model, measure, days = made(worn_from(3))
    kept = days_to_bytes(measure, days[:-1])
    again, known = load_days(model, kept)
    assert [day.name for day in known] == [day.name for day in days[:-1]]
    one, other = monitor_days(measure, days), monitor_days(again, [*known, days[-1]])
    assert one.summary == other.summary
    for mine, theirs in zip(one.courses, other.courses, strict=True):
        np.testing.assert_allclose(mine.values, theirs.values, rtol=1e-9)


@pytest.mark.slow
def test_a_day_by_itself_has_the_values_of_an_identification_of_that_day() -> None:
    _, measure, days = made(lambda k: nothing, 2)
    found = monitor_days(measure, days)
    own = days[1].reduction.select_columns(np.arange(measure.model.n_parameters))
    solution = solve_weighted(own)
    half = statistics(own, solution).half_widths()
    steady = [k for k, course in enumerate(found.courses) if not course.varies]
    assert steady
    for k in steady:
        assert found.courses[k].values[1] == pytest.approx(solution.values[k], rel=1e-8)
        assert found.courses[k].intervals[1, 1] - found.courses[k].values[1] == pytest.approx(half[k], rel=1e-6)
    both = concatenate_reductions([day.reduction for day in days])
    assert both.n_blocks == sum(day.reduction.n_blocks for day in days)


@pytest.mark.slow
def test_days_that_cannot_be_a_series_are_refused_with_what_is_wrong() -> None:
    model, measure, days = made(lambda k: nothing, 2)
    with pytest.raises(DynidentError, match="at least two days"):
        monitor_days(measure, days[:1])
    with pytest.raises(DynidentError, match="two days have the name 'day 1'"):
        monitor_days(measure, [days[0], days[0]])
    plain = identify(ROBOT, [recorded(motions(20)[0], nothing, 90, "day 1")], [], IdentificationChoices())
    other = build_measure(plain)
    with pytest.raises(DynidentError, match="another model"):
        monitor_days(other, days)
    with pytest.raises(DynidentError, match="another model"):
        days_from_bytes(other, days_to_bytes(measure, days))
    with pytest.raises(DynidentError, match="not a file of days"):
        load_days(model, b"no zip at all")
    grown = identify(
        ROBOT,
        [recorded(motions(20)[0], nothing, 90, "day 1"), recorded(motions(21)[0], loaded, 91, "day 2")],
        [],
        IdentificationChoices((*WITH_OFFSET, EffectChoice("payload", (), (), ("day 2",))), preprocessing=BAND),
    )
    with pytest.raises(DynidentError, match="in some runs only"):
        reduce_day(build_measure(grown), "day 1", [recorded(motions(20)[0], nothing, 90, "day 1")])


@pytest.mark.slow
def test_the_figure_has_a_panel_for_each_joint_and_parameter_that_may_vary() -> None:
    drawn = str(draw_parameter_tracks(told(worn_from(1), 2)))
    for parameter in ("Fc1", "Fv6", "b3"):
        assert parameter in drawn
    assert "from day 2 on" in drawn


def test_what_days_differ_in_without_a_change_widens_the_interval_of_one() -> None:
    rng = np.random.default_rng(5)
    held = wide = 0
    for _ in range(200):
        days = 3.0 + 0.2 * rng.normal(size=10)
        days[6:] += 1.0
        course = ParameterTrack("Fc1", "coulomb", "j1", "N m", days, np.column_stack([days - 0.01, days + 0.01]), True)
        value = float(days[6:].mean() - days[:6].mean())
        main = ChangedValue("Fc1", value, "N m", (value - 0.02, value + 0.02))
        told = Change(EffectChoice("coulomb", ("j1",)), main, (), 0.001, "")
        (one,) = widen_intervals([SeriesChange(told, 6, 6, 6)], [course])
        low, high = one.change.main.interval
        held += low <= 1.0 <= high
        wide += high - low > 0.04
    assert 0.92 <= held / 200 <= 0.98
    assert wide == 200
    quiet = ParameterTrack("Fc1", "coulomb", "j1", "N m", np.repeat([3.0, 4.0], [6, 4]), np.zeros((10, 2)), True)
    assert widen_intervals([SeriesChange(told, 6, 6, 6)], [quiet])[0].change.main.interval == pytest.approx(
        told.main.interval
    )


def test_a_second_file_of_one_name_gets_a_name_of_its_own() -> None:
    nothing_measured = Reduction(0, (), np.zeros((0, 2)))
    taken = [Day(name, nothing_measured, np.zeros(1), "") for name in ("log", "log (2)")]
    assert find_free_name("log", taken) == "log (3)"
    assert find_free_name("run", taken) == "run"


def test_products_of_columns_that_begin_on_a_day_are_those_of_columns_with_zeros_before_it() -> None:
    rng = np.random.default_rng(3)
    day = np.repeat([0, 1, 2], 4)
    rows = rng.normal(size=(12, 5, 3))
    values = rows.transpose(0, 2, 1) @ rows
    places, since = np.array([0, 1, 0, 1, 2]), np.array([0, 0, 1, 2, 0])
    wide = rows[:, :, places] * (day[:, None] >= since)[:, None, :]
    expected = ProductStack(wide.transpose(0, 2, 1) @ wide)
    stepped = StepProductStack(values, places, since, day)
    np.testing.assert_allclose(stepped.total, expected.total)
    every = np.arange(5)
    np.testing.assert_allclose(
        stepped.take_products(every[:, None], every), expected.take_products(every[:, None], every)
    )
