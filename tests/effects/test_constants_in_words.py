"""Constants that are a choice between kinds are told, and read, in words."""

from __future__ import annotations

import pytest

from dynident.effects import CATALOGUE, EffectChoice
from dynident.effects.written import written_effects
from dynident.errors import DynidentError
from dynident.export.summary import effect_line
from dynident.reports.words import shape_text

DAHL = EffectChoice("presliding", ("elbow",), (("d0", 2e-3), ("law", -1.0)))
TURNED = EffectChoice("transmission_coupling", ("wrist",), (("side", -1.0),))


def test_nobody_reads_a_number_for_a_kind():
    assert shape_text(DAHL) == "d0 = 0.002 rad, law: dahl"
    assert effect_line(DAHL) == "presliding on elbow (d0 = 0.002, law: dahl)"
    assert shape_text(TURNED) == "side: difference"


@pytest.mark.parametrize("text", ["presliding@elbow:d0=0.002,law=dahl", "presliding@elbow:d0=0.002,law=-1"])
def test_a_kind_is_read_as_its_word_or_its_number(text):
    assert written_effects([text]) == (DAHL,)


def test_a_word_that_is_none_is_answered_with_those_there_are():
    with pytest.raises(DynidentError, match="cannot read 'maxwell'; write stop or dahl"):
        written_effects(["presliding:law=maxwell"])


def test_every_constant_that_is_no_quantity_and_has_two_signs_has_words():
    for effect in CATALOGUE.values():
        for spec in effect.shapes:
            if spec.unit == "-" and spec.signed:
                assert {value for value, _ in spec.words} == {1.0, -1.0}, (effect.id, spec.name)
