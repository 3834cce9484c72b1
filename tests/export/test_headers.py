"""C and C++ headers compute every term of the model, compile strictly, and keep within their memory."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.exported_programs import MODELS, NAMES, TREE, check_stated_error, held_out, identify_arm, run_signals
from support.models_with_chosen_parameters import (
    PLAIN,
    FloatArray,
    drives,
    from_standard,
    made_up,
    path,
    predicted,
    signals,
)
from support.oracles import Motion, arm, pinocchio_torque

from dynident.effects import get_effect
from dynident.effects.hysteresis_states import MemoryStates
from dynident.export import to_c_header, to_cpp_header
from dynident.export.c_header import list_functions
from dynident.identification import Identification
from dynident.identification.identified_models.equation_of_motion import build_equation_of_motion
from dynident.identification.identified_models.torque_prediction import (
    compute_coriolis_matrix,
    compute_gravity,
    compute_mass_matrix,
)
from dynident.regressors.observation_matrix import FurtherSignals

STRICT = ("-O1", "-Wall", "-Wextra", "-Werror", "-pedantic")
# Some warnings need an optimiser; where a test is about what the program computes, that takes most of its time.
PLAINLY = "-O0"
SANITIZERS = (PLAINLY, "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
EIGEN = Path("/usr/include/eigen3")
STATE, SCALARS = "z", {"time": "t", "period": "period"}


def find_compiler(name: str) -> str:
    compiler = shutil.which(name)
    if compiler is None:
        pytest.skip(f"NO {name}: exported headers are not tested with it here")
    return compiler


def write_program(identification: Identification, *, payload: str = "", cpp: bool = False, eigen: bool = False) -> str:
    """A program that reads samples of all arguments and the torque, and writes the results of all functions."""
    equation = build_equation_of_motion(identification.estimate)
    header = to_cpp_header(identification) if cpp else to_c_header(identification)
    name = header.name.rsplit(".", 1)[0]
    n, has_state = equation.robot.n, bool(equation.z_next.numel())
    inputs = {a.name: a.size for a in equation.arguments if a.name != STATE} | {"tau": n}
    reads = " && ".join(f"fread({item}, sizeof(double), {size}, stdin) == {size}" for item, size in inputs.items())
    wrap = {
        item: f"Eigen::Map<{name}::Model::EigenVector>({item})" if eigen else f"to_array({item})" for item in inputs
    }
    if cpp:
        wrap |= {item: f"to_array({item})" for item in inputs if item == "runs"}
    wrap |= {item: f"{item}[0]" for item in inputs if item in SCALARS}
    calls = []
    for function in list_functions(equation):
        passed = [a.name for a in function.inputs if a.name != STATE or not cpp]
        if cpp:
            calls.append(f"const auto {function.name} = model.{function.name}({', '.join(wrap[a] for a in passed)});")
            calls.append(f"fwrite({function.name}.data(), sizeof(double), {function.size}, stdout);")
            continue
        words = ["&state" if a == STATE else f"{a}[0]" if a in SCALARS else a for a in passed]
        calls.append(f"{name}_{function.name}({', '.join(['&p', *words, 'out'])});")
        calls.append(f"fwrite(out, sizeof(double), {function.size}, stdout);")
    declared = "".join(f"    double {item}[{size}];\n" for item, size in inputs.items())
    head = '#include <cstdio>\n#include "model.hpp"\n' if cpp else '#include "model.h"\n#include <stdio.h>\n'
    if cpp:
        to_array = "template <std::size_t N> std::array<double, N> to_array(const double (&values)[N])\n"
        to_array += "{ std::array<double, N> result; for (std::size_t k = 0; k < N; ++k) result[k] = values[k]; "
        head += to_array + "return result; }\n" if not eigen or "runs" in inputs else ""
        begin = f"    {name}::Model model;\n" + (f"    model.set_payload({payload});\n" if payload else "")
        advance = f"model.advance({wrap['q']});" if has_state else ""
    else:
        begin = f"    {name}_parameters p = {name}_identified();\n    double out[{n * n}];\n"
        begin += f"    {name}_state state;\n    {name}_start(&state);\n" if has_state else ""
        begin += f"    {name}_set_payload(&p, {payload});\n" if payload else ""
        advance = f"{name}_advance(&state, q);" if has_state else ""
    body = "\n        ".join([advance, *calls])
    loop = f"    while ({reads}) {{\n        {body}\n    }}\n    return 0;\n"
    return f"{head}int main(void)\n{{\n{declared}{begin}{loop}}}\n"


def run_program(
    identification: Identification,
    folder: Path,
    motion: Motion,
    compiler: tuple[str, ...],
    *,
    payload: str = "",
    cpp: bool = False,
    eigen: bool = False,
) -> dict[str, FloatArray]:
    """Results of all functions along a motion: (m, size) each."""
    equation = build_equation_of_motion(identification.estimate)
    runs = run_signals(identification)
    torque = predicted(identification, motion, runs)
    more = signals(equation.robot, len(motion.q)) | {"runs": np.tile(runs, (len(motion.q), 1))}
    given = {"q": motion.q, "dq": motion.dq, "ddq": motion.ddq, "period": np.full(len(motion.q), 0.01)} | more
    rows = [given[a.name] for a in equation.arguments if a.name != STATE] + [torque]
    content = np.column_stack(rows).astype(np.float64).tobytes()
    (folder / "model.h").write_bytes(to_c_header(identification).content)
    (folder / "model.hpp").write_bytes(to_cpp_header(identification).content)
    source = folder / ("main.cpp" if cpp else "main.c")
    source.write_text(write_program(identification, payload=payload, cpp=cpp, eigen=eigen), encoding="utf-8")
    command = [find_compiler(compiler[0]), *STRICT, *compiler[1:], str(source), "-o", str(folder / "main"), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[:2000]
    answer = subprocess.run([folder / "main"], input=content, capture_output=True, check=False)
    assert answer.returncode == 0, answer.stderr[:2000]
    functions = list_functions(equation)
    table = np.frombuffer(answer.stdout).reshape(len(motion.q), sum(function.size for function in functions))
    ends = np.cumsum([function.size for function in functions])
    return {f.name: table[:, end - f.size : end] for f, end in zip(functions, ends, strict=True)}


def compute_friction_along(identification: Identification, motion: Motion) -> FloatArray:
    """W χ of the effects that are friction, with hysteresis carried along."""
    observation = identification.model.observation
    entries = observation.evaluate(
        motion.q,
        motion.dq,
        motion.ddq,
        reference=identification.estimate.reference,
        memory=MemoryStates(observation.memory).push(motion.q),
        further=FurtherSignals(
            runs=run_signals(identification), period=0.01, **signals(identification.model.robot, len(motion.q))
        ),
    )
    is_friction = [get_effect(column.effect).is_friction for column in observation.columns]
    return observation.compute_torque(entries, np.where(is_friction, identification.values, 0.0))


def check_terms(identification: Identification, motion: Motion, computed: dict[str, FloatArray]) -> None:
    estimate = identification.estimate
    expected = {
        "inverse_dynamics": predicted(identification, motion, run_signals(identification)),
        "gravity": compute_gravity(estimate, motion.q),
        "coriolis": np.einsum("mij,mj->mi", compute_coriolis_matrix(estimate, motion.q, motion.dq), motion.dq),
        "friction": compute_friction_along(identification, motion),
        "mass_matrix": compute_mass_matrix(estimate, motion.q).reshape(len(motion.q), -1),
        "forward_dynamics": motion.ddq,
    }
    assert {"inverse_dynamics", "gravity", "coriolis", "friction", "mass_matrix"} <= set(computed)
    for name, values in computed.items():
        size = max(float(np.abs(expected[name]).max()), 1e-3)
        # Parameters that no body has can make a mass matrix nearly singular: accelerations are solved less exactly.
        exact = 1e-9 if name != "forward_dynamics" else 1e-7
        np.testing.assert_allclose(values, expected[name], rtol=0, atol=exact * size, err_msg=name)


@pytest.mark.sweep
@pytest.mark.parametrize("name", NAMES)
def test_a_c_header_compiles_strictly_and_computes_every_term(name: str, tmp_path: Path) -> None:
    identification = MODELS[name]()
    motion = path(identification.model.robot)
    check_terms(identification, motion, run_program(identification, tmp_path, motion, ("gcc", "-std=c99")))


@pytest.mark.parametrize("cpp", [False, True], ids=["C", "C++"])
def test_a_header_states_the_error_that_it_has_on_held_out_motion(cpp: bool, tmp_path: Path) -> None:
    compiler = ("g++", "-std=c++17", PLAINLY) if cpp else ("gcc", "-std=c99", PLAINLY)
    torque = run_program(identify_arm(), tmp_path, held_out(), compiler, cpp=cpp)["inverse_dynamics"]
    check_stated_error((tmp_path / ("model.hpp" if cpp else "model.h")).read_text(encoding="utf-8"), torque)


@pytest.mark.sweep
@pytest.mark.parametrize(
    "compiler", [("gcc", "-std=c11"), ("clang", "-std=c99", PLAINLY), ("gcc", "-std=c99", *SANITIZERS)], ids=" ".join
)
@pytest.mark.parametrize("name", ["plain", "everything with a sliding joint"])
def test_compilers_and_their_sanitizers_agree(name: str, compiler: tuple[str, ...], tmp_path: Path) -> None:
    identification = MODELS[name]()
    motion = path(identification.model.robot, 30)
    check_terms(identification, motion, run_program(identification, tmp_path, motion, compiler))


CPP = {
    "g++": (("g++", "-std=c++17", "-fno-exceptions", "-fno-rtti"), False),
    "g++ with Eigen": (("g++", "-std=c++17", "-fno-exceptions", PLAINLY), True),
    "clang++ with sanitizers": (("clang++", "-std=c++17", *SANITIZERS), False),
}
"""Compilers of C++ with their options, and whether Eigen's types are used."""


