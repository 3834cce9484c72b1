# ruff: noqa: E501 - the C++ program has lines of its own
"""Time of the exported C++ header's functions, with friction, beside Pinocchio's `rnea`, `crba` and `aba` in C++.

    python benchmarks/controller_code.py

Both are called in one program at the same random states of a 6-joint and a 7-joint arm, and both are optimised for any
processor of the architecture, ours with -O3; Pinocchio's algorithms are those of the library in its wheel. Pinocchio
has no friction; ours includes Coulomb and viscous friction. Needs a C++ compiler, the Pinocchio wheel, and Eigen's
headers: `EIGEN3_INCLUDE_DIR`, /usr/include/eigen3, or those in CasADi's wheel.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

import pinocchio
from common import show, simulated_samples
from compared import compared

from dynident.effects import EffectChoice
from dynident.export import complete_parameters, to_cpp_header, to_urdf
from dynident.identification import Identification, IdentificationChoices, identify
from dynident.recordings import Preprocessing, recording_from_arrays
from dynident.robot import robot_from_library, to_pinocchio

ARMS = ("ur10", "franka_panda")
EFFECTS = tuple(EffectChoice(name) for name in ("rigid_body", "rotor_inertia", "coulomb", "viscous"))
N_SAMPLES, RATE = 5_000, 250.0
OPTIONS = ("-std=c++17", "-O3", "-DNDEBUG")
# As Pinocchio's own build sets them; with template instantiation its algorithms come from the wheel's library.
OPTIONS += ("-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS", "-DBOOST_MPL_LIMIT_LIST_SIZE=30")
OPTIONS += ("-DBOOST_MPL_LIMIT_VECTOR_SIZE=30", "-DBOOST_FUSION_INVOKE_MAX_ARITY=12")
OPTIONS += ("-DPINOCCHIO_ENABLE_TEMPLATE_INSTANTIATION",)
RIVALS = {"inverse_dynamics": "rnea", "mass_matrix": "crba", "forward_dynamics": "aba"}
# What the program compares, over the largest of all states; accelerations by the torque that they need.
DIFFERENCES = {"torque": "torque", "mass": "mass matrix", "motion": "accelerations"}
PROGRAM = """
#include <ctime>
#include <cstdio>
#include <random>
#include <vector>
#include <algorithm>
#include <pinocchio/fwd.hpp>
#include <pinocchio/multibody.hpp>
#include <pinocchio/algorithm/rnea.hpp>
#include <pinocchio/algorithm/crba.hpp>
#include <pinocchio/algorithm/aba.hpp>
#define DYNIDENT_USE_EIGEN
INCLUDES

namespace pin = pinocchio;
constexpr int count = 4096, rounds = 40;

/* Processor time in ns: what others do on the machine counts less. */
inline double now() { timespec t; clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t); return 1e9 * t.tv_sec + t.tv_nsec; }

/* Median over rounds of the nanoseconds of a call. */
template <class Function> double time_of(Function function)
{
    std::vector<double> times;
    for (int round = 0; round < rounds; ++round) {
        const double start = now();
        for (int k = 0; k < count; ++k) function(k);
        times.push_back((now() - start) / count);
    }
    std::nth_element(times.begin(), times.begin() + rounds / 2, times.end());
    return times[rounds / 2];
}

