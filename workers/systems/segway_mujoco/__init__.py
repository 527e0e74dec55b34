"""The Segway in MuJoCo: the plant, the controller and the columns of `segway`, in another engine."""

from .system import MujocoSegway

__all__ = ["MujocoSegway"]
