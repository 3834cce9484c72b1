"""Write a ROS 2 package around the C++ header: a plug-in of `inverse_dynamics_solver`, for controllers that want terms.

The interface is that of https://github.com/unisa-acg/inverse-dynamics-solver, which model-based controllers of
ros2_control load. The package consists of a core class, which knows no ROS, and a plug-in around it.
"""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath

from dynident.errors import DynidentError
from dynident.export.c_header import HeaderFunction, list_functions, to_cpp_header
from dynident.export.comments_and_names import (
    describe_identification,
    describe_origin,
    escape_c_comment,
    list_joints,
    replace_unprintable,
)
from dynident.export.feasible_links_and_joints import ExportedFile
from dynident.identification import Identification
from dynident.identification.identified_models.equation_of_motion import build_equation_of_motion
from dynident.text_encoding import encode_text

# What the interface of the plug-in, or its hysteresis between two calls, can give to the functions of the header.
_GIVEN = frozenset({"q", "dq", "ddq", "z"})
# Zip files state a date for each member; a fixed one makes the same model the same bytes.
_DATE = (2020, 1, 1, 0, 0, 0)


def to_ros2_package(identification: Identification, notes: Sequence[str] = ()) -> ExportedFile:
    """Return the identified model as a ROS 2 package, in a zip file.

    Parameters
    ----------
    identification : Identification
        The identified model, with the data of its fit.
    notes : sequence of str
        Further sentences that users must know, for the head of the header and the file's notes.

    Returns
    -------
    ExportedFile
        The zip file, whose one folder is the package, with notes on what a user must know.

    Raises
    ------
    DynidentError
        Where an effect needs more than positions, velocities and accelerations, such as a temperature.
    """
    header = to_cpp_header(identification, notes=notes)
    model = PurePosixPath(header.name).stem
    package = f"{model}_solver"
    equation = build_equation_of_motion(identification.estimate)
    functions = {function.name: function for function in list_functions(equation)}
    missing = sorted({a.name for f in functions.values() for a in f.inputs} - _GIVEN - {"tau"})
    if missing:
        raise DynidentError(
            f"effects of the model depend on {', '.join(missing)}, which controllers of ros2_control do not give to an "
            "inverse dynamics solver; leave these effects out, or export the C++ header",
            pointer="/format",
            title="Not expressible as a ROS 2 package",
        )
    names = [line.name for line in list_joints(identification)]
    joints = ", ".join(_quote(name) for name in names)
    values = {
        "@PACKAGE@": package,
        "@MODEL@": model,
        "@HEADER@": header.name,
        "@GUARD@": package.upper(),
        "@N@": str(len(names)),
        "@JOINTS@": joints,
        "@ORIGIN@": escape_c_comment(describe_origin()),
        "@ABOUT@": "\n".join(f"* {replace_unprintable(line)}" for line in describe_identification(identification)),
        "@ADVANCE@": "model_.advance(q);" if equation.z_next.numel() else "static_cast<void>(q);",
        "@FRICTION@": _write_call(functions["friction"]),
        "@TORQUE@": _write_call(functions["inverse_dynamics"]),
    }
    files = {path: _fill(text, values) for path, text in _FILES.items()}
    files = {_fill(path, values): text for path, text in files.items()}
    content = _pack(package, {path: encode_text(text) for path, text in files.items()} | {
        f"include/{package}/{header.name}": header.content
    })  # fmt: skip
    return ExportedFile(f"{package}.zip", "application/zip", content, (*header.notes, _NOT_RUN))


def _write_call(function: HeaderFunction) -> str:
    """Return the call of a method, whose hysteresis is inside the class; friction alone knows no acceleration."""
    passed = ["zero" if a.name == "ddq" and function.name == "friction" else a.name for a in function.inputs]
    return f"model_.{function.name}({', '.join(name for name in passed if name != 'z')})"


def _quote(name: str) -> str:
    """Return a name in double quotes, for C++ and YAML alike."""
    safe = replace_unprintable(name).replace("\\", "\\\\").replace('"', '\\"')
    return f'"{safe}"'


def _fill(text: str, values: Mapping[str, str]) -> str:
    # In one pass: a name of the user's may look like a placeholder.
    return re.sub("@[A-Z]+@", lambda match: values[match[0]], text)


