"""Model files of every format that was ever written are read.

The files are of one simulated arm of two joints (a model and one with `offset` added), each written by the last commit
that wrote its format, the third by the first that did. The values were printed by that commit from its own file.
"""

from __future__ import annotations

import io
import json
from pathlib import Path

import numpy as np
import pytest

from dynident.effects import EffectChoice
from dynident.errors import DynidentError
from dynident.identification import from_bytes, remove, to_bytes

FILES = Path(__file__).parent.parent / "older_versions"
NAMES = ["ZZ1", "MX1", "MY1", "ZZ2", "MX2", "MY2", "Ia2", "Fc1", "Fc2", "Fv1", "Fv2", "b1", "b2"]
VALUES = {
    1: "0.928936 1.623786 0.014951 0.077924 0.302661 -0.00093 0.177215 1.806829 0.896559 1.022342 0.379058 0.267762 "
    "-0.00782",
    2: "0.92573 1.622352 0.016075 0.079057 0.302018 -0.00074 0.1743 1.810942 0.894247 1.021801 0.379169 0.249943 "
    "-0.006398",
    3: "0.907662 1.597799 0.036826 0.083721 0.300094 0.002531 0.168169 1.869998 0.906421 0.988235 0.37078 -0.039116 "
    "-0.018264",
}
ERRORS = {1: 0.01796343, 2: 0.01804192, 3: 0.0184016}
CONDITION_NUMBERS = {1: 137.1734, 2: 137.1914, 3: 149.6885}


def content_of(number: int) -> bytes:
    return (FILES / f"model_of_format_{number}.npz").read_bytes()


@pytest.mark.parametrize("number", VALUES)
def test_a_model_of_every_format_is_read_as_it_was_written(number: int) -> None:
    model = from_bytes(content_of(number))
    assert [one.name for one in model.parameters] == NAMES
    np.testing.assert_allclose(model.values, np.array(VALUES[number].split(), dtype=float), atol=1e-6)
    assert model.fit.relative_total == pytest.approx(ERRORS[number], abs=1e-8)
    assert model.condition_number == pytest.approx(CONDITION_NUMBERS[number], abs=1e-4)
    assert [len(step.values) for step in model.ladder()] == [11, 13]
    again = from_bytes(to_bytes(model))
    np.testing.assert_array_equal(again.values, model.values)
    assert to_bytes(again) == to_bytes(model)


@pytest.mark.parametrize("number", VALUES)
def test_a_model_of_every_format_is_gone_on_from(number: int) -> None:
    model = from_bytes(content_of(number))
    without = remove(model, [EffectChoice("offset")])
    parent = model.step.parent
    assert parent is not None
    np.testing.assert_allclose(without.values, parent.values, rtol=0.02, atol=0.02)


def changed(content: bytes, **changes: object) -> bytes:
    arrays = dict(np.load(io.BytesIO(content)))
    header = {**json.loads(arrays["header"].tobytes()), **changes}
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def test_a_model_of_a_newer_format_says_to_update() -> None:
    with pytest.raises(DynidentError, match="has the format 6, but this version reads formats 1 to 5; update dynident"):
        from_bytes(changed(content_of(3), format="dynident identification 6"))


def test_a_model_of_the_first_format_is_refused_where_its_values_mean_something_else() -> None:
    """Its base parameters are not stored: they are determined anew, and must be those that the values are of."""
    choices = json.loads(dict(np.load(io.BytesIO(content_of(1))))["header"].tobytes())["choices"]
    for effects in (choices["effects"][:1], choices["effects"][::-1]):
        with pytest.raises(DynidentError, match="other parameters in this version; identify it again"):
            from_bytes(changed(content_of(1), choices={**choices, "effects": effects}))
    with pytest.raises(DynidentError, match="other parameters in this version; identify it again"):
        from_bytes(changed(content_of(1), worst_inertia_eigenvalue=0.1))
