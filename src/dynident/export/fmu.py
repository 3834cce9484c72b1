"""Write the whole model as an FMU for co-simulation by FMI 3.0: C sources, and a binary if there is a compiler.

The FMU needs no Python. Its C code is `fmu_interface.c` and the header that is generated here.
"""

from __future__ import annotations

import hashlib
import html
import io
import platform
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from xml.sax.saxutils import quoteattr

import casadi as ca
import numpy as np

from dynident.effects import get_effect
from dynident.effects.friction import REFERENCE_TEMPERATURE
from dynident.errors import DynidentError
from dynident.export.c_code import make_c_name
from dynident.export.c_header import Header, HeaderFunction
from dynident.export.comments_and_names import (
    SIGNS,
    describe_identification,
    describe_origin,
    make_slug,
    replace_unprintable,
)
from dynident.export.feasible_links_and_joints import ExportedFile
from dynident.identification import Identification
from dynident.identification.identified_models.equation_of_motion import (
    Argument,
    EquationOfMotion,
    build_equation_of_motion,
)
from dynident.version import __version__

_STEP = 2e-4
"""Internal step of the simulation by default, in s: the stiffest presliding of usual arms swings with some 200 Hz."""
_COMPILER_SECONDS = 300
_ARGUMENTS = {
    "q": "q", "dq": "dq", "ddq": "ddq", "time": "time", "period": "period", "temperature": "temperature",
    "z": "state", "runs": "runs",
}  # fmt: skip
# References of the variables, as in fmu_interface.c
_TAU, _Q, _DQ, _DDQ, _PAYLOAD, _TEMPERATURE, _RUNS, _STEP_REFERENCE = 1000, 2000, 3000, 4000, 5000, 6000, 7000, 8000
# A fixed time of all files makes equal models equal files.
_DATE = (2000, 1, 1, 0, 0, 0)


def to_fmu(identification: Identification, notes: Sequence[str] = ()) -> ExportedFile:
    """Return the identified model as an FMU for co-simulation: torques in, motion out.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.
    notes : sequence of str
        Further sentences that users must know, for its documentation and the file's notes.

    Returns
    -------
    ExportedFile
        The FMU, with sources, and with a binary for this machine's platform if it has a C compiler.

    Raises
    ------
    DynidentError
        If a joint has no inertia in the model, or an effect needs derivatives of the acceleration.
    """
    equation = build_equation_of_motion(identification.estimate)
    foreign = [argument.name for argument in equation.arguments if argument.name not in _ARGUMENTS]
    if foreign or equation.weightless_joints:
        reason = (
            f"an effect of the model depends on {', '.join(foreign)}"
            if foreign
            else f"the model has no inertia at {', '.join(equation.weightless_joints)}"
        )
        raise DynidentError(
            f"{reason}, so that its motion cannot be simulated; export C code, a CasADi function or JSON",
            pointer="/format",
            title="Not expressible as an FMU",
        )
    name = make_c_name(identification)
    notes = (*notes, *_write_notes(identification, equation))
    header = Header(identification, equation, name, (_build_terms(identification, equation),), notes)
    model = header.write_c() + _write_configuration(identification, equation, header)
    interface = files("dynident.export").joinpath("fmu_interface.c").read_text(encoding="utf-8")
    token = hashlib.sha256((model + interface).encode()).hexdigest()
    model += f'#define FMU_TOKEN "{{{token}}}"\n'
    binary, missing = _compile(interface, model)
    notes = (*notes, *([missing] if missing else []))
    entries = {
        "modelDescription.xml": _describe_model(identification, equation, name, token, notes).encode(),
        "sources/buildDescription.xml": _BUILD.format(name=name).encode(),
        "sources/fmu.c": interface.encode(),
        "sources/model.h": model.encode(),
        "documentation/index.html": _write_documentation(identification, notes).encode(),
    }
    if binary is not None:
        folder, ending = _find_platform()
        entries[f"binaries/{folder}/{name}{ending}"] = binary
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        for path, data in entries.items():
            information = zipfile.ZipInfo(path, _DATE)
            information.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(information, data)
    slug = make_slug(identification.model.robot.name)
    return ExportedFile(f"{slug}.fmu", "application/zip", content.getvalue(), notes)


def _write_notes(identification: Identification, equation: EquationOfMotion) -> tuple[str, ...]:
    notes = [
        "The FMU has every effect of the model. Its error is that of the model; its step, a parameter, is "
        f"{_STEP:g} s by default."
    ]
    if any(argument.name == "ddq" and ca.depends_on(equation.effects, argument.symbol)
           for argument in equation.arguments):  # fmt: skip
        notes.append("Effects that depend on the acceleration use that of the internal step before.")
    if identification.model.observation.runs:
        notes.append("The parameters runs say in which kind of run the robot is; by default in none.")
    return tuple(notes)