def _pack(folder: str, files: Mapping[str, bytes]) -> bytes:
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
        for path, content in sorted(files.items()):
            packed.writestr(zipfile.ZipInfo(f"{folder}/{path}", _DATE), content, zipfile.ZIP_DEFLATED)
    return archive.getvalue()


def unpack_files(content: bytes) -> dict[str, bytes]:
    """Return the files of an exported package by their paths, `package/folder/file`.

    Parameters
    ----------
    content : bytes
        The zip file.
    """
    with zipfile.ZipFile(io.BytesIO(content)) as packed:
        return {name: packed.read(name) for name in packed.namelist()}


_NOT_RUN = (
    "The core of the package was compiled and compared with the model. The plug-in around it was never compiled or run "
    "with ROS 2: try it before a robot moves with it."
)

_CORE = """\
/* Terms of the equation of motion, without ROS; @ORIGIN@. */
#ifndef @GUARD@_DYNAMICS_HPP
#define @GUARD@_DYNAMICS_HPP

#include <array>
#include <cstddef>

#include "@PACKAGE@/@HEADER@"

namespace @PACKAGE@ {

class Dynamics {
 public:
    using Vector = @MODEL@::Model::Vector;
    using Matrix = @MODEL@::Model::Matrix; /* row by row */
    static constexpr std::size_t joints = @MODEL@::Model::joints;

    /* Names of the joints, in the order of every vector. */
    static constexpr std::array<const char*, @N@> joint_names() { return {@JOINTS@}; }

    /* Load on the last link: kg; m in its frame; kg m^2 about the centre of mass: xx, xy, xz, yy, yz, zz. */
    void set_payload(double mass, const std::array<double, 3>& centre, const std::array<double, 6>& inertia) noexcept
    {
        model_.set_payload(mass, centre, inertia);
    }

    /* Say where the joints are. Friction of a model with hysteresis depends on the way there; the same position twice
       is no way, so that every term may say it again. */
    void move_to(const Vector& q) noexcept
    {
        @ADVANCE@
        last_ = q;
    }

    Matrix mass_matrix(const Vector& q) const noexcept { return model_.mass_matrix(q); }
    Vector coriolis(const Vector& q, const Vector& dq) const noexcept { return model_.coriolis(q, dq); }
    Vector gravity(const Vector& q) const noexcept { return model_.gravity(q); }

    /* Friction at the last position. Friction that grows with an accelerated load counts without acceleration. */
    Vector friction(const Vector& dq) const noexcept
    {
        const Vector& q = last_;
        const Vector zero{};
        static_cast<void>(q);
        static_cast<void>(zero);
        return @FRICTION@;
    }

    /* Torque of a motion with all effects of the model, friction and offsets among them. */
    Vector torque(const Vector& q, const Vector& dq, const Vector& ddq) const noexcept
    {
        return @TORQUE@;
    }

 private:
    @MODEL@::Model model_{};
    Vector last_{};
};

} // namespace @PACKAGE@

#endif
"""

