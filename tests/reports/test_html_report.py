"""The report of an identification, held against the identification itself."""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime
from functools import cache, wraps
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest
from markupsafe import Markup, escape
from support.joints_at_rest import resting_motion, resting_torque
from support.oracles import arm, fourier_motion, pinocchio_torque, record

from dynident.diagnosis import Change, ChangedValue, Diagnosis, FrictionDifference, compare, diagnose
from dynident.effects import EffectChoice, get_effect
from dynident.errors import DynidentError
from dynident.excitation import DesignRequest, TrajectoryRequest, design_experiment
from dynident.identification import Identification, IdentificationChoices, LadderStep, extend, identify, remove
from dynident.number_format import format_estimate, format_number, format_percent
from dynident.presentation.diagnosis_tables import describe_rivals
from dynident.recordings import Check, Preprocessing, phase_shares
from dynident.recordings.joint_phases import Phase
from dynident.reports import ReportedRecording, html_report
from dynident.reports.figures.ladder import draw_drift
from dynident.reports.figures.residuals import draw_residuals, draw_spectra
from dynident.reports.figures.signals_over_time import draw_torque
from dynident.reports.sections import accuracy
from dynident.robot import Joint, Robot
from dynident.validation import Drift
from dynident.verdict import verdict

PLAIN = arm("scara")
NASTY = '<script>alert("x")</script> & $\\frac{1}$'
ROBOT = Robot(
    NASTY,
    tuple(replace(joint, name=f"{joint.name}<b>$") for joint in PLAIN.joints),
    PLAIN.gravity,
    PLAIN.drives,
    PLAIN.description,
    PLAIN.inertias,
)
EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "coulomb", "viscous"))
MADE = datetime(2026, 3, 4, 5, 6, tzinfo=UTC)
WARNING = Check("sampling_jitter", "warning", "Steps of t run from 8 to 13 ms <i>here</i>.", "t<b>", 17, 2.5)
SECTIONS = (
    "summary",
    "ladder",
    "torque",
    "residuals",
    "diagnosis",
    "parameters",
    "model",
    "robot",
    "data",
    "provenance",
)


def run(seed: int):
    motion = fourier_motion(ROBOT, 16.0, 100.0, seed)
    noise = np.random.default_rng(seed).normal(0, 0.2, motion.q.shape)
    friction = 2 * np.sign(motion.dq) + motion.dq
    friction[:, 0] += 6 * np.exp(-((motion.dq[:, 0] / 0.15) ** 2)) * np.sign(motion.dq[:, 0])
    tau = pinocchio_torque(PLAIN, motion.q, motion.dq, motion.ddq) + friction + noise
    return record(ROBOT, motion, tau, f"run {seed} <u>")


FIRST_RUN, SECOND_RUN, THIRD_RUN = run(1), run(2), run(3)
CHOICES = IdentificationChoices(EFFECTS, preprocessing=Preprocessing(12.0, 8.0, 3, reasons=("Because of <this>.",)))


@pytest.fixture(scope="module", autouse=True)
def _figures_of_the_same_runs_are_drawn_once() -> Iterator[None]:
    """Most pages here are of the same two runs, and drawing those takes most of the time of a page."""
    known: dict[Hashable, tuple[Any, Markup]] = {}

    def drawn_once(draw: Callable[..., Markup]) -> Callable[..., Markup]:
        @wraps(draw)
        def drawn(shown: Any, *more: Any) -> Markup:
            key = draw, tuple(id(one) for one in shown) if isinstance(shown, list) else id(shown), more
            if key not in known:
                known[key] = shown, draw(shown, *more)
            return known[key][1]

        return drawn

    with pytest.MonkeyPatch.context() as patch:
        for draw in (draw_torque, draw_residuals, draw_spectra):
            patch.setattr(accuracy, draw.__name__, drawn_once(draw))
        yield


@cache
def first_model() -> Identification:
    return identify(ROBOT, [FIRST_RUN], [SECOND_RUN], CHOICES)


@cache
def findings() -> Diagnosis:
    return diagnose(first_model(), [FIRST_RUN])


@cache
def second_model() -> Identification:
    return extend(first_model(), [EffectChoice("stribeck", (ROBOT.joint_names[0],))], [FIRST_RUN], [SECOND_RUN])


