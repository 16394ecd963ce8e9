"""Learns the stiffness field of an object from joint torques, while a robot arm touches the object.

Joint positions are in rad (m where prismatic), torques in N·m, stiffness in N/m, lengths in m;
points are in the frame of the robot's base. Returned arrays are read-only NumPy arrays, without a
copy.
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
    excite,
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
    "excite",
    "external_torques",
    "extrapolate",
    "identify",
    "inspect",
    "map_elastic",
    "open_log",
    "tune",
]
