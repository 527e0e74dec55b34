"""The text of an exception of a system, with its place in the system's own code."""

import traceback
from pathlib import Path

from ..schemas.errors import Stopped
from ..schemas.places import own_frame

NOT_OF_SYSTEMS = KeyboardInterrupt, Stopped
"""What ends this process, and says nothing about a system. All else is the system's, also what is no `Exception`: the
cancellation of an event loop, `SystemExit`, the panic of a library in Rust."""
EXTRAS = {
    "fmpy": "fmu",
    "gymnasium": "gymnasium",
    "jax": "jax",
    "mcap_protobuf": "logs",
    "mujoco": "mujoco",
    "pyarrow": "parquet",
    "rosbags": "logs",
}
"""Extras of perfbound by the modules that they install."""
LONGEST_TEXT = 3000
"""Characters of an exception's own text, so that its place behind it is never cut off."""


def fault_text(fault: BaseException) -> str:
    """Return an exception that a system raised as text, with its place in the system's own code.

    `ZeroDivisionError: division by zero (cars.py, line 17)`
    """
    frames = [(each.filename, each.lineno or 0) for each in traceback.extract_tb(fault.__traceback__)]
    found = own_frame(frames)
    place = f" ({Path(found[0]).name}, line {found[1]})" if found else ""
    return reason(fault) + place


def reason(fault: BaseException) -> str:
    """Return an exception as text without its place; of a module that is not there also what to do."""
    try:
        text = str(fault)[:LONGEST_TEXT]
    except Exception:  # noqa: BLE001  (the text is the system's code as well)
        text = ""
    if isinstance(fault, ModuleNotFoundError) and fault.name:
        text = f"{text}; {missing(fault.name)}"
    kind = type(fault).__name__
    return f"{kind}: {text}" if text else kind


def missing(module: str) -> str:
    """Return what to do about a module that is not there.

    >>> missing("mujoco.viewer"), missing("torch")  # doctest: +ELLIPSIS
    ("pip install 'perfbound[mujoco]'", 'fix the name, add its folder to PYTHONPATH, or install its package ...')
    """
    extra = EXTRAS.get(module.partition(".")[0])
    return (
        f"pip install 'perfbound[{extra}]'"
        if extra
        else "fix the name, add its folder to PYTHONPATH, or install its package with the pip of this Python"
    )
