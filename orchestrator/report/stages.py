"""A report without a terminal."""


def unreported(_stage: str, _completed: int, _total: int) -> None:
    """Show no progress."""