@cache
def two_runs() -> tuple[ReportedRecording, ...]:
    return (
        ReportedRecording(
            FIRST_RUN, compare(second_model(), FIRST_RUN), False, (WARNING, Check("gaps", "ok", "None."))
        ),
        ReportedRecording(SECOND_RUN, compare(second_model(), SECOND_RUN), True),
    )


@cache
def html() -> str:
    return html_report(second_model(), two_runs(), diagnosis=findings(), created=MADE)


@cache
def whole_page() -> Page:
    return Page(html())


class Page(HTMLParser):
    """What a browser would make of the page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.cells: list[list[str]] = []
        self.section = ""
        self.text: dict[str, str] = {}
        self.data_values: dict[str, list[float]] = {}
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        self.tags.append((tag, given))
        if tag == "section":
            self.section = given["id"] or ""
        if tag == "data":
            self.data_values.setdefault(self.section, []).append(float(given["value"] or "nan"))
        if tag not in ("meta", "br", "path", "use", "image", "rect"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        if tag in self.open:
            while self.open.pop() != tag:
                pass

    def handle_data(self, data: str) -> None:
        self.text[self.section] = self.text.get(self.section, "") + " " + data

    def all_of(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


def test_it_has_every_section_with_a_heading_and_an_entry_in_the_contents() -> None:
    assert [section["id"] for section in whole_page().all_of("section")] == list(SECTIONS)
    assert {f"#{name}" for name in SECTIONS} <= {link.get("href") for link in whole_page().all_of("a")}
    assert whole_page().all_of("html") == [{"lang": "en"}]


def test_values_deviations_and_relative_deviations_are_those_of_the_identification() -> None:
    shown = np.array(whole_page().data_values["parameters"]).reshape(-1, 3)
    by_value = {p.value: p for p in second_model().parameters}
    assert len(shown) == len(second_model().parameters)
    for value, deviation, relative in shown:
        parameter = by_value[value]
        assert deviation == parameter.standard_deviation
        assert relative == parameter.relative_standard_deviation
    for parameter in second_model().parameters:
        text, spread = format_estimate(parameter.value, parameter.standard_deviation)
        assert text in whole_page().text["parameters"]
        assert spread in whole_page().text["parameters"]
        assert parameter.grouping in whole_page().text["parameters"]


def test_shape_constants_have_their_intervals_or_words() -> None:
    by_name = {one.name: one for one in second_model().shape_constants}
    velocity, kind = by_name["vs"], by_name["delta"]
    assert velocity.interval is not None
    text = whole_page().text["parameters"]
    assert " to ".join(format_estimate(end, velocity.standard_deviation)[0] for end in velocity.interval) in text
    assert velocity.description in text
    assert kind.note in text


def test_errors_per_joint_are_those_of_fit_and_held_out_data_where_it_moves_and_on_all_rows() -> None:
    # Of the fit and held out: rms and relative error where joints move, relative error on all rows; the noise floor.
    shown = np.array(whole_page().data_values["torque"][: 7 * ROBOT.n]).reshape(ROBOT.n, 7)
    model = second_model()
    for k, (moving, everywhere) in enumerate(((model.fit_moving, model.fit), (model.held_out_moving, model.held_out))):
        np.testing.assert_array_equal(shown[:, 3 * k], moving.rms)
        np.testing.assert_array_equal(shown[:, 3 * k + 1], moving.relative)
        np.testing.assert_array_equal(shown[:, 3 * k + 2], everywhere.relative)
    for run in two_runs():
        assert format_percent(run.comparison.moving_errors.relative_total) in whole_page().text["torque"]


def test_errors_of_each_recording_are_told_where_they_are_others_than_those_of_fit_and_held_out_data() -> None:
    told = "Relative error per recording"
    assert told not in html()
    third = ReportedRecording(THIRD_RUN, compare(second_model(), THIRD_RUN), True)
    assert told in html_report(second_model(), [*two_runs(), third])
    assert told in html_report(second_model(), [two_runs()[0], third])


def test_the_ladder_shows_the_error_of_every_model_falling() -> None:
    shown = np.array(whole_page().data_values["ladder"]).reshape(2, 3)
    expected = [
        [m.fit_moving.relative_total, m.held_out_moving.relative_total] for m in (first_model(), second_model())
    ]
    np.testing.assert_array_equal(shown[:, :2], expected)
    assert shown[1, 1] < shown[0, 1]
    assert "Stribeck friction on" in whole_page().text["ladder"]


def single_spaced(text: str) -> str:
    """Without line breaks, and with plain spaces between a number and its unit."""
    return " ".join(text.split())


def test_the_first_page_says_what_when_from_which_data_and_the_error_before_and_after() -> None:
    text = single_spaced(whole_page().text["summary"])
    before, after = (model.held_out_judged.relative_total for model in (first_model(), second_model()))
    head = text.partition("Relative error where joints move")[0]
    assert f"robot {NASTY}" in head
    assert "report made 2026-03-04 05:06 UTC" in head
    assert "identified from run 1 <u> held-out recordings run 2 <u>" in head
    assert (
        single_spaced(f"is {format_percent(after)} on held-out data; it was {format_percent(before)} before.") in head
    )
    assert f"Added: Stribeck friction on {ROBOT.joint_names[0]} (" in head
    # Warnings come after all this.
    assert text.index(" about this result") > len(head)
    assert format_number(second_model().equilibrated_condition_number) in text


def test_findings_that_recordings_share_are_one_line() -> None:
    shared = replace(two_runs()[1], checks=(WARNING,))
    page = Page(html_report(second_model(), [two_runs()[0], shared], created=MADE))
    assert page.text["summary"].count(WARNING.detail) == 1
    assert f"{FIRST_RUN.name}, {SECOND_RUN.name}: sampling jitter." in page.text["summary"]


def test_the_ladder_says_which_model_predicts_best_and_from_where_on_the_error_rises() -> None:
    assert "Model 2 predicts held-out data best." in whole_page().text["ladder"]
    assert whole_page().text["ladder"].count("✓ best") == 1
    assert "↑ rises" not in whole_page().text["ladder"]
    worse = replace(first_model(), step=LadderStep(second_model(), removed=second_model().step.added))
    page = Page(html_report(worse, [ReportedRecording(SECOND_RUN, compare(worse, SECOND_RUN), True)]))
    assert "Model 2 predicts held-out data best; from model 3 on" in page.text["ladder"]
    assert page.text["ladder"].count("✓ best") == page.text["ladder"].count("↑ rises") == 1


def test_warnings_and_doubtful_checks_stand_in_the_first_section() -> None:
    assert second_model().warnings
    for warning in second_model().warnings:
        assert warning in whole_page().text["summary"]
    assert WARNING.detail in whole_page().text["summary"]
    assert "None." not in whole_page().text["summary"]
    assert "column t<b>, row 17, t = 2.5 s" in whole_page().text["data"]


def test_the_diagnosis_shows_verdict_ranking_and_evidence() -> None:
    assert findings().candidates
    assert findings().summary in whole_page().text["diagnosis"]
    for candidate in findings().candidates:
        assert candidate.evidence in whole_page().text["diagnosis"]
    drops = whole_page().data_values["diagnosis"][::3]
    assert drops == [candidate.error_drop for candidate in findings().candidates]
    # Held out means another recording: these errors are of blocks of the same one.
    caption = "Ranked effects, with relative errors on blocks left out of the fit"
    assert caption in single_spaced(whole_page().text["diagnosis"])
    figure = next(text for text in re.findall(r'aria-label="([^"]*by candidate effect[^"]*)"', html()))
    assert "blocks left out of the fit" in figure
    assert "held-out" not in figure


def test_a_residual_below_the_noise_floor_is_not_said_to_be_impossible() -> None:
    text = single_spaced(whole_page().text["torque"])
    assert "The noise floor is an estimate" in text
    assert "no model can" not in text


def test_a_verdict_is_green_only_where_every_use_is_fit_without_limit() -> None:
    states = {use.state for use in verdict(second_model()).uses}
    # Fit for something and not judged for something else: not all is well.
    assert "yes" in states or "limited" in states
    assert states != {"yes"}
    assert '<div class="box warning" role="note" aria-label="Verdict">' in html()


def test_the_drift_of_a_simulation_is_a_table_and_a_figure() -> None:
    assert "Drift of the position under the measured torque on held-out data" in html()
    assert "Drift of a simulation without a controller. Without a controller, under the measured torque" in html()
    distance = np.array([[0.001, 0.002], [0.01, np.inf], [0.1, np.nan]])
    drift = Drift(("swing", "lift"), (0.1, 0.5, 2.0), distance, distance, np.ones((3, 2)), 7)
    angle, length = draw_drift(drift, [False, True]).figure.axes  # type: ignore[attr-defined]
    np.testing.assert_allclose(angle.lines[0].get_ydata(), [1.0, 10.0, 100.0])
    # A line ends where the simulation diverged, and metres have a panel of their own.
    assert np.isfinite(length.lines[0].get_ydata()).tolist() == [True, False, False]
    assert "(mm)" in length.get_title("left")


def test_what_a_second_look_is_for_is_folded_away_and_what_was_found_is_not() -> None:
    open_text = re.sub(r"<details>.*?</details>", "", html(), flags=re.DOTALL)
    folded = "".join(re.findall(r"<details>.*?</details>", html(), flags=re.DOTALL))
    assert f"{escape(FIRST_RUN.name)} (identification)" in folded
    assert f"{escape(SECOND_RUN.name)} (held out)" in open_text
    assert WARNING.name.replace("_", " ") in open_text
    for candidate in findings().candidates:
        shown = open_text if candidate.significant else html()
        assert str(escape(candidate.evidence)) in shown
    for parameter in second_model().parameters:
        assert str(escape(parameter.grouping)) in folded


def test_the_robot_the_filters_and_where_it_comes_from_are_told() -> None:
    for joint in ROBOT.joints:
        assert joint.name in whole_page().text["robot"]
    assert "Because of <this>." in whole_page().text["data"]
    for filtered, cutoff in (("position: zero-phase Butterworth", 12), ("acceleration: the same", 24), ("parallel", 8)):
        assert re.search(rf"{filtered} filter[^:]*, cut-off\s+{cutoff}\.0+ Hz", whole_page().text["data"])
    assert "every 3rd row" in whole_page().text["data"]
    assert "2026-03-04 05:06 UTC" in whole_page().text["provenance"]
    assert re.search(r"auto: (feasible parameters|weighted least squares)", whole_page().text["model"])


def test_the_effective_number_of_samples_is_shown_for_every_joint() -> None:
    for effective in second_model().effective_rows:
        assert format_number(float(effective)) in whole_page().text["parameters"]


def test_what_users_call_things_never_becomes_markup() -> None:
    assert not whole_page().all_of("script")
    assert not [tag for tag in ("b", "u", "i", "this") if whole_page().all_of(tag)]
    assert NASTY in whole_page().text["robot"]


def test_nothing_is_loaded_from_anywhere() -> None:
    for tag in ("script", "link", "iframe", "img", "object", "embed"):
        assert not whole_page().all_of(tag)
    for tag, attributes in whole_page().tags:
        for name, value in attributes.items():
            if name in ("href", "src", "xlink:href", "srcset", "data", "action"):
                assert (value or "").startswith(("#", "data:image/png;base64,")), (tag, value)
    addresses = {found for found in re.findall(r"https?://[^\s\"'<>)]+", html()) if "www.w3.org" not in found}
    assert not addresses
    assert "@import" not in html()
    assert not re.search(r"url\((?!#)", html())


def test_every_figure_says_what_it_shows_and_every_table_has_headers() -> None:
    drawn = whole_page().all_of("svg")
    assert len(drawn) >= 5
    assert all(figure["role"] == "img" and figure["aria-label"] for figure in drawn)
    assert all(header.get("scope") in ("col", "row", "rowgroup") for header in whole_page().all_of("th"))
    labels = " ".join(figure["aria-label"] or "" for figure in drawn)
    assert format_percent(float(two_runs()[1].comparison.errors.relative[0])) in labels


def test_references_inside_the_figures_resolve() -> None:
    known = {attributes["id"] for _, attributes in whole_page().tags if "id" in attributes}
    used = {a["xlink:href"][1:] for a in whole_page().all_of("use") if (a.get("xlink:href") or "").startswith("#")}
    used |= set(re.findall(r"url\(#([^)]+)\)", html()))
    assert used <= known


def test_a_long_recording_stays_a_small_file() -> None:
    comparison = two_runs()[1].comparison
    many = 300
    t = np.concatenate([comparison.t + k * 40.0 for k in range(many)])
    long = replace(
        comparison,
        t=t,
        segment=np.repeat(np.arange(many) // 100, len(comparison.t)),
        **{name: np.tile(getattr(comparison, name), (many, 1))
           for name in ("measured", "predicted", "lower", "upper", "deviation", "q", "dq", "ddq", "load", "phase")},
    )  # fmt: skip
    spike = len(t) // 2
    long.measured[spike, 0] += 1234.5
    content = html_report(second_model(), [ReportedRecording(SECOND_RUN, long, True)])
    assert len(content.encode()) < 2_000_000


def test_where_a_joint_stands_the_report_draws_what_friction_may_hold_and_says_how_long() -> None:
    runs = [record(PLAIN, motion := resting_motion(PLAIN, 20.0, 100.0, k), resting_torque(PLAIN, motion, k), f"r{k}")
            for k in (1, 2)]  # fmt: skip
    found = identify(PLAIN, runs[:1], runs[1:])
    comparison = compare(found, runs[1])
    page = Page(html_report(found, [ReportedRecording(runs[1], comparison, True)]))
    described = next(
        svg["aria-label"] or "" for svg in page.all_of("svg") if "residual with its band" in svg["aria-label"]
    )
    for j in range(PLAIN.n):
        share = float((comparison.phase[:, j] == Phase.STANDING).mean())
        assert f"at standstill in {format_percent(share, 2)} of the rows" in described
    assert "range of static friction at standstill" in page.text["torque"]
    assert "On a grey background the joint stands" in page.text["torque"]
    stands = ", ".join(f"{100 * share:.0f}" for share in phase_shares(runs[1]).standing)
    assert f"{stands}\u202f%" in page.text["data"]
    # Where no joint stands nothing is said of it.
    moves = replace(comparison, phase=np.zeros_like(comparison.phase))
    without = Page(html_report(found, [ReportedRecording(runs[1], moves, True)])).text["torque"]
    assert "range of static friction at standstill" not in without
    assert "grey background" not in without


def test_a_set_of_test_motions_is_shown_run_by_run() -> None:
    trajectory = TrajectoryRequest(sets="link_by_link", duration=3.0, harmonics=3, sampling_rate=50.0)
    design = design_experiment(ROBOT, DesignRequest(kind="sequential", trajectory=trajectory))
    text = Page(html_report(second_model(), two_runs(), design=design)).text["design"]
    for run in design.runs:
        assert run.label in text
    assert "between the runs" in text
    assert "tool from the side" in text


def test_the_experiment_is_shown_with_its_limits_where_it_was_designed() -> None:
    design = design_experiment(ROBOT, DesignRequest(kind="random", random_trajectories=5))
    page = Page(html_report(second_model(), two_runs(), design=design))
    assert [section["id"] for section in page.all_of("section")].count("design") == 1
    assert format_number(design.criterion_values.condition_number) in page.text["design"]
    tightest = max(design.margins, key=lambda margin: margin.share)
    assert format_percent(tightest.share) in page.text["design"]
    assert "rad/s" in page.text["design"]
    for note in design.notes:
        assert note in page.text["design"]


def test_what_the_experiment_promised_stands_beside_what_was_achieved() -> None:
    noise = dict.fromkeys(ROBOT.joint_names, 0.1)
    design = design_experiment(ROBOT, DesignRequest(kind="random", random_trajectories=5, noise=noise))
    page = Page(html_report(second_model(), two_runs(), design=design))
    promised = {one.name: one.standard_deviation for one in design.expected}
    shown = 0
    for parameter in second_model().parameters:
        deviation = promised.get(parameter.name)
        if deviation is None or not np.isfinite(deviation):
            continue
        shown += 1
        assert format_number(deviation) in page.text["promises"]
        assert format_number(parameter.standard_deviation / deviation, 2) in page.text["promises"]
    assert shown > 10
    without = Page(
        html_report(second_model(), two_runs(), design=design_experiment(ROBOT, replace(design.request, noise={})))
    )
    assert "promises" not in [section["id"] for section in without.all_of("section")]


def test_without_held_out_data_diagnosis_and_checks_the_report_says_so() -> None:
    alone = identify(ROBOT, [FIRST_RUN], [], CHOICES)
    page = Page(html_report(alone, [ReportedRecording(FIRST_RUN, compare(alone, FIRST_RUN), False)]))
    assert "diagnosis" not in [section["id"] for section in page.all_of("section")]
    assert "No held-out data was given" in page.text["torque"]
    assert "Record another motion, and hold it out." in page.text["summary"]
    assert "was made without the checks" in page.text["data"]
    assert page.data_values["ladder"] == [alone.fit_moving.relative_total]


def test_what_to_do_next_is_told_of_a_model_that_has_all_that_was_recommended() -> None:
    recommended = replace(findings(), recommended=second_model().choices.effects[-1:])
    unseen = replace(second_model(), held_out=None, data=replace(second_model().data, held_out=None))
    page = Page(
        html_report(unseen, [ReportedRecording(FIRST_RUN, compare(unseen, FIRST_RUN), False)], diagnosis=recommended)
    )
    assert "This model contains the recommended effects." in page.text["summary"]
    assert "Record another motion, and hold it out." in page.text["summary"]


def test_a_report_of_no_recording_is_refused() -> None:
    with pytest.raises(DynidentError, match="at least one recording"):
        html_report(second_model(), [])


def test_an_equivalent_effect_that_the_catalogue_does_not_hold_is_named_all_the_same() -> None:
    assert describe_rivals(("unnamed_law", "presliding")).endswith("from: unnamed law, Presliding hysteresis.")


def test_what_has_changed_and_what_friction_did_is_drawn_with_intervals() -> None:
    joint = ROBOT.joint_names[0]
    main = ChangedValue("Fc1", 0.8, "N m", (0.7, 0.9), 2.0)
    change = Change(EffectChoice("coulomb", (joint,), (), ("run 2 <u>",)), main, (), 0.001, "It differs.")
    friction = (
        FrictionDifference(joint, 0.5, 0.8, (0.6, 1.0), "N m", 2.5),
        FrictionDifference(ROBOT.joint_names[1], 0.5, 0.01, (-0.02, 0.04), "N m", 2.5),
        FrictionDifference(ROBOT.joint_names[2], 0.5, 0.01, (-0.02, 0.04), "N m", 0.0),
    )
    found = replace(findings(), changes=(change,), friction=friction)
    page = Page(html_report(second_model(), two_runs(), diagnosis=found))
    described = [svg["aria-label"] or "" for svg in page.all_of("svg")]
    assert any(one.startswith("Differences since the baseline") and "Fc1 0.8" in one for one in described)
    (drawn,) = (one for one in described if one.startswith("Friction since the baseline"))
    # What it was is no more than nothing: there is no share of it to draw.
    assert f"{joint} 32" in drawn
    assert ROBOT.joint_names[2] not in drawn
    assert "Friction since the baseline" not in html_report(
        second_model(), two_runs(), diagnosis=replace(found, friction=())
    )


def test_every_finding_stands_beside_the_residual_that_it_explains() -> None:
    described = [svg["aria-label"] or "" for svg in whole_page().all_of("svg")]
    drawn = next(text for text in described if text.startswith("Mean residual"))
    for item in findings().candidates:
        assert (f"{get_effect(item.effect).title} on {ROBOT.joint_names[0]}" in drawn) == item.significant
    # Nothing to draw it from: the report goes without.
    held_out = [one for one in two_runs() if one.held_out]
    assert "Mean residual" not in html_report(second_model(), held_out, diagnosis=findings())


@pytest.mark.slow
def test_reports_written_at_the_same_time_are_the_same() -> None:
    with ThreadPoolExecutor(3) as pool:
        jobs = [
            pool.submit(html_report, second_model(), two_runs(), diagnosis=findings(), created=MADE) for _ in range(3)
        ]
    assert all(job.result() == html() for job in jobs)


def test_a_sliding_joint_has_its_own_units() -> None:
    sliding: list[Joint] = [joint for joint in ROBOT.joints if joint.kind == "prismatic"]
    assert sliding
    assert re.search(r"\d N\b(?! m)", whole_page().text["torque"])


def test_what_was_removed_is_on_the_ladder():
    back = remove(second_model(), [EffectChoice("stribeck")])
    page = html_report(back, [ReportedRecording(SECOND_RUN, compare(back, SECOND_RUN), True)])
    assert "without Stribeck" in page
    assert page.count(">first model<") == 1
