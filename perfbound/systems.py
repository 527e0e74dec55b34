"""The public API for systems under test: everything that a simulator of one's own imports."""

from .schemas.errors import SimulationError
from .schemas.file.disturbance import Choice, Disturbance, Law, LogNormal, Normal, Triangular, Uniform, Weibull
from .schemas.system import Column, Option, OptionValue, Parameter, SystemSpec, Variant
from .schemas.trajectory.input_signal import InputSignal
from .schemas.trajectory.trajectory import Trajectory, Transform, Visual
from .workers.systems.base import Cancelled, Progress, SystemUnderTest, checked_options
from .workers.systems.decorator import system
from .workers.systems.noise import normal, uniform
from .workers.systems.place import Worker

__all__ = [
    "Cancelled",
    "Choice",
    "Column",
    "Disturbance",
    "InputSignal",
    "Law",
    "LogNormal",
    "Normal",
    "Option",
    "OptionValue",
    "Parameter",
    "Progress",
    "SimulationError",
    "SystemSpec",
    "SystemUnderTest",
    "Trajectory",
    "Transform",
    "Triangular",
    "Uniform",
    "Variant",
    "Visual",
    "Weibull",
    "Worker",
    "checked_options",
    "normal",
    "system",
    "uniform",
]
