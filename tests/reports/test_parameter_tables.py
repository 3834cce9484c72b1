"""Parameters and shape constants as tables, as they are shown everywhere."""

from __future__ import annotations

import pytest

from dynident.effects import CATALOGUE, ShapeSpec
from dynident.identification.shape_constant_intervals import ShapeConstant
from dynident.presentation.model_tables import build_shape_table
from dynident.presentation.tables import ReportedTable, make_interval_cell, make_number_cell, make_text_cells

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
