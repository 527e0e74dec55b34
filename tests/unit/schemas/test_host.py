"""The name of a host, and faults that are its limits."""

import os
from types import SimpleNamespace

import pytest

from perfbound.schemas.host import host_fault, host_name


def test_a_host_name_is_text(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "uname", lambda: SimpleNamespace(nodename="rig\udcff"))
    assert host_name() == "rig\N{REPLACEMENT CHARACTER}"
    host_name().encode()


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        RuntimeError("can't start new thread"),
        ImportError("libx.so: failed to map segment from shared object"),
        OSError(12, "Cannot allocate memory"),
    ],
)
def test_what_is_used_up_is_one_line_with_the_remedy(error: Exception) -> None:
    assert "raise the limit" in (host_fault(error) or "")


def test_another_fault_is_none_of_the_host() -> None:
    assert host_fault(RuntimeError("of a system")) is None
    assert host_fault(UnicodeEncodeError("ascii", "\u00e4", 0, 1, "ordinal not in range(128)")) is None
