"""Parameters and shape constants as tables, as they are shown everywhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.oracles import arm, fourier_motion, record

from dynident.effects import CATALOGUE, ShapeSpec
from dynident.identification.shape_constant_intervals import ShapeConstant
from dynident.presentation.model_tables import build_shape_table
from dynident.presentation.recording_tables import ShownRecording, describe_findings
from dynident.presentation.tables import (
    Cell,
    ReportedTable,
    make_interval_cell,
    make_number_cell,
    make_percent_cell,
    make_text_cells,
)
from dynident.presentation.validation_and_verdict_tables import build_figure_tables
from dynident.recordings import Check
from dynident_cli.printed_results import fold_joints

KINDS = [(effect.id, spec) for effect in CATALOGUE.values() for spec in effect.shapes if spec.words]


@pytest.mark.parametrize(("effect", "spec"), KINDS, ids=[f"{effect} {spec.name}" for effect, spec in KINDS])
def test_a_constant_that_is_a_choice_between_kinds_is_shown_by_its_word(effect: str, spec: ShapeSpec) -> None:
    for value, word in spec.words:
        constant = ShapeConstant(effect, ("a",), spec.name, "-", "", value, "chosen")
        (row,) = build_shape_table([constant], ("a", "b")).texts
        assert word in row
        assert not any(text.lstrip("\N{MINUS SIGN}-+").startswith("1") for text in row)


def test_columns_of_figures_are_those_with_values_or_intervals() -> None:
    row = (
        *make_text_cells("run"),
        make_number_cell(1.5, unit="kg"),
        make_interval_cell((1.0, 2.0)),
        *make_text_cells("yes"),
    )
    table = ReportedTable("Loads", ("name", "mass", "95 % interval", "shows"), (row,))
    assert [table.is_figures(k) for k in range(4)] == [False, True, True, False]
    assert table.texts == [["run", "1.50 kg", "1.00 to 2.00", "yes"]]
    assert table.drop_columns("mass").columns == ("name", "95 % interval", "shows")
    assert table.drop_columns("mass").texts == [["run", "1.00 to 2.00", "yes"]]


def test_an_interval_without_an_end_is_none() -> None:
    assert make_interval_cell((None, 2.0)).text == "–"
    assert make_interval_cell(None, "not identifiable").text == "not identifiable"


def test_a_long_table_is_folded_to_the_rows_with_the_largest_numbers() -> None:
    values = [0.1, -5.0, None, 0.3, 4.0, 0.2]
    rows = tuple((*make_text_cells(f"joint{k}"), make_number_cell(value, 2)) for k, value in enumerate(values))
    rows = (*rows[:2], (rows[2][0], Cell("diverged", mark="warning")), *rows[3:])
    table = ReportedTable("Errors", ("joint", "error"), (*rows, (*make_text_cells("all"), make_number_cell(9.0, 2))))
    folded = table.fold_rows("error", most=3, last=1)
    # In their order: a simulation that diverged, and the largest numbers, whatever their sign.
    assert [row[0] for row in folded.texts] == ["joint1", "joint2", "joint4", "3 others", "all"]
    assert folded.texts[3] == ["3 others", "at most 0.30"]
    assert table.fold_rows("error", most=5, last=1) is table


def test_joints_without_a_number_do_not_push_out_those_with_the_largest() -> None:
    values = [None] * 10 + [float(k) for k in range(1, 11)]
    rows = tuple((*make_text_cells(f"joint{k}"), make_number_cell(value)) for k, value in enumerate(values))
    folded = ReportedTable("Errors", ("joint", "error"), rows).fold_rows("error", most=8)
    assert [row[0] for row in folded.texts] == [*(f"joint{k}" for k in range(12, 20)), "12 others"]
    assert folded.texts[-1] == ["12 others", "at most 2.00"]


def test_tables_of_a_humanoid_on_the_screen_show_its_worst_joints() -> None:
    def build(count: int) -> ReportedTable:
        rows = tuple((*make_text_cells(f"joint{k}"), make_number_cell(float(k))) for k in range(count))
        return ReportedTable("Errors", ("joint", "error"), rows)

    arm, humanoid = build(12), build(29)
    assert fold_joints(arm, "error") is arm
    names = [row[0] for row in fold_joints(humanoid, "error").texts]
    assert names == [*(f"joint{k}" for k in range(21, 29)), "21 others"]


def test_the_total_of_an_earlier_version_does_not_stand_below_errors_of_other_rows() -> None:
    def build(moving: dict[str, object] | None) -> ReportedTable:
        own = {"relative": [0.02], "relative_total": 0.02, "moving": {"relative": [0.01], "relative_total": 0.01}}
        keys = ("worst_posture", "methods", "simulations", "drift", "contact", "filters", "bootstrap", "payloads")
        document = dict.fromkeys(keys) | {"methods": [], "simulations": [], "payloads": []}
        document["measurements"] = [{"name": name, "errors": own} for name in ("a", "b")]
        document["total"] = own | {"moving": moving}
        (table,) = build_figure_tables(document, ["elbow"])
        return table

    assert [row[0] for row in build({"relative": [0.01], "relative_total": 0.01}).texts] == ["a", "b", "all"]
    assert [row[0] for row in build(None).texts] == ["a", "b"]


def test_what_is_found_of_several_recordings_alike_is_said_once() -> None:
    motion = fourier_motion(arm("scara"), 2.0, 50.0)
    recording = record(arm("scara"), motion, np.zeros_like(motion.q))
    gap, jitter = Check("gaps", "warning", "a gap"), Check("sampling_jitter", "warning", "it jitters")
    shown = [
        ShownRecording(replace(recording, name=f"run{k}"), (jitter, gap) if k == 2 else (Check("gaps", "ok", ""), gap))
        for k in range(1, 6)
    ]
    assert list(describe_findings(shown)) == [
        "! run1, run2, run3 and 2 more, gaps: a gap",
        "! run2, sampling jitter: it jitters",
    ]


def test_a_column_of_numbers_stays_one_where_all_are_missing() -> None:
    row = (Cell("run 1"), make_number_cell(None, unit="N m"), make_percent_cell(None))
    table = ReportedTable("Runs", ("run", "error", "promised"), (row,))
    assert [table.is_figures(k) for k in range(3)] == [False, True, True]