# Compiling takes seconds: every model by one compiler, and one model by every compiler.
@pytest.mark.parametrize(
    ("compiler", "name"),
    [
        pytest.param(
            compiler, name, marks=[] if compiler == "g++" or name == "hysteresis on a tree" else pytest.mark.thorough
        )
        for compiler in CPP
        for name in ("plain", "hysteresis on a tree", "everything with a sliding joint")
    ],
)
def test_a_cpp_header_computes_the_same(name: str, compiler: str, tmp_path: Path) -> None:
    command, eigen = CPP[compiler]
    if eigen and not EIGEN.exists():
        pytest.skip(f"NO EIGEN in {EIGEN}: the header's functions for it are not tested here")
    identification = MODELS[name]()
    motion = path(identification.model.robot, 30)
    options = (*command, "-DDYNIDENT_USE_EIGEN", "-isystem", str(EIGEN)) if eigen else command
    check_terms(identification, motion, run_program(identification, tmp_path, motion, options, cpp=True, eigen=eigen))


@pytest.mark.sweep
@pytest.mark.parametrize("name", ["ur10", "franka_panda", "scara"])
def test_links_are_those_of_pinocchio_and_a_load_adds_its_own(name: str, tmp_path: Path) -> None:
    robot = arm(name)
    identification = from_standard(robot, drives(robot))
    motion = path(robot, 30)
    mass, centre, inertia = 2.5, np.array([0.03, -0.05, 0.11]), np.array([0.02, 0.001, -0.002, 0.03, 0.003, 0.015])
    inertias = robot.inertias.copy()
    full = np.array([[inertia[0], inertia[1], inertia[2]], [inertia[1], inertia[3], inertia[4]],
                     [inertia[2], inertia[4], inertia[5]]])  # fmt: skip
    full = full + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    inertias[-1] += np.concatenate([full[np.triu_indices(3)], mass * centre, [mass]])
    rotors = [value for key, value in drives(robot).items() if key.startswith("Ia")]
    words = [f"(const double[]){{{', '.join(repr(float(x)) for x in values)}}}" for values in (centre, inertia)]
    for loaded, payload in ((robot, ""), (replace(robot, inertias=inertias), f"{mass}, {', '.join(words)}")):
        computed = run_program(identification, tmp_path, motion, ("gcc", "-std=c99", PLAINLY), payload=payload)
        links = pinocchio_torque(loaded, motion.q, motion.dq, motion.ddq) + rotors * motion.ddq
        torque = computed["inverse_dynamics"] - computed["friction"]
        np.testing.assert_allclose(torque, links, rtol=0, atol=1e-9 * np.abs(links).max())


