"""Parse and write effects as text: `effect@joint+joint:constant=value`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dynident.effects.catalogue import CATALOGUE, get_constant_word
from dynident.effects.effect_choices import DEFAULT_EFFECTS, EffectChoice
from dynident.errors import DynidentError

_TITLE = "Unusable effect"


def parse_effects(texts: Sequence[str], pointer: str = "/effects") -> tuple[EffectChoice, ...]:
    """Return the effects that texts name; the word `default` stands for the four default ones.

    Parameters
    ----------
    texts : sequence of str
        One or several effects each, separated by commas.
    pointer : str
        JSON pointer to them in the caller's request.

    Returns
    -------
    tuple of EffectChoice
        In the order of the texts.

    Raises
    ------
    DynidentError
        For a text that cannot be read. It is not checked whether the effects and joints exist.
    """
    choices: list[EffectChoice] = []
    for text in split_effects(texts):
        if text == "default":
            choices += DEFAULT_EFFECTS
            continue
        name, joints, shape = parse_effect(text, pointer)
        choices.append(EffectChoice(name, joints, tuple(sorted(shape.items()))))
    return tuple(choices)


def format_effect(choice: EffectChoice, digits: str = ".6g") -> str:
    """Return an effect as text that `parse_effects` reads.

    Parameters
    ----------
    choice : EffectChoice
        The effect, its joints and its shape constants; runs are not part of the text.
    digits : str
        Format of shape constants.

    Returns
    -------
    str
        Such as "stribeck@joint2:vs=0.05".
    """
    return choice.to_text(digits)


def format_constant(effect: str, name: str, value: float) -> str:
    """Return a shape constant of an effect without its unit: "vs = 0.05", "law: dahl".

    Parameters
    ----------
    effect : str
        Id of the effect.
    name : str
        Name of the constant.
    value : float
        Its value.

    Returns
    -------
    str
        With a word for the value where the constant is a choice between kinds.
    """
    word = get_constant_word(effect, name, value)
    return f"{name} = {value:g}" if word is None else f"{name}: {word}"


def split_effects(arguments: Sequence[str]) -> list[str]:
    """Split texts at commas into one text for each effect."""
    texts: list[str] = []
    for item in [item.strip() for text in arguments for item in text.split(",") if item.strip()]:
        # Shape constants are separated by commas, too: `name=value` after an effect with constants belongs to it.
        if texts and "=" in item and ":" not in item and "@" not in item and ":" in texts[-1]:
            texts[-1] += f",{item}"
        else:
            texts.append(item)
    return texts


def parse_effect(text: str, pointer: str) -> tuple[str, tuple[str, ...], dict[str, float]]:
    """Take `effect@joint+joint:constant=value` apart: id, joints, shape constants.

    Parameters
    ----------
    text : str
        One effect.
    pointer : str
        JSON pointer to it in the caller's request.

    Returns
    -------
    tuple of str, tuple of str, dict of str to float
        Id, names of joints, and shape constants by name.

    Raises
    ------
    DynidentError
        For a text that cannot be read. It is not checked whether the effect and its joints exist.
    """
    head, _, constants = text.partition(":")
    name, sign, joints = head.partition("@")
    if not name.strip() or (sign and not joints.strip()):
        raise DynidentError(
            f"cannot read {text!r}; expected effect, effect@joint, effect@joint+joint or effect@joint:constant=value",
            pointer=pointer,
            title=_TITLE,
        )
    # A word such as `dahl` stands for its number. Unknown effects are read too: whether they exist is checked later.
    catalogued = CATALOGUE.get(name.strip())
    words = {
        (spec.name, word): value for spec in (catalogued.shapes if catalogued else ()) for value, word in spec.words
    }
    shape = dict(_parse_constant(item, words, pointer) for item in constants.split(",") if item.strip())
    return name.strip(), tuple(joint.strip() for joint in joints.split("+") if joint.strip()), shape


def _parse_constant(item: str, words: Mapping[tuple[str, str], float], pointer: str) -> tuple[str, float]:
    name, sign, value = item.partition("=")
    if not sign or not name.strip() or not value.strip():
        raise DynidentError(f"cannot read {item.strip()!r}; write name=value", pointer=pointer, title=_TITLE)
    meant = words.get((name.strip(), value.strip().lower()))
    if meant is not None:
        return name.strip(), meant
    try:
        return name.strip(), float(value)
    except ValueError:
        others = [word for constant, word in words if constant == name.strip()]
        detail = f"cannot read {value.strip()!r}; write {' or '.join(others) or 'a number'}"
        raise DynidentError(detail, pointer=pointer, title=_TITLE) from None
