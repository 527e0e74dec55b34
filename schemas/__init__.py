"""Every noun, and every border: campaign files, messages, facts, trajectory files, the certificate."""

from importlib.metadata import version

__version__ = version("perfbound")