def test_two_models_stand_in_one_program(tmp_path: Path) -> None:
    for k, model in enumerate((made_up(TREE, PLAIN), made_up(arm("scara"), PLAIN))):
        (tmp_path / f"model{k}.hpp").write_bytes(to_cpp_header(model).content)
        (tmp_path / f"model{k}.h").write_bytes(to_c_header(model).content)
    includes = "".join(f'#include "model{k}.{ending}"\n' for k in (0, 1) for ending in ("h", "hpp"))
    (tmp_path / "main.cpp").write_text(
        f"{includes}int main() {{ dynident_tree::Model a; dynident_scara::Model b; "
        "return a.joints == b.joints || a.gravity({}) == a.gravity({}) ? 0 : 1; }\n"
    )
    command = [find_compiler("g++"), "-std=c++17", *STRICT, PLAINLY, "main.cpp", "-o", "main"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[:2000]
    subprocess.run([tmp_path / "main"], check=True)


def test_a_model_without_links_has_no_forward_dynamics() -> None:
    file = to_c_header(MODELS["friction alone"]())
    assert any("no inertia at" in note for note in file.notes)
    assert b"_forward_dynamics(" not in file.content


def test_a_model_whose_effects_need_the_acceleration_says_that_it_has_no_forward_dynamics() -> None:
    file = to_c_header(MODELS["hysteresis on a tree"]())
    assert any("no forward_dynamics" in note for note in file.notes)
    assert b"_forward_dynamics(" not in file.content
    assert b"no forward_dynamics" in file.content