_SOLVER = """\
/* Plug-in of inverse_dynamics_solver around the class Dynamics; @ORIGIN@. Not run: see the README. */
#include <algorithm>
#include <array>
#include <cstddef>
#include <stdexcept>
#include <string>
#include <vector>

#include <Eigen/Core>
#include <inverse_dynamics_solver/inverse_dynamics_solver.hpp>
#include <pluginlib/class_list_macros.hpp>
#include <rclcpp/node_interfaces/node_parameters_interface.hpp>

#include "@PACKAGE@/dynamics.hpp"

namespace @PACKAGE@ {

class Solver : public inverse_dynamics_solver::InverseDynamicsSolver {
 public:
    void initialize(
        rclcpp::node_interfaces::NodeParametersInterface::ConstSharedPtr parameters = nullptr,
        const std::string& space = "", const std::string& = "") override
    {
        if (!parameters) return;
        const std::string prefix = space.empty() ? "" : space + ".";
        const auto numbers = [&](const std::string& name, std::size_t size) {
            std::vector<double> values(size, 0.0);
            if (parameters->has_parameter(prefix + name)) {
                values = parameters->get_parameter(prefix + name).as_double_array();
                if (values.size() != size) throw std::invalid_argument(prefix + name + " has another length");
            }
            return values;
        };
        const std::string mass = prefix + "payload.mass";
        const std::vector<double> centre = numbers("payload.centre", 3), inertia = numbers("payload.inertia", 6);
        std::array<double, 3> place{};
        std::array<double, 6> moments{};
        std::copy(centre.begin(), centre.end(), place.begin());
        std::copy(inertia.begin(), inertia.end(), moments.begin());
        dynamics_.set_payload(
            parameters->has_parameter(mass) ? parameters->get_parameter(mass).as_double() : 0.0, place, moments);
    }

    Eigen::MatrixXd getInertiaMatrix(const Eigen::VectorXd& q) const override
    {
        using RowMajor = Eigen::Matrix<double, Dynamics::joints, Dynamics::joints, Eigen::RowMajor>;
        const Dynamics::Matrix mass = dynamics_.mass_matrix(to_array(q));
        return Eigen::Map<const RowMajor>(mass.data());
    }

    Eigen::VectorXd getCoriolisVector(const Eigen::VectorXd& q, const Eigen::VectorXd& dq) const override
    {
        return to_eigen(dynamics_.coriolis(to_array(q), to_array(dq)));
    }

    Eigen::VectorXd getGravityVector(const Eigen::VectorXd& q) const override
    {
        dynamics_.move_to(to_array(q));
        return to_eigen(dynamics_.gravity(to_array(q)));
    }

    Eigen::VectorXd getFrictionVector(const Eigen::VectorXd& dq) const override
    {
        return to_eigen(dynamics_.friction(to_array(dq)));
    }

    Eigen::VectorXd getTorques(
        const Eigen::VectorXd& q, const Eigen::VectorXd& dq, const Eigen::VectorXd& ddq) const override
    {
        dynamics_.move_to(to_array(q));
        return to_eigen(dynamics_.torque(to_array(q), to_array(dq), to_array(ddq)));
    }

 private:
    static Dynamics::Vector to_array(const Eigen::VectorXd& values)
    {
        if (static_cast<std::size_t>(values.size()) != Dynamics::joints)
            throw std::invalid_argument("the model has another number of joints");
        Dynamics::Vector result{};
        std::copy(values.data(), values.data() + values.size(), result.begin());
        return result;
    }

    static Eigen::VectorXd to_eigen(const Dynamics::Vector& values)
    {
        return Eigen::Map<const Eigen::VectorXd>(values.data(), static_cast<Eigen::Index>(values.size()));
    }

    /* The interface has const methods; a solver serves one controller, whose loop calls it from one thread. */
    mutable Dynamics dynamics_{};
};

} // namespace @PACKAGE@

PLUGINLIB_EXPORT_CLASS(@PACKAGE@::Solver, inverse_dynamics_solver::InverseDynamicsSolver)
"""

_CMAKE = """\
cmake_minimum_required(VERSION 3.16)
project(@PACKAGE@ CXX)

if(CMAKE_CXX_COMPILER_ID MATCHES "GNU|Clang")
  add_compile_options(-Wall -Wextra -Wpedantic)
endif()

find_package(ament_cmake REQUIRED)
find_package(Eigen3 REQUIRED)
find_package(inverse_dynamics_solver REQUIRED)
find_package(pluginlib REQUIRED)
find_package(rclcpp REQUIRED)

add_library(@PACKAGE@ SHARED src/solver.cpp)
target_compile_features(@PACKAGE@ PUBLIC cxx_std_17)
target_include_directories(@PACKAGE@ PUBLIC
  $<BUILD_INTERFACE:${CMAKE_CURRENT_SOURCE_DIR}/include>
  $<INSTALL_INTERFACE:include>)
target_include_directories(@PACKAGE@ PRIVATE ${inverse_dynamics_solver_INCLUDE_DIRS})
target_link_libraries(@PACKAGE@ PRIVATE Eigen3::Eigen pluginlib::pluginlib rclcpp::rclcpp)
pluginlib_export_plugin_description_file(inverse_dynamics_solver @PACKAGE@.xml)

install(DIRECTORY include/ DESTINATION include)
install(DIRECTORY config launch DESTINATION share/${PROJECT_NAME})
install(TARGETS @PACKAGE@ EXPORT export_${PROJECT_NAME}
  ARCHIVE DESTINATION lib LIBRARY DESTINATION lib RUNTIME DESTINATION bin)

ament_export_dependencies(inverse_dynamics_solver pluginlib rclcpp)
ament_export_targets(export_${PROJECT_NAME})
ament_package()
"""

