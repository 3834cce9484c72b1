"""The dynamic model of a robot, identified from measurements.

    import dynident as dy

    robot = dy.load_robot("arm.urdf")
    runs = dy.read_recordings("run1.csv", "run2.csv", robot=robot)
    model = dy.identify(robot, runs[:1], validation=runs[1:])
    found = dy.diagnose(model)
    better = model.extend(found)

The examples of the functions use `dy`, `robot` and `runs` as they are here, but of an arm that is simulated as
`read_recordings` says.

Names are loaded when they are used: `import dynident` alone loads no numpy. The packages below, such as
`dynident.identification`, `dynident.excitation` and `dynident.simulation`, can be used by themselves.
"""

from __future__ import annotations

import sys
from importlib import import_module
from typing import TYPE_CHECKING

from dynident.errors import suggest_names
from dynident.former_modules import FormerModuleFinder
from dynident.lazy_loader import find_export_modules
from dynident.optional_dependencies import MissingPackageFinder, find_missing_package, format_install_hint
from dynident.version import __version__

if TYPE_CHECKING:
    from dynident.advice import CampaignRequest
    from dynident.api.campaigns import Campaign, run_campaign
    from dynident.api.changes_over_time import Changes, FollowedRobot, changes, series
    from dynident.api.effect_arguments import register
    from dynident.api.figure import Figure
    from dynident.api.model import Ladder, Model
    from dynident.api.model_diagnosis import DiagnosedModel, diagnose
    from dynident.api.model_identification import follow, identify, load_model
    from dynident.api.model_report import Report, report
    from dynident.api.model_validation import Validation, Validations, validate
    from dynident.api.motion_design import DesignedMotion, design
    from dynident.api.named_tables import Table
    from dynident.api.parameter_tables import ErrorTable, JointError, Parameters
    from dynident.api.recording_collection import CheckedRecording, Recordings
    from dynident.api.recording_files import InspectedFile, inspect, read_recordings, revise
    from dynident.api.robot_files import load_robot
    from dynident.api.torque_comparison import ComparedRecording, Comparisons, compare
    from dynident.effects import EffectChoice
    from dynident.errors import DynidentError
    from dynident.excitation import CriterionChoice, DesignRequest, TrajectoryRequest
    from dynident.identification import IdentificationChoices
    from dynident.motion import Box, Standing, Surroundings, Wall
    from dynident.recordings import Filters, RecordingError, RecordingMetadata, Revision
    from dynident.robot import Drive, Limits, Robot
    from dynident.robot.description_and_json import set_base

__all__ = [
    "Box",
    "Campaign",
    "CampaignRequest",
    "Changes",
    "CheckedRecording",
    "ComparedRecording",
    "Comparisons",
    "CriterionChoice",
    "DesignRequest",
    "DesignedMotion",
    "DiagnosedModel",
    "Drive",
    "DynidentError",
    "EffectChoice",
    "ErrorTable",
    "Figure",
    "Filters",
    "FollowedRobot",
    "IdentificationChoices",
    "InspectedFile",
    "JointError",
    "Ladder",
    "Limits",
    "Model",
    "Parameters",
    "RecordingError",
    "RecordingMetadata",
    "Recordings",
    "Report",
    "Revision",
    "Robot",
    "Standing",
    "Surroundings",
    "Table",
    "TrajectoryRequest",
    "Validation",
    "Validations",
    "Wall",
    "__version__",
    "changes",
    "compare",
    "design",
    "diagnose",
    "follow",
    "identify",
    "inspect",
    "load_model",
    "load_robot",
    "read_recordings",
    "register",
    "report",
    "revise",
    "run_campaign",
    "series",
    "set_base",
    "validate",
]

_HOME_OF = find_export_modules(__name__)

# Last in line: present modules come first.
sys.meta_path.append(FormerModuleFinder())

_missing = find_missing_package()
if _missing is not None:
    # First in line, so that the message about the extra comes before Python's own error.
    sys.meta_path.insert(0, MissingPackageFinder(_missing))


if not TYPE_CHECKING:
    # Hidden from type checkers: with a module-level __getattr__ they would accept every name.

    def __getattr__(name: str) -> object:
        # Numerical packages take a second or two to load, so they are imported at the first use of a name.
        home = _HOME_OF.get(name)
        if home is None:
            known = suggest_names(name, __all__)
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}{known}")
        try:
            # Stored in the module's namespace, so that Python calls this function once a name.
            value = globals()[name] = getattr(import_module(home), name)
        except ModuleNotFoundError as missing:
            # A module of this library that is missing is an error of the library, not of the installation.
            if (missing.name or "").startswith("dynident"):
                raise
            raise ModuleNotFoundError(
                f"dynident.{name} needs the package {missing.name}, which the light installation leaves out; "
                f"{format_install_hint(missing.name or '')}",
                name=missing.name,
            ) from missing
        return value

    def __dir__() -> list[str]:
        # What is documented; the modules of the library stand in its reference.
        return sorted(__all__)