template <class Ours> void measure(const pin::Model &model)
{
    using Vector = typename Ours::EigenVector;
    pin::Data data(model);
    const Ours ours;
    std::mt19937 generator(0);
    std::uniform_real_distribution<double> draw(-2.0, 2.0);
    std::vector<Eigen::VectorXd> q(count), dq(count), ddq(count), tau(count);
    std::vector<Vector> fixed_q(count), fixed_dq(count), fixed_ddq(count), fixed_tau(count);
    double torque_off = 0.0, mass_off = 0.0, motion_off = 0.0, torque_size = 0.0, mass_size = 0.0, sum = 0.0;
    for (int k = 0; k < count; ++k) {
        q[k] = dq[k] = ddq[k] = Eigen::VectorXd(model.nv);
        for (int j = 0; j < model.nv; ++j) { q[k][j] = draw(generator); dq[k][j] = draw(generator); ddq[k][j] = draw(generator); }
        fixed_q[k] = q[k]; fixed_dq[k] = dq[k]; fixed_ddq[k] = ddq[k];
        tau[k] = pin::rnea(model, data, q[k], dq[k], ddq[k]);
        fixed_tau[k] = tau[k];
        const Vector friction = ours.friction(fixed_q[k], fixed_dq[k]);
        torque_size = std::max(torque_size, tau[k].cwiseAbs().maxCoeff());
        const Vector torque = ours.inverse_dynamics(fixed_q[k], fixed_dq[k], fixed_ddq[k]) - friction;
        torque_off = std::max(torque_off, (torque - fixed_tau[k]).cwiseAbs().maxCoeff());
        pin::crba(model, data, q[k], pin::Convention::WORLD);
        Eigen::MatrixXd mass = data.M.selfadjointView<Eigen::Upper>();
        mass_size = std::max(mass_size, mass.maxCoeff());
        mass_off = std::max(mass_off, (ours.mass_matrix(fixed_q[k]) - mass).cwiseAbs().maxCoeff());
        /* As a torque: a light wrist turns rounding of the torque into any acceleration. */
        const Eigen::VectorXd motors = fixed_tau[k] + friction;
        const Vector moved = ours.forward_dynamics(fixed_q[k], fixed_dq[k], motors) - fixed_ddq[k];
        motion_off = std::max(motion_off, (mass * moved).cwiseAbs().maxCoeff());
    }
    std::printf("{\\"joints\\": %d, \\"torque\\": %.3g, \\"mass\\": %.3g, \\"motion\\": %.3g", model.nv,
                torque_off / torque_size, mass_off / mass_size, motion_off / torque_size);
    const auto print = [](const char *name, double value) { std::printf(", \\"%s\\": %.6g", name, value); };
    print("inverse_dynamics", time_of([&](int k) { sum += ours.inverse_dynamics(fixed_q[k], fixed_dq[k], fixed_ddq[k])[0]; }));
    print("rnea", time_of([&](int k) { sum += pin::rnea(model, data, q[k], dq[k], ddq[k])[0]; }));
    print("mass_matrix", time_of([&](int k) { sum += ours.mass_matrix(fixed_q[k])(0, 0); }));
    const double local = time_of([&](int k) { sum += pin::crba(model, data, q[k], pin::Convention::LOCAL)(0, 0); });
    const double world = time_of([&](int k) { sum += pin::crba(model, data, q[k], pin::Convention::WORLD)(0, 0); });
    print("crba", std::min(local, world));
    print("forward_dynamics", time_of([&](int k) { sum += ours.forward_dynamics(fixed_q[k], fixed_dq[k], fixed_tau[k])[0]; }));
    const double aba_local = time_of([&](int k) { sum += pin::aba(model, data, q[k], dq[k], tau[k], pin::Convention::LOCAL)[0]; });
    const double aba_world = time_of([&](int k) { sum += pin::aba(model, data, q[k], dq[k], tau[k], pin::Convention::WORLD)[0]; });
    print("aba", std::min(aba_local, aba_world));
    std::printf(", \\"sum\\": %g}\\n", sum);
}

