"""C code and CasADi functions compute the torque that the model predicts."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import tempfile
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.exported_programs import HYSTERESIS, MODELS, NAMES, check_stated_error, held_out, identify_arm, run_signals
from support.models_with_chosen_parameters import PLAIN, FloatArray, made_up, path, predicted, signals
from support.oracles import Motion, crooked_urdf

from dynident.errors import DynidentError
from dynident.export.c_code import make_c_name, to_c, write_c_statements
from dynident.export.casadi_function import build_torque_formula, to_casadi, to_casadi_bytes
from dynident.export.model_json import model_from_json, to_json
from dynident.export.torque_predictor import PredictingModel
from dynident.identification import Identification
from dynident.regressors.observation_matrix import FurtherSignals
from dynident.robot import robot_from_urdf


@pytest.fixture(scope="module", params=NAMES)
def model(request: pytest.FixtureRequest) -> Identification:
    return MODELS[request.param]()


def arguments_at(identification: Identification, motion: Motion, k: int) -> dict[str, FloatArray]:
    """What the exported programs are given at sample k, hysteresis aside."""
    more = signals(identification.model.robot, len(motion.q))
    given = {"q": motion.q[k], "dq": motion.dq[k], "ddq": motion.ddq[k], "period": np.array([0.01])}
    given |= {name: np.atleast_1d(values[k]) for name, values in more.items()}
    return given | {"runs": run_signals(identification)}


def test_a_casadi_function_gives_the_predicted_torque_sample_by_sample(model: Identification) -> None:
    function = to_casadi(model)
    motion = path(model.model.robot)
    expected = predicted(model, motion, run_signals(model))
    z, before = np.zeros(len(model.model.observation.memory)), motion.q[0]
    for k, torque in enumerate(expected):
        given = arguments_at(model, motion, k) | {"z": z, "q_before": before}
        found = function(**{name: given[name] for name in function.name_in()})
        np.testing.assert_allclose(np.array(found["tau"])[:, 0], torque, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
        z, before = np.array(found.get("z_next", z)).reshape(-1), motion.q[k]


REMEMBERS = "hysteresis on a tree"


@pytest.mark.parametrize("seed", range(4))
def test_a_predictor_gives_the_torque_of_the_whole_motion_in_whatever_pieces_it_comes(seed: int) -> None:
    known = MODELS[REMEMBERS]()
    motion, rng = path(known.model.robot), np.random.default_rng(seed)
    expected = predicted(known, motion)
    for model in (PredictingModel.from_identification(known), model_from_json(to_json(known))):
        predictor = model.predictor()
        for _ in range(2):  # a new motion begins as the first one did
            predictor.reset()
            pieces, first = [], 0
            while first < len(motion.q):
                rows = slice(first, first := first + int(rng.integers(1, 40)))
                if rng.random() < 0.3:
                    moment = rows.start
                    pieces.append(predictor.step(motion.q[moment], motion.dq[moment], motion.ddq[moment])[None])
                    first = moment + 1
                else:
                    pieces.append(predictor.torque(motion.q[rows], motion.dq[rows], motion.ddq[rows]))
            found = np.concatenate(pieces)
            np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_a_single_sample_of_a_model_that_remembers_is_refused_with_the_way_out() -> None:
    model = PredictingModel.from_identification(MODELS[REMEMBERS]())
    sample = np.ones((1, model.robot.n))
    with pytest.raises(DynidentError, match=r"predictor\(\) once and call its step\(\)"):
        model.torque(sample, sample, sample)
    # In steady motion it is what a long way in that direction leaves.
    ways = np.linspace(0.0, 1.0, 2000)[:, None] * np.ones(model.robot.n)
    steady = model.torque(ways, np.ones_like(ways), np.ones_like(ways))[-1]
    np.testing.assert_allclose(model.torque(sample, sample, sample, sliding=True)[0], steady, rtol=1e-9)
    plain = PredictingModel.from_identification(MODELS["plain"]())
    assert plain.torque(*(np.ones((1, plain.robot.n)),) * 3).shape == (1, plain.robot.n)


def test_a_casadi_function_without_its_memory_gives_no_number_rather_than_a_wrong_one(tmp_path: Path) -> None:
    model = MODELS[REMEMBERS]()
    (tmp_path / "model.casadi").write_bytes(to_casadi_bytes(model))
    for function in (to_casadi(model), ca.Function.load(str(tmp_path / "model.casadi"))):
        ones = np.ones(model.model.robot.n)
        assert np.isnan(np.array(function(q=ones, dq=ones, ddq=ones)["tau"])).any()
        states = np.zeros(len(model.model.observation.memory))
        assert np.isfinite(np.array(function(q=ones, dq=ones, ddq=ones, z=states, q_before=ones)["tau"])).all()


def test_a_casadi_file_read_back_is_the_same_function(tmp_path: Path) -> None:
    model = MODELS["hysteresis on a tree"]()
    (tmp_path / "model.casadi").write_bytes(to_casadi_bytes(model))
    read, own = ca.Function.load(str(tmp_path / "model.casadi")), to_casadi(model)
    assert read.name_in() == own.name_in()
    rng = np.random.default_rng(0)
    inputs = [rng.uniform(-1, 1, own.size1_in(k)) for k in range(own.n_in())]
    for one, other in zip(read.call(inputs), own.call(inputs), strict=True):
        np.testing.assert_array_equal(np.array(one), np.array(other))


def test_a_plain_model_asks_for_the_motion_alone() -> None:
    assert build_torque_formula(MODELS["plain"]().estimate).names == ("q", "dq", "ddq")


def compiled(identification: Identification, folder: Path) -> ctypes.CDLL:
    """The exported file, as a library, by the strictest compiler options that people use."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("NO C COMPILER: exported C code is not tested here")
    source, library = folder / "model.c", folder / f"{abs(hash(folder))}.so"
    source.write_text(to_c(identification), encoding="utf-8")
    strict = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-O2"]
    command = [compiler, *strict, "-fPIC", "-shared", str(source), "-o", str(library), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[:2000]
    return ctypes.CDLL(str(library))


def run_c(library: ctypes.CDLL, identification: Identification, motion: Motion) -> FloatArray:
    """Torque along a motion, one call a sample."""
    formula, name = build_torque_formula(identification.estimate), make_c_name(identification)
    call = getattr(library, f"{name}_torque")
    state = ctypes.create_string_buffer(8 * (len(formula.memory) + formula.robot.n + 1))
    if formula.memory:
        getattr(library, f"{name}_start")(state)
    found = np.empty_like(motion.q)
    for k in range(len(motion.q)):
        given = arguments_at(identification, motion, k)
        passed = []
        for one in formula.names:
            if one in ("time", "period"):
                passed.append(ctypes.c_double(given[one][0]))
            elif one not in ("z", "q_before"):
                passed.append((ctypes.c_double * len(given[one]))(*given[one]))
        tau = (ctypes.c_double * formula.robot.n)()
        call(*passed, *([state] if formula.memory else []), tau)
        found[k] = tau
    return found


def test_c_code_compiles_without_a_warning_and_gives_the_predicted_torque(
    model: Identification, tmp_path: Path
) -> None:
    motion = path(model.model.robot)
    expected = predicted(model, motion, run_signals(model))
    found = run_c(compiled(model, tmp_path), model, motion)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_c_code_and_casadi_functions_have_the_error_that_is_stated_on_held_out_motion(tmp_path: Path) -> None:
    model, motion = identify_arm(), held_out()
    text, function = to_c(model), to_casadi(model)
    check_stated_error(text, run_c(compiled(model, tmp_path), model, motion))
    torque = function.map(len(motion.q))(motion.q.T, motion.dq.T, motion.ddq.T)
    check_stated_error(text, np.asarray(torque).T)


def test_the_declarations_of_c_code_can_be_included_by_another_file(tmp_path: Path) -> None:
    model = MODELS["hysteresis on a tree"]()
    compiled(model, tmp_path)
    name = make_c_name(model)
    (tmp_path / "main.c").write_text(
        f'#define {name.upper()}_DECLARATIONS_ONLY\n#include "model.c"\n'
        f"int main(void) {{ double q[{name.upper()}_JOINTS] = {{0}}, tau[{name.upper()}_JOINTS]; {name}_state s; "
        f"{name}_start(&s); {name}_torque(q, q, q, &s, tau); return tau[0] != tau[0]; }}\n"
    )
    command = ["-std=c99", "-Wall", "-Werror", "main.c", "model.c", "-o", "main", "-lm"]
    subprocess.run([shutil.which("gcc") or "cc", *command], cwd=tmp_path, check=True)
    subprocess.run([tmp_path / "main"], check=True)


def test_a_controller_in_cpp_can_call_it(tmp_path: Path) -> None:
    if shutil.which("g++") is None:
        pytest.skip("NO C++ COMPILER: calling exported C code from C++ is not tested here")
    model = MODELS["plain"]()
    compiled(model, tmp_path)
    name = make_c_name(model)
    (tmp_path / "main.cpp").write_text(
        f'#define {name.upper()}_DECLARATIONS_ONLY\n#include "model.c"\n'
        f"int main() {{ double q[7] = {{0}}, tau[7]; {name}_torque(q, q, q, tau); return tau[0] != tau[0]; }}\n"
    )
    subprocess.run(["gcc", "-std=c99", "-c", "model.c", "-o", "model.o"], cwd=tmp_path, check=True)
    subprocess.run(["g++", "-Wall", "-Werror", "main.cpp", "model.o", "-o", "main"], cwd=tmp_path, check=True)
    subprocess.run([tmp_path / "main"], check=True)


@pytest.mark.slow
@settings(max_examples=8, deadline=None)
@given(st.data())
def test_arms_drawn_at_random_are_computed_alike_by_every_program(data: st.DataObject) -> None:
    n = data.draw(st.integers(1, 5))
    parents = tuple(data.draw(st.integers(-1, k - 1)) if k else -1 for k in range(n))
    sliding = tuple(data.draw(st.sets(st.integers(0, n - 1), max_size=2)))
    seed = data.draw(st.integers(0, 1000))
    robot = robot_from_urdf("drawn", crooked_urdf(n, seed, sliding, parents))
    effects = data.draw(
        st.sets(st.sampled_from(["offset", "stribeck", "load_dependent_friction", "viscous_nonlinear"]))
    )
    model = made_up(robot, (*PLAIN, *sorted(effects), *HYSTERESIS[:1]), seed=seed)
    motion = path(robot, 30, seed)
    expected = predicted(model, motion)
    with tempfile.TemporaryDirectory() as folder:
        found = run_c(compiled(model, Path(folder)), model, motion)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    read = model_from_json(to_json(model)).torque(motion.q, motion.dq, motion.ddq, further=FurtherSignals(period=0.01))
    np.testing.assert_allclose(read, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    function, z, before = to_casadi(model), np.zeros(n), motion.q[0]
    for k, torque in enumerate(expected):
        given_at = {"q": motion.q[k], "dq": motion.dq[k], "ddq": motion.ddq[k], "z": z, "q_before": before}
        called = function(**given_at)
        np.testing.assert_allclose(np.array(called["tau"])[:, 0], torque, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
        z, before = np.array(called["z_next"]).reshape(-1), motion.q[k]


def test_names_that_users_give_cannot_break_c_code(tmp_path: Path) -> None:
    text = crooked_urdf(2).replace('"j0"', '"*/ int x; /* ??/ \\ // ‮ end"').replace("crooked", "7th /* arm */")
    model = made_up(robot_from_urdf("7th Arm */ ??/ // \\\n ü", text), PLAIN)
    assert make_c_name(model) == "dynident_7th_arm"
    compiled(model, tmp_path)


def test_an_operation_that_c_code_is_not_written_for_is_named() -> None:
    x = ca.SX.sym("x")
    function = ca.Function("f", [x], [ca.asinh(x)])
    with pytest.raises(DynidentError, match="CasADi function instead"):
        write_c_statements(function, [["x"]], [["y"]])