def _build_terms(identification: Identification, equation: EquationOfMotion) -> HeaderFunction:
    """Return the mass matrix, the torques without friction, and the friction without hysteresis, as one array."""
    n, columns = equation.robot.n, identification.model.observation.columns
    states = next((a.symbol for a in equation.arguments if a.name == "z"), ca.SX(0, 1))
    friction = np.array(
        [
            get_effect(column.effect).is_friction
            and not ca.depends_on(ca.jacobian(equation.effects, equation.base[k]), states)
            for k, column in enumerate(columns)
        ],
        dtype=float,
    )
    dry, other = (
        ca.substitute(equation.effects, equation.base, equation.base * ca.DM(chosen))
        for chosen in (friction, 1.0 - friction)
    )
    terms = ca.vertcat(ca.vec(equation.mass), equation.coriolis + equation.gravity + other, dry)
    inputs: tuple[Argument, ...] = tuple(
        a for a in equation.arguments if a.name in ("q", "dq") or ca.depends_on(terms, a.symbol)
    )
    return HeaderFunction(
        "step_terms",
        f"mass matrix ({n * n}), torques without friction ({n}), friction without hysteresis ({n})",
        inputs,
        "terms",
        ca.densify(terms),
    )


def _write_configuration(identification: Identification, equation: EquationOfMotion, header: Header) -> str:
    """Return what `fmu_interface.c` needs to know of the model, behind the header."""
    name, has_state = header.name, header.n_states > 0
    [function] = header.functions
    passed = ["parameters", *(_ARGUMENTS[argument.name] for argument in function.inputs), "terms"]
    unused = [word for word in _ARGUMENTS.values() if word not in passed]
    state = f"typedef {name}_state fmu_state;" if has_state else "typedef struct { int unused; } fmu_state;"
    start = f"{name}_start(state);" if has_state else "state->unused = 0;"
    advance = f"{name}_advance(state, q);" if has_state else "(void)state, (void)q;"
    return f"""
#define FMU_JOINTS {equation.robot.n}
#define FMU_RUNS {len(identification.model.observation.runs)}
#define FMU_STEP {_STEP!r}
#define FMU_TEMPERATURE {float(REFERENCE_TEMPERATURE)!r}
typedef {name}_parameters fmu_parameters;
{state}
#define fmu_identified {name}_identified
#define fmu_set_payload {name}_set_payload
static inline void fmu_start(fmu_state *state) {{ {start} }}
static inline void fmu_advance(fmu_state *state, const double *q) {{ {advance} }}
static inline void fmu_terms(
    const fmu_parameters *parameters, const double *q, const double *dq, const double *ddq, double time, double period,
    const double *temperature, const double *runs, const fmu_state *state, double *terms)
{{
    {"".join(f"(void){word}; " for word in unused)}
    {name}_step_terms({", ".join(passed)});
}}
"""


def _find_platform() -> tuple[str, str]:
    """Return the folder of FMI for this platform, and the ending of its libraries."""
    machine = {"amd64": "x86_64", "arm64": "aarch64"}.get(platform.machine().lower(), platform.machine().lower())
    system, ending = {"Darwin": ("darwin", ".dylib"), "Windows": ("windows", ".dll")}.get(
        platform.system(), (platform.system().lower(), ".so")
    )
    return f"{machine}-{system}", ending


def _compile(interface: str, model: str) -> tuple[bytes | None, str]:
    """Return the library, or None and the reason why there is none."""
    folder, _ = _find_platform()
    compiler = next((path for path in map(shutil.which, ("cc", "gcc", "clang")) if path), None)
    if compiler is None:
        return None, "The FMU has C sources but no binary, because this machine has no C compiler."
    with tempfile.TemporaryDirectory() as place:
        source, library = Path(place) / "fmu.c", Path(place) / "fmu.library"
        source.write_text(interface, encoding="utf-8")
        source.with_name("model.h").write_text(model, encoding="utf-8")
        options = ("-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden")
        command = [compiler, *options, str(source), "-o", str(library), "-lm"]
        try:
            subprocess.run(command, check=True, capture_output=True, timeout=_COMPILER_SECONDS)
        except (subprocess.SubprocessError, OSError):
            return None, f"The FMU has C sources but no binary: {Path(compiler).name} did not compile them."
        return library.read_bytes(), f"The binary in the FMU is for {folder}; other platforms compile its sources."


