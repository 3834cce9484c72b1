"""The ROS 2 package: its core computes the model's torque, its plug-in compiles against the published interface."""

from __future__ import annotations

import ast
import shutil
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import casadi
import numpy as np
import pytest
import yaml
from support.exported_programs import MODELS, check_stated_error, held_out, identify_arm
from support.models_with_chosen_parameters import FloatArray, from_standard, path, predicted
from support.one_joint_robots import one_joint_urdf
from support.oracles import Motion

from dynident.errors import DynidentError
from dynident.export import to_ros2_package, unpack_files
from dynident.file_output import write_atomically
from dynident.identification import Identification
from dynident.robot import robot_from_urdf

STRICT = ("-std=c++17", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic")
EIGEN = Path(casadi.__file__).parent / "include" / "eigen3"
# The interface as unisa-acg/inverse-dynamics-solver publishes it, and what the plug-in uses of ROS, without bodies.
INTERFACE = {
    "inverse_dynamics_solver/inverse_dynamics_solver.hpp": """
#pragma once
#include <string>
#include <Eigen/Core>
#include <rclcpp/node_interfaces/node_parameters_interface.hpp>
namespace inverse_dynamics_solver {
using V = Eigen::VectorXd;
struct InverseDynamicsSolver {
    virtual ~InverseDynamicsSolver() {}
    virtual void initialize(rclcpp::node_interfaces::NodeParametersInterface::ConstSharedPtr = nullptr,
                            const std::string& = "", const std::string& = "") = 0;
    virtual Eigen::MatrixXd getInertiaMatrix(const V&) const = 0;
    virtual V getCoriolisVector(const V&, const V&) const = 0;
    virtual V getGravityVector(const V&) const = 0;
    virtual V getFrictionVector(const V&) const = 0;
    virtual V getTorques(const V&, const V&, const V&) const = 0;
};
}
""",
    "rclcpp/node_interfaces/node_parameters_interface.hpp": """
#pragma once
#include <memory>
#include <string>
#include <vector>
namespace rclcpp {
struct Parameter { double as_double() const { return 0; } std::vector<double> as_double_array() const { return {}; } };
namespace node_interfaces {
struct NodeParametersInterface {
    using ConstSharedPtr = std::shared_ptr<const NodeParametersInterface>;
    virtual ~NodeParametersInterface() {}
    virtual bool has_parameter(const std::string&) const = 0;
    virtual Parameter get_parameter(const std::string&) const = 0;
};
} }
""",
    "pluginlib/class_list_macros.hpp": "#define PLUGINLIB_EXPORT_CLASS(kind, base) base* make() { return new kind; }\n",
}
MAIN = """
#include <cstdio>
#include "PACKAGE/dynamics.hpp"
int main()
{
    PACKAGE::Dynamics dynamics;
    PACKAGE::Dynamics::Vector motion[3];
    while (std::fread(motion, sizeof motion, 1, stdin) == 1) {
        dynamics.move_to(motion[0]);
        dynamics.move_to(motion[0]);
        const auto tau = dynamics.torque(motion[0], motion[1], motion[2]);
        std::fwrite(tau.data(), sizeof(double), tau.size(), stdout);
        if (dynamics.friction(motion[1]).size() != dynamics.joint_names().size()) return 1;
    }
    return 0;
}
"""


def write_package(identification: Identification, folder: Path) -> Path:
    file = to_ros2_package(identification)
    assert any("never compiled or run with ROS 2" in note for note in file.notes)
    for place, content in unpack_files(file.content).items():
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        write_atomically(folder / place, content)
    return folder / file.name.removesuffix(".zip")


def compile_strictly(compiler: str, *words: str) -> None:
    if shutil.which(compiler) is None:
        pytest.skip(f"NO {compiler}: the package is not compiled with it here")
    done = subprocess.run([compiler, *STRICT, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[:2000]


def run_core(package: Path, motion: Motion, compiler: str) -> FloatArray:
    """Torque that the core of a package computes along a motion."""
    source, program = package.parent / "main.cpp", package.parent / "main"
    source.write_text(MAIN.replace("PACKAGE", package.name), encoding="utf-8")
    compile_strictly(compiler, "-I", f"{package / 'include'}", str(source), "-o", str(program))
    rows = np.hstack([motion.q, motion.dq, motion.ddq])
    answer = subprocess.run([program], input=rows.astype(np.float64).tobytes(), capture_output=True, check=True)
    return np.frombuffer(answer.stdout).reshape(motion.q.shape)


@pytest.mark.parametrize(
    ("name", "compiler"), [("plain", "g++"), ("plain", "clang++"), ("hysteresis on a tree", "g++")]
)
def test_the_core_computes_the_torque_of_the_model(name: str, compiler: str, tmp_path: Path) -> None:
    identification = MODELS[name]()
    motion = path(identification.model.robot, 50)
    expected = predicted(identification, motion)
    torque = run_core(write_package(identification, tmp_path), motion, compiler)
    np.testing.assert_allclose(torque, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_a_package_states_the_error_that_its_core_has_on_held_out_motion(tmp_path: Path) -> None:
    package = write_package(identify_arm(), tmp_path)
    check_stated_error((package / "README.md").read_text(encoding="utf-8"), run_core(package, held_out(), "g++"))


def test_the_plug_in_fits_the_published_interface(tmp_path: Path) -> None:
    package = write_package(MODELS["plain"](), tmp_path)
    for place, content in INTERFACE.items():
        (tmp_path / place).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / place).write_text(content, encoding="utf-8")
    includes = ("-I", str(package / "include"), "-I", str(tmp_path), "-isystem", str(EIGEN))
    compile_strictly("g++", *includes, "-c", str(package / "src" / "solver.cpp"), "-o", str(tmp_path / "solver.o"))


def test_a_name_like_a_placeholder_stays_a_name() -> None:
    """Filled one after the other, the description would end the string of the name, and the rest would be code."""
    text = one_joint_urdf("pendulum").replace('name="axis"', 'name="@ABOUT@"')
    robot = robot_from_urdf('x"}; } int inserted() { return 0; } //', text)
    files = unpack_files(to_ros2_package(from_standard(robot)).content)
    [core] = [content.decode() for place, content in files.items() if place.endswith("dynamics.hpp")]
    assert 'return {"@ABOUT@"};' in core
    assert "int inserted" not in core


def test_the_descriptions_are_well_formed_and_name_each_other(tmp_path: Path) -> None:
    package = write_package(MODELS["plain"](), tmp_path)
    stated = ElementTree.parse(package / "package.xml").getroot()
    assert stated.findtext("name") == package.name
    plugin = ElementTree.parse(package / f"{package.name}.xml").getroot().find("class")
    assert plugin is not None
    assert plugin.get("name") == f"{package.name}/Solver"
    parameters = yaml.safe_load((package / "config" / "parameters.yaml").read_text(encoding="utf-8"))
    robot = MODELS["plain"]().model.robot
    assert parameters["/**"]["ros__parameters"]["ids"]["joints"] == list(robot.joint_names)
    launch = ast.parse((package / "launch" / "evaluate.launch.py").read_text(encoding="utf-8"))
    assert "generate_launch_description" in {node.name for node in launch.body if isinstance(node, ast.FunctionDef)}
    cmake = (package / "CMakeLists.txt").read_text(encoding="utf-8")
    assert f"project({package.name} CXX)" in cmake
    assert f"{package.name}.xml)" in cmake
    left = [file for file in package.rglob("*") if file.is_file() and "@PACKAGE@" in file.read_text(encoding="utf-8")]
    assert not left


def test_effects_that_the_interface_has_no_room_for_are_refused_by_name() -> None:
    with pytest.raises(DynidentError, match=r"depend on .*temperature.*export the C\+\+ header"):
        to_ros2_package(MODELS["everything with a sliding joint"]())
