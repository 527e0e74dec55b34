"""What crosses a border: campaign files, messages, the trajectory file, the certificate."""

from importlib.metadata import version

__version__ = version("perfbound")
