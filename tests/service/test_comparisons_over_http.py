"""What can be asked of a comparison that is stored: maps over any two signals, spectra, autocorrelation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from fastapi.testclient import TestClient

from dynident.diagnosis import Comparison
from dynident.diagnosis.comparison.comparison_files import write_comparison
from dynident.recordings.joint_phases import Phase
from dynident_service.storage.repository_values import NewResource, OwnedObject
from dynident_service.storage_and_engine import Services

M = 3000
REST = slice(1000, 2000)
T = np.arange(M) / 50.0
TEMPERATURE = 30.0 + 0.2 * T


def comparison(*, temperature: bool) -> Comparison:
    """Two joints: one has a ripple of 20 in a turn and a vibration of 6 Hz; the other stands for the middle third.

    There friction may hold 1 N m either way, and the torque is the noise beyond that, now above, now below.
    """
    q = np.column_stack([2.0 * np.sin(0.3 * T), np.full(M, 0.3)])
    dq = np.column_stack([0.6 * np.cos(0.3 * T), np.zeros(M)])
    noise = 0.05 * np.random.default_rng(0).normal(size=(M, 2))
    residual = noise + np.column_stack([0.7 * np.sin(20.0 * q[:, 0]) + 0.4 * np.sin(2 * np.pi * 6.0 * T), 0.0 * T])
    zeros = np.zeros((M, 2))
    predicted = np.full((M, 2), 5.0)
    measured, lower, upper, phase = predicted + residual, predicted.copy(), predicted.copy(), np.zeros((M, 2), np.int8)
    phase[REST, 1] = Phase.STANDING
    lower[REST, 1], upper[REST, 1] = 4.0, 6.0
    measured[REST, 1] = np.where(noise[REST, 1] > 0, 6.0, 4.0) + noise[REST, 1]
    return Comparison(
        joint_names=("shoulder", "elbow"),
        units=("N m", "N m"),
        t=T,
        segment=np.zeros(M),
        measured=measured,
        predicted=predicted,
        lower=lower,
        upper=upper,
        deviation=zeros,
        q=q,
        dq=dq,
        ddq=zeros,
        load=zeros,
        noise=np.full(2, 0.1),
        phase=phase,
        off_halts=phase == 0,
        remembering=np.zeros(2, dtype=bool),
        free=np.zeros(2, dtype=bool),
        temperature=np.column_stack([TEMPERATURE, TEMPERATURE + 5.0]) if temperature else None,
    )


@contextmanager
def stored(
    services: Services, folder: Path, *, temperature: bool, change: Callable[[Path], None] = lambda path: None
) -> Iterator[str]:
    path = write_comparison(comparison(temperature=temperature), folder / "signals.parquet")
    change(path)
    kept = services.objects.put_bytes(path.read_bytes())
    signals = OwnedObject("signals", kept.key, kept.size, "application/vnd.apache.parquet")
    made = services.resources.create(NewResource("comparison", {}, objects=(signals,)))
    yield f"/v1/comparisons/{made.id}"
    services.resources.delete("comparison", made.id)


@pytest.fixture
def warm(services: Services, tmp_path: Path) -> Iterator[str]:
    with stored(services, tmp_path, temperature=True) as path:
        yield path


def test_the_residual_is_mapped_over_temperature_and_time(client: TestClient, warm: str) -> None:
    asked = {"joint": "shoulder", "x": "t", "y": "temperature_elbow", "bins": 6}
    found = client.get(f"{warm}/residual_map", params=asked)
    assert found.status_code == 200, found.text
    seen = found.json()
    assert seen["y_edges"][0] == pytest.approx(35.0)
    assert sum(map(sum, seen["count"])) == M
    # Temperature rises with time: only the diagonal is filled.
    assert all(seen["count"][k][k] == M / 6 for k in range(6))


def test_a_temperature_that_was_not_measured_is_no_signal(
    client: TestClient, services: Services, tmp_path: Path
) -> None:
    with stored(services, tmp_path, temperature=False) as cold:
        answer = client.get(f"{cold}/residual_map", params={"joint": "shoulder", "x": "temperature_elbow"})
    assert answer.status_code == 422
    assert "temperature" not in answer.json()["detail"].partition("there are")[2]


def test_a_ripple_and_a_vibration_are_lines_in_the_two_spectra(client: TestClient, warm: str) -> None:
    angle = client.get(f"{warm}/spectrum", params={"joint": "shoulder", "over": "angle"}).json()
    assert angle["frequency_unit"] == "cycles/rad"
    assert angle["peaks"][0]["per_turn"] == pytest.approx(20.0, abs=2 * np.pi * angle["resolution"])
    assert angle["peaks"][0]["amplitude"] == pytest.approx(0.7, rel=0.15)
    time = client.get(f"{warm}/spectrum", params={"joint": "shoulder"}).json()
    assert (time["over"], time["frequency_unit"]) == ("time", "Hz")
    line = min(time["peaks"], key=lambda peak: abs(peak["frequency"] - 6.0))
    assert line["frequency"] == pytest.approx(6.0, abs=time["resolution"])
    assert line["amplitude"] == pytest.approx(0.4, rel=0.2)
    assert len(time["frequency"]) == len(time["amplitude"])


def test_the_autocorrelation_says_what_the_samples_are_worth(client: TestClient, warm: str) -> None:
    found = client.get(f"{warm}/autocorrelation", params={"joint": "elbow", "longest": 2.0}).json()
    assert found["value"][0] == 1.0
    assert found["lag"][-1] == pytest.approx(2.0)
    assert found["n_samples"] == M
    assert found["effective_samples"] > 0.7 * M
    remembering = client.get(f"{warm}/autocorrelation", params={"joint": "shoulder"}).json()
    assert remembering["effective_samples"] < 0.5 * M


def test_at_rest_the_prediction_is_a_band_and_the_residual_the_distance_to_it(client: TestClient, warm: str) -> None:
    found = client.get(f"{warm}/series", params={"joint": "elbow", "points": 5000}).json()
    signals = ("standing", "lower", "upper", "predicted", "measured", "residual")
    standing, lower, upper, predicted, measured, residual = (np.array(found[one]) for one in signals)
    assert np.flatnonzero(standing).tolist() == list(range(M))[REST]
    np.testing.assert_array_equal(lower[~standing], predicted[~standing])
    np.testing.assert_array_equal(upper[~standing], predicted[~standing])
    np.testing.assert_array_equal((lower[standing], upper[standing]), np.repeat([[4.0], [6.0]], 1000, axis=1))
    np.testing.assert_allclose(residual[~standing], (measured - predicted)[~standing])
    above = np.maximum(measured - upper, 0.0) - np.maximum(lower - measured, 0.0)
    np.testing.assert_allclose(residual[standing], above[standing])
    assert np.abs(residual).max() < 0.3 < np.abs(measured - predicted).max()


def test_a_stretch_is_the_same_however_few_of_the_rows_are_read_for_it(
    client: TestClient, services: Services, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dynident.diagnosis.comparison.comparison_files.ROW_GROUP", 400)
    with stored(services, tmp_path, temperature=False) as path:
        whole = client.get(f"{path}/series", params={"joint": "elbow", "points": 5000}).json()
        for start, end in ((7.9, 8.1), (0.0, 60.0), (59.9, 80.0), (70.0, 80.0)):
            query = {"joint": "elbow", "points": 5000, "from": start, "to": end}
            found = client.get(f"{path}/series", params=query).json()
            inside = [k for k, time in enumerate(T) if start <= time <= end]
            assert found["n_samples"] == len(inside)
            for signal in ("t", "measured", "residual", "q", "ddq", "load", "standing"):
                assert found[signal] == [whole[signal][k] for k in inside], signal


def test_where_standing_begins_and_ends_survives_thinning(client: TestClient, warm: str) -> None:
    found = client.get(f"{warm}/series", params={"joint": "elbow", "points": 60}).json()
    assert len(found["t"]) < 120
    rest = [t for t, stands in zip(found["t"], found["standing"], strict=True) if stands]
    assert (rest[0], rest[-1]) == (T[REST][0], T[REST][-1])


def test_the_residual_map_is_of_the_distance_to_what_friction_may_hold(client: TestClient, warm: str) -> None:
    seen = client.get(f"{warm}/residual_map", params={"joint": "elbow", "x": "t", "bins": 3}).json()
    assert sum(map(sum, seen["count"])) == M
    # Against the predicted torque itself it would be 1 N m off at rest.
    assert all(spread < 0.07 for row in seen["spread"] for spread in row)


def test_a_comparison_that_an_older_version_stored_can_still_be_drawn(
    client: TestClient, services: Services, tmp_path: Path
) -> None:
    def without_rest(path: Path) -> None:
        table = pq.read_table(path)
        new = [name for name in table.column_names if name.split("_")[0] in ("lower", "upper", "residual", "phase")]
        assert new
        pq.write_table(table.drop_columns(new), path)

    with stored(services, tmp_path, temperature=False, change=without_rest) as old:
        found = client.get(f"{old}/series", params={"joint": "elbow"}).json()
    assert found["lower"] == found["upper"] == found["predicted"]
    assert not any(found["standing"])
    residual = np.array(found["measured"]) - np.array(found["predicted"])
    np.testing.assert_allclose(found["residual"], residual)


@pytest.mark.parametrize(
    ("below", "asked", "pointer"),
    [
        ("spectrum", {"joint": "nose"}, "joint"),
        ("spectrum", {"joint": "elbow", "over": "angle"}, "joint"),
        ("spectrum", {"joint": "elbow", "over": "sea"}, "over"),
        ("spectrum", {}, "joint"),
        ("autocorrelation", {"joint": "nose"}, "joint"),
        ("autocorrelation", {"joint": "elbow", "longest": "0"}, "longest"),
    ],
)
def test_what_cannot_be_given_is_said_at_the_right_place(
    client: TestClient, warm: str, below: str, asked: dict[str, str], pointer: str
) -> None:
    answer = client.get(f"{warm}/{below}", params=asked)
    assert answer.status_code == 422
    assert answer.headers["content-type"] == "application/problem+json"
    assert pointer in answer.json()["errors"][0]["pointer"]
