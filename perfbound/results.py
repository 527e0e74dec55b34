"""The public API for results: readers of a trajectory file and of a certificate, and the classes that they return."""

from pathlib import Path

from .schemas.outside import read_outside
from .schemas.ranges import MAX_FILE_BYTES
from .schemas.result.certificate import MAX_CERTIFICATE, Certificate
from .schemas.trajectory.trajectory import Trajectory, decode

__all__ = ["Certificate", "Trajectory", "read_certificate", "read_trajectory"]


def read_trajectory(path: str | Path) -> Trajectory:
    """Return the trajectory of one rollout from its MCAP file; units are those of the system's columns.

    Raises:
        TrajectoryError: the file is not one whole trajectory.
        OSError: it cannot be read.

    """
    return decode(read_outside(Path(path), MAX_FILE_BYTES))


def read_certificate(path: str | Path) -> Certificate:
    """Return the certificate in a file `certificate.json`; it is not verified, which `perfbound verify` does.

    Raises:
        ValueError: the file is no certificate.
        OSError: it cannot be read.

    """
    return Certificate.model_validate_json(read_outside(Path(path), MAX_CERTIFICATE))
