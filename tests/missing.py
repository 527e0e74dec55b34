"""What this machine lacks: PyBullet, without which the Segway cannot be simulated."""

from perfbound.schemas.errors import UnknownSystemError
from perfbound.workers.systems.segway import bullet


def without_pybullet() -> str:
    """Return the reason why the Segway cannot be simulated here; nothing if it can."""
    try:
        bullet.providers()
    except UnknownSystemError as error:
        return str(error)
    return ""


MISSING = without_pybullet()


def for_want_of_pybullet(reason: str, missing: str = MISSING) -> bool:
    """Whether something failed because PyBullet is not installed."""
    return bool(missing) and (missing.partition(";")[0] in reason or "No module named 'pybullet'" in reason)
