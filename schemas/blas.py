"""The number of threads of BLAS, which decides the last digits of results."""

import os


def one_blas_thread() -> None:
    """Have BLAS use one thread: results must not depend on the number of cores. Call it before numpy is loaded."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
