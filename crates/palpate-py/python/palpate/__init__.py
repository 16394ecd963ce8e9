"""Learns where an object is stiff from what a robot arm's joints feel while the arm touches it.

Joint positions are in rad (m where prismatic), torques in N·m, stiffness in N/m, lengths in m;
points are in the frame of the robot's base. Arrays that come out are NumPy's, read-only, and share
their memory with what they came out of.
"""

from importlib.metadata import version

from ._palpate import (
    Answer,
    Extrapolation,
    Field,
    FileError,
    Lattice,
    Log,
    LogError,
    Mapper,
    PalpateError,
    PalpateWarning,
    PathPredictor,
    Robot,
    SettingsError,
    StepReport,
    Touch,
    TouchError,
    default_settings,
    evaluate,
    external_torques,
    extrapolate,
    identify,
    inspect,
    map_elastic,
    open_log,
    tune,
)

__version__ = version("palpate")

__all__ = [
    "Answer",
    "Extrapolation",
    "Field",
    "FileError",
    "Lattice",
    "Log",
    "LogError",
    "Mapper",
    "PalpateError",
    "PalpateWarning",
    "PathPredictor",
    "Robot",
    "SettingsError",
    "StepReport",
    "Touch",
    "TouchError",
    "default_settings",
    "evaluate",
    "external_torques",
    "extrapolate",
    "identify",
    "inspect",
    "map_elastic",
    "open_log",
    "tune",
]
