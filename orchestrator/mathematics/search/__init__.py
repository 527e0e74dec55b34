"""The search for a start at which a system fails: it proposes tests and claims nothing."""

from .falsifier import Falsifier

__all__ = ["Falsifier"]
