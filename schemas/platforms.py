"""Classes of platforms: on machines of one class, equal requests give equal bytes.

The C library and numpy choose their sin, tanh or atan2 by the instruction sets of the CPU. Across classes a rollout may
differ in its last bits.
"""

import os
import platform
from functools import cache
from pathlib import Path

ANY = "any"
"""In a campaign file: workers of every class."""
CPU_INFO = Path("/proc/cpuinfo")
INSTRUCTION_SETS = ("fma", "avx2", "avx512f")


@cache
def platform_class() -> str:
    """Return the class of this machine: vendor, family and instruction sets of its CPU, and its C library."""
    return class_name(cpu(), " ".join(platform.libc_ver()))


def class_name(processor: str, libc: str) -> str:
    """Return the name of a class.

    >>> class_name("GenuineIntel 6 fma avx2", "glibc 2.36")
    'genuineintel-6-fma-avx2-glibc-2.36'
    """
    return "-".join(f"{processor} {libc}".lower().split())


def cpu() -> str:
    """Return vendor, family and instruction sets of the CPU, as far as the system reports them."""
    if not CPU_INFO.exists():
        return platform.processor() or platform.machine()
    lines = (line.partition(":") for line in CPU_INFO.read_text().splitlines())
    fields = {name.strip(): value.strip() for name, _, value in lines}
    flags = set(fields.get("flags", "").split())
    present = [name for name in INSTRUCTION_SETS if name in flags]
    if "vendor_id" not in fields:  # not of the x86 family
        return platform.machine()
    return " ".join([fields["vendor_id"], fields.get("cpu family", "?"), *present])


def one_blas_thread() -> None:
    """Have BLAS use one thread: its number decides the last digits. Call it before numpy is loaded."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ[name] = "1"
