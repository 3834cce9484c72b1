"""Parameters and shape constants as tables, as they are shown everywhere."""

from __future__ import annotations

import pytest

from dynident.effects import CATALOGUE, ShapeSpec
from dynident.identification.shapes.shape_constants import ShapeConstant
from dynident.reports.parameter_tables import shape_table
from dynident.reports.tables import ReportedTable, figure, interval, words

KINDS = [(effect.id, spec) for effect in CATALOGUE.values() for spec in effect.shapes if spec.words]


@pytest.mark.parametrize(("effect", "spec"), KINDS, ids=[f"{effect} {spec.name}" for effect, spec in KINDS])
def test_a_constant_that_is_a_choice_between_kinds_is_shown_by_its_word(effect: str, spec: ShapeSpec) -> None:
    for value, word in spec.words:
        constant = ShapeConstant(effect, ("a",), spec.name, "-", "", value, "chosen")
        (row,) = shape_table([constant], ("a", "b")).texts
        assert word in row
        assert not any(text.lstrip("\N{MINUS SIGN}-+").startswith("1") for text in row)


def test_columns_of_figures_are_those_with_values_or_intervals() -> None:
    row = (*words("run"), figure(1.5, unit="kg"), interval((1.0, 2.0)), *words("yes"))
    table = ReportedTable("Loads", ("name", "mass", "95 % interval", "shows"), (row,))
    assert [table.is_figures(k) for k in range(4)] == [False, True, True, False]
    assert table.texts == [["run", "1.50 kg", "1.00 to 2.00", "yes"]]
    assert table.without("mass").columns == ("name", "95 % interval", "shows")
    assert table.without("mass").texts == [["run", "1.00 to 2.00", "yes"]]


def test_an_interval_without_an_end_is_none() -> None:
    assert interval((None, 2.0)).text == "–"
    assert interval(None, "not identifiable").text == "not identifiable"
