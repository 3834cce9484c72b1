"""Arms that another engine moves: MuJoCo in closed loop, with a physical effect hidden in them.

Nothing here comes from the program under test except the description of a robot (joints, placements, limits, inertial
parameters). Used by the benchmark of hidden effects and by tests.
"""

from engine.closed_loop import record
from engine.drives import Drives, effort_limits, usual_drives
from engine.instruments import Instruments
from engine.motions import Motion, fourier_motion
from engine.physics import Hidden, Plan
from engine.point_to_point import point_to_point_motion
from engine.scene import Arm, FloatArray, Run
from engine.servos import Bandwidth, Lag, Servo

__all__ = [
    "Arm",
    "Bandwidth",
    "Drives",
    "FloatArray",
    "Hidden",
    "Instruments",
    "Lag",
    "Motion",
    "Plan",
    "Run",
    "Servo",
    "effort_limits",
    "fourier_motion",
    "point_to_point_motion",
    "record",
    "usual_drives",
]
