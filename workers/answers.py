"""The answer of a child process to the one that started it: on a descriptor of its own.

The standard output is anyone's: Python's own start files, libraries in C, a system while it loads.
"""

import os

STDOUT = 1
_descriptor = STDOUT


def answer_on(descriptor: int) -> None:
    """Write the answer into a file or pipe that the other process has opened; no program of a system inherits it."""
    global _descriptor  # noqa: PLW0603  (one process has one)
    os.set_inheritable(descriptor, False)
    _descriptor = descriptor


def answer(text: str) -> None:
    """Write the answer, a line."""
    with os.fdopen(os.dup(_descriptor), "w", encoding="utf-8") as stream:
        stream.write(f"{text}\n")
