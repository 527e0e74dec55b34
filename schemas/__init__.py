"""Every noun, and every border: campaign files, messages, facts, trajectory files, the certificate."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str


def __getattr__(name: str) -> Any:
    """Return the version of the installed package at its first use: its metadata costs a quick command a tenth."""
    from importlib.metadata import version  # noqa: PLC0415

    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return version("perfbound")