int main()
{
MAIN    return 0;
}
"""


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        place, includes, statements = Path(folder), "", ""
        # One program for both arms: most of the time of a compiler goes into Pinocchio's templates.
        for name in ARMS:
            model = identify_arm(name)
            header = to_cpp_header(model)
            (place / header.name).write_bytes(header.content)
            includes += f'#include "{header.name}"\n'
            statements += write_pinocchio_model(model) + f"    measure<{Path(header.name).stem}::Model>(model); }}\n"
        program = PROGRAM.replace("INCLUDES", includes).replace("MAIN", statements)
        (place / "main.cpp").write_text(program, encoding="utf-8")
        build(place)
        answer = subprocess.run([place / "main"], cwd=place, check=True, capture_output=True, text=True).stdout
    for name, line in zip(ARMS, answer.splitlines(), strict=True):
        report(name, json.loads(line))


def identify_arm(name: str) -> Identification:
    robot = robot_from_library(name)
    samples = simulated_samples(to_pinocchio(robot), N_SAMPLES, RATE)
    recording = recording_from_arrays(samples.t, samples.q, samples.tau, joint_names=robot.joint_names)
    choices = IdentificationChoices(EFFECTS, preprocessing=Preprocessing(10.0, 10.0, 5), estimator="feasible")
    return identify(robot, [recording], [], choices)


def report(name: str, times: dict[str, float]) -> None:
    n = int(times["joints"])
    rows = [("", "ns a call", "Pinocchio", "ns a call", "ratio")]
    for ours, rival in RIVALS.items():
        compared(f"{ours} in C++, {n} joints", 1e-9 * times[ours], f"Pinocchio's {rival}", 1e-9 * times[rival])
        rows.append((ours, f"{times[ours]:.0f}", rival, f"{times[rival]:.0f}", f"{times[ours] / times[rival]:.2f}"))
    off = ", ".join(f"{word} {times[key]:.1e}" for key, word in DIFFERENCES.items())
    show(f"{name}: {n} joints; largest difference to Pinocchio: {off}", rows)


def write_pinocchio_model(identified: Identification) -> str:
    """Return the C++ statements that open a block and build Pinocchio's model of the same links and rotors."""
    model = pinocchio.buildModelFromXML(to_urdf(identified).content.decode())
    gravity = ", ".join(repr(float(value)) for value in identified.model.robot.gravity)
    rotors = complete_parameters(identified, rotors_in_links=True).rotors
    lines = ["    { pin::Model model;\n"]
    for j in range(1, model.njoints):
        place, body = model.jointPlacements[j], model.inertias[j]
        rotation, tensor = (" ".join(f"{x!r}," for x in matrix.reshape(-1).tolist())[:-1]
                            for matrix in (place.rotation, body.inertia))  # fmt: skip
        point, lever = (", ".join(repr(x) for x in vector.tolist()) for vector in (place.translation, body.lever))
        kind = model.joints[j].shortname()
        if kind not in ("JointModelRX", "JointModelRY", "JointModelRZ"):
            sys.exit(f"{model.names[j]} is a {kind}; this benchmark is written for joints about their frames' axes")
        lines.append(
            f"    {{ Eigen::Matrix3d r, i; r << {rotation}; i << {tensor};\n"
            f"      const auto id = model.addJoint({model.parents[j]}, pin::{kind}(), "
            f'pin::SE3(r, Eigen::Vector3d({point})), "{j}");\n'
            f"      model.appendBodyToJoint(id, pin::Inertia({body.mass!r}, Eigen::Vector3d({lever}), i), "
            "pin::SE3::Identity()); }\n"
        )
    lines.append(f"    model.gravity.linear() << {gravity};\n")
    lines.append(f"    model.armature << {', '.join(repr(float(value)) for value in rotors)};\n")
    return "".join(lines)


def build(folder: Path) -> None:
    compiler = shutil.which(os.environ.get("CXX", "g++"))
    packages = Path(sysconfig.get_path("purelib"))
    wheel = packages / "cmeel.prefix"
    places = os.environ.get("EIGEN3_INCLUDE_DIR"), "/usr/include/eigen3", str(packages / "casadi/include/eigen3")
    eigen = next((place for place in places if place and Path(place, "Eigen").exists()), None)
    if compiler is None or eigen is None:
        sys.exit("this benchmark needs g++ and Eigen's headers (EIGEN3_INCLUDE_DIR)")
    includes = ["-isystem", eigen, "-isystem", str(wheel / "include")]
    libraries = ["-L", str(wheel / "lib"), f"-Wl,-rpath,{wheel / 'lib'}", "-lpinocchio_default"]
    command = [compiler, *OPTIONS, *includes, "main.cpp", "-o", "main", *libraries]
    subprocess.run(command, cwd=folder, check=True)


if __name__ == "__main__":
    main()