_PACKAGE = """\
<?xml version="1.0"?>
<?xml-model href="http://download.ros.org/schema/package_format3.xsd" schematypens="http://www.w3.org/2001/XMLSchema"?>
<package format="3">
  <name>@PACKAGE@</name>
  <version>0.1.0</version>
  <description>Identified dynamics of a robot as an inverse dynamics solver.</description>
  <maintainer email="name@example.com">your name</maintainer>
  <license>your license</license>

  <buildtool_depend>ament_cmake</buildtool_depend>

  <depend>eigen</depend>
  <depend>inverse_dynamics_solver</depend>
  <depend>pluginlib</depend>
  <depend>rclcpp</depend>

  <exec_depend>launch</exec_depend>
  <exec_depend>launch_ros</exec_depend>

  <export>
    <build_type>ament_cmake</build_type>
  </export>
</package>
"""

_PLUGIN = """\
<library path="@PACKAGE@">
  <class name="@PACKAGE@/Solver" type="@PACKAGE@::Solver"
         base_class_type="inverse_dynamics_solver::InverseDynamicsSolver">
    <description>Identified dynamics of a robot.</description>
  </class>
</library>
"""

_PARAMETERS = """\
# Parameters of the plug-in, below the name that the controller gives to its solver (`ids` in the launch file).
/**:
  ros__parameters:
    ids:
      # Order of the joints in every vector; the plug-in does not read it.
      joints: [@JOINTS@]
      payload:
        mass: 0.0  # kg, on the last link
        centre: [0.0, 0.0, 0.0]  # m, in the last link's frame
        inertia: [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]  # kg m^2 about the centre of mass: xx, xy, xz, yy, yz, zz
"""

_LAUNCH = '''\
"""Compute the torques of a recorded motion (a bag of joint states) with the plug-in, and write them to a new bag."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description():
    bags = [
        DeclareLaunchArgument("input_bag", description="bag of sensor_msgs/JointState"),
        DeclareLaunchArgument("output_bag", description="bag to write"),
        DeclareLaunchArgument("topic", default_value="/torques", description="topic of the torques"),
    ]
    node = Node(
        package="inverse_dynamics_solver",
        executable="evaluate_solver",
        parameters=[
            PathJoinSubstitution([FindPackageShare("@PACKAGE@"), "config", "parameters.yaml"]),
            {"plugin_name": "@PACKAGE@/Solver", "robot_description": ""},
            {name: LaunchConfiguration(name) for name in ("input_bag", "output_bag", "topic")},
        ],
    )
    return LaunchDescription([*bags, node])
'''

_README = """\
# @PACKAGE@

The identified dynamics of a robot, @ORIGIN@, as a plug-in of
[inverse_dynamics_solver](https://github.com/unisa-acg/inverse-dynamics-solver) for controllers of ros2_control.

@ABOUT@

**Not run with ROS 2.** `include/` was compiled and compared with the model. `src/solver.cpp`, the launch file and the
build were written by the published interface, and never run. Try them before a robot moves.

    ros2 launch @PACKAGE@ evaluate.launch.py input_bag:=motion output_bag:=torques

* The plug-in's name is `@PACKAGE@/Solver`. Order of the joints: @JOINTS@.
* `getTorques` returns the torque of all effects, friction and offsets among them. The sum of the other terms lacks
  effects that are neither inertia, gravity nor friction.
* `getFrictionVector` uses the position of the last call of `getGravityVector` or `getTorques`.
* `config/parameters.yaml` has the load. Gravity, base and robot are those of the identification.
* State maintainer and license in `package.xml`.
"""

_FILES = {
    "include/@PACKAGE@/dynamics.hpp": _CORE,
    "src/solver.cpp": _SOLVER,
    "CMakeLists.txt": _CMAKE,
    "package.xml": _PACKAGE,
    "@PACKAGE@.xml": _PLUGIN,
    "config/parameters.yaml": _PARAMETERS,
    "launch/evaluate.launch.py": _LAUNCH,
    "README.md": _README,
}
"""The package's files, with placeholders between @ signs."""
