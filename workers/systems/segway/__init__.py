"""The default system under test: a Segway that balances and drives to a goal, in PyBullet."""

from .system import SegwaySystem

__all__ = ["SegwaySystem"]