def _describe_model(
    identification: Identification, equation: EquationOfMotion, name: str, token: str, notes: tuple[str, ...]
) -> str:
    joints = equation.robot.joints
    variables = ['<Float64 name="time" valueReference="0" causality="independent" variability="continuous"/>']

    def add(text: str, reference: int, kind: str, unit: str, description: str, start: float | None = 0.0) -> None:
        begin = "" if start is None else f' start="{start!r}"'
        variables.append(
            f'<Float64 name="{text}" valueReference="{reference}" {kind} unit="{unit}"{begin} '
            f"description={quoteattr(replace_unprintable(description))}/>"
        )

    for j, joint in enumerate(joints):
        length, turns = ("rad", True) if joint.kind == "revolute" else ("m", False)
        place = f"[{j + 1}]"
        driven = 'causality="input" variability="continuous"'
        add(f"tau{place}", _TAU + j, driven, "N.m" if turns else "N", f"Torque of the motor at {joint.name}")
        exact = 'causality="output" variability="continuous" initial="exact"'
        add(f"q{place}", _Q + j, exact, length, f"Position of {joint.name}")
        add(f"dq{place}", _DQ + j, exact, f"{length}/s", f"Velocity of {joint.name}")
        add(f"ddq{place}", _DDQ + j, 'causality="output" variability="continuous" initial="calculated"',
            f"{length}/s2", f"Acceleration of {joint.name}", None)  # fmt: skip
    tunable = 'causality="parameter" variability="tunable"'
    payload = [("mass", "kg", "Mass of a load on the last link, added to its own")]
    payload += [(f"centre_{x}", "m", "Centre of mass of the load in the last link's frame") for x in "xyz"]
    payload += [
        (f"inertia_{pair}", "kg.m2", "Inertia of the load about its centre of mass")
        for pair in ("xx", "xy", "xz", "yy", "yz", "zz")
    ]
    for k, (word, unit, meaning) in enumerate(payload):
        add(f"payload.{word}", _PAYLOAD + k, tunable, unit, meaning)
    used = {argument.name for argument in equation.arguments}
    if "temperature" in used:
        for j, joint in enumerate(joints):
            add(f"temperature[{j + 1}]", _TEMPERATURE + j, tunable, "degC", f"Temperature of {joint.name}",
                float(REFERENCE_TEMPERATURE))  # fmt: skip
    for k in range(len(identification.model.observation.runs)):
        add(f"runs[{k + 1}]", _RUNS + k, tunable, "1", "1 in runs of this kind")
    add("step", _STEP_REFERENCE, tunable, "s", "Longest internal step", _STEP)
    outputs = [reference + j for j in range(len(joints)) for reference in (_Q, _DQ, _DDQ)]
    unknowns = [_DDQ + j for j in range(len(joints))]
    structure = [f'<Output valueReference="{reference}"/>' for reference in outputs]
    structure += [f'<InitialUnknown valueReference="{reference}"/>' for reference in unknowns]
    description = " ".join([*describe_identification(identification)[:4], SIGNS, *notes])
    return _DESCRIPTION.format(
        name=name,
        token=f"{{{token}}}",
        tool=f"dynident {__version__}",
        description=quoteattr(replace_unprintable(description)),
        variables="\n    ".join(variables),
        structure="\n    ".join(structure),
    )


def _write_documentation(identification: Identification, notes: tuple[str, ...]) -> str:
    lines = [f"Identified model, {describe_origin()}.", *describe_identification(identification), SIGNS, *notes]
    text = "\n".join(f"<p>{html.escape(line)}</p>" for line in lines)
    title = html.escape(identification.model.robot.name)
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title></head>\n{text}</html>\n'
    )


_BUILD = """\
<?xml version="1.0" encoding="UTF-8"?>
<fmiBuildDescription fmiVersion="3.0">
  <BuildConfiguration modelIdentifier="{name}">
    <SourceFileSet language="C99">
      <SourceFile name="fmu.c"/>
    </SourceFileSet>
  </BuildConfiguration>
</fmiBuildDescription>
"""

_DESCRIPTION = """\
<?xml version="1.0" encoding="UTF-8"?>
<fmiModelDescription fmiVersion="3.0" modelName="{name}" instantiationToken="{token}"
  variableNamingConvention="structured" generationTool="{tool}" description={description}>
  <CoSimulation modelIdentifier="{name}" canHandleVariableCommunicationStepSize="true" canGetAndSetFMUState="true"/>
  <UnitDefinitions>
    <Unit name="rad"><BaseUnit rad="1"/></Unit>
    <Unit name="rad/s"><BaseUnit rad="1" s="-1"/></Unit>
    <Unit name="rad/s2"><BaseUnit rad="1" s="-2"/></Unit>
    <Unit name="m"><BaseUnit m="1"/></Unit>
    <Unit name="m/s"><BaseUnit m="1" s="-1"/></Unit>
    <Unit name="m/s2"><BaseUnit m="1" s="-2"/></Unit>
    <Unit name="N"><BaseUnit kg="1" m="1" s="-2"/></Unit>
    <Unit name="N.m"><BaseUnit kg="1" m="2" s="-2"/></Unit>
    <Unit name="kg"><BaseUnit kg="1"/></Unit>
    <Unit name="kg.m2"><BaseUnit kg="1" m="2"/></Unit>
    <Unit name="s"><BaseUnit s="1"/></Unit>
    <Unit name="degC"><BaseUnit K="1" offset="273.15"/></Unit>
    <Unit name="1"/>
  </UnitDefinitions>
  <DefaultExperiment startTime="0" stepSize="0.001"/>
  <ModelVariables>
    {variables}
  </ModelVariables>
  <ModelStructure>
    {structure}
  </ModelStructure>
</fmiModelDescription>
"""
