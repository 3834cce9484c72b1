"""Constants that are a choice between kinds are told, and read, in words."""

from __future__ import annotations

import json
import re
from dataclasses import replace

import pytest
from support.oracles import arm

from dynident.effects import CATALOGUE, EffectChoice
from dynident.effects.effect_columns import check_shape_constants
from dynident.effects.effect_text_format import format_effect, parse_effects
from dynident.errors import DynidentError
from dynident.export.comments_and_names import describe_effect
from dynident.identification import IdentifiedParameter, ShapeConstant
from dynident.identification.identified_models.remove_and_solve_again import subtract_effects
from dynident.presentation.labels import format_shape_constants

ROBOT = arm("scara")

DAHL = EffectChoice("presliding", ("elbow",), (("d0", 2e-3), ("law", -1.0)))
TURNED = EffectChoice("transmission_coupling", ("wrist",), (("side", -1.0),))


KINDS = [(effect.id, spec.name, value, word) for effect in CATALOGUE.values() for spec in effect.shapes
         for value, word in spec.words]  # fmt: skip
"""Every constant of the catalogue that is a choice between kinds, with each of its values."""


def test_there_are_kinds_to_be_told():
    assert {("presliding", "law"), ("transmission_coupling", "side")} <= {(effect, name) for effect, name, *_ in KINDS}


@pytest.mark.parametrize(("effect", "name", "value", "word"), KINDS)
def test_every_way_to_show_a_kind_says_its_word_and_no_number(effect, name, value, word):
    choice = EffectChoice(effect, ("elbow",), ((name, value),))
    constant = ShapeConstant(effect, ("elbow",), name, "-", "which of them", value, "chosen")
    parameter = IdentifiedParameter(
        "P", 2.0, "N m", 0.1, 0.05, "determined", 1.0, effect, "elbow", "P", shape=((name, value),)
    )
    assert constant.word == word
    assert parameter.shape == choice.shape == ((name, value),)
    shown = [
        repr(choice),
        repr(constant),
        repr(parameter),
        format_effect(choice),
        describe_effect(choice),
        format_shape_constants(choice),
    ]
    with pytest.raises(DynidentError) as refused:
        subtract_effects((EffectChoice(effect, (), ((name, -value),)),), (replace(choice, joints=()),), ROBOT)
    for text in (*shown, refused.value.detail):
        assert re.search(rf"{name}(=|: ){word}\b", text), text
        assert not re.search(rf"{name}\s*[=:]\s*[-+]?\d", text), text


@pytest.mark.parametrize(("effect", "name", "value", "word"), KINDS)
def test_a_kind_stays_a_number_for_programs(effect, name, value, word):
    choice = EffectChoice(effect, (), ((name, value),))
    assert choice.shape_values == {name: value}
    assert json.loads(json.dumps(choice.shape_values)) == {name: value}
    assert parse_effects([format_effect(choice)]) == (choice,)


@pytest.mark.parametrize(("effect", "name"), sorted({(effect, name) for effect, name, *_ in KINDS}))
def test_what_is_no_kind_is_answered_with_those_there_are(effect, name):
    with pytest.raises(DynidentError) as refused:
        check_shape_constants(EffectChoice(effect, (), ((name, 0.0),)))
    for word in (word for one, of, _, word in KINDS if (one, of) == (effect, name)):
        assert f"({word})" in refused.value.detail


def test_other_constants_are_told_as_numbers_with_their_runs():
    choice = EffectChoice("stribeck", ("elbow",), (("vs", 0.05),), ("run2",))
    assert repr(choice) == "EffectChoice(stribeck@elbow:vs=0.05, runs=('run2',))"
    assert repr(EffectChoice("of_nobody", (), (("c", 1.0),))) == "EffectChoice(of_nobody:c=1)"


def test_nobody_reads_a_number_for_a_kind():
    assert format_shape_constants(DAHL) == "d0 = 0.002 rad, law: dahl"
    assert describe_effect(DAHL) == "presliding on elbow (d0 = 0.002, law: dahl)"
    assert format_shape_constants(TURNED) == "side: difference"


@pytest.mark.parametrize("text", ["presliding@elbow:d0=0.002,law=dahl", "presliding@elbow:d0=0.002,law=-1"])
def test_a_kind_is_read_as_its_word_or_its_number(text):
    assert parse_effects([text]) == (DAHL,)


def test_a_word_that_is_none_is_answered_with_those_there_are():
    with pytest.raises(DynidentError, match="cannot read 'maxwell'; write stop or dahl"):
        parse_effects(["presliding:law=maxwell"])


def test_every_constant_that_is_no_quantity_and_has_two_signs_has_words():
    for effect in CATALOGUE.values():
        for spec in effect.shapes:
            if spec.unit == "-" and spec.signed:
                assert {value for value, _ in spec.words} == {1.0, -1.0}, (effect.id, spec.name)
