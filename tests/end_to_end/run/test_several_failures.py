"""A search for several kinds of failures, by workers of its own, and what the certificate says of each."""

import json

import pytest

from tests.end_to_end.processes import Processes

SYSTEM = '''
import numpy as np

import perfbound as pb

@pb.system(
    parameters={
        "power": pb.Parameter(0, 1, signal=True),
        "outside": pb.Parameter(-20, 20),
        "wind": pb.Parameter(0, 2),
    },
    columns={"temperature": "1"},
    step=0.25,
)
def heater(power, outside, wind, *, horizon):
    """Return the temperature of a room: too warm by much power at some time, too cold by cold and wind."""
    t = np.arange(0.0, horizon + 0.125, 0.25)
    return 20.0 + 8.0 * (power(t) - 0.5) - 0.25 * max(0.0, -outside) * wind
'''
CAMPAIGN = """
horizon = 10
specification = "always (temperature >= 14) and always (temperature <= 23.5)"
falsify = { until = "UNTIL" }
max_tests = 60
window = 2
system.python = "heater.py:heater"
[space]
power = { low = 0, high = 1, signal = "linear", knots = 3 }
outside = [-20, 20]
wind = [0, 2]
"""


@pytest.mark.journey
def test_kinds_of_failures_are_found_for_any_number_of_workers_and_verify(started: Processes) -> None:
    (started.folder / "heater.py").write_text(SYSTEM)
    (started.folder / "heater.toml").write_text(CAMPAIGN.replace("UNTIL", "3 clusters"))
    for workers in ("1", "2"):
        ended = started.run("perfbound", "run", "heater.toml", "--out", f"by-{workers}", "--workers", workers)
        assert ended.code == 0, ended.err
    one, two = ((started.folder / f"by-{workers}" / "certificate.json").read_bytes() for workers in ("1", "2"))
    assert one == two
    found = json.loads(one)["predicate"]["failures"]["clusters"]
    kinds = [tuple(each["violated"]) for each in found]
    assert {("always temperature >= 14",), ("always temperature <= 23.5",)} <= set(kinds)
    for each in found:
        away = set(each["simplest"]["away"])
        if each["violated"] == ["always temperature <= 23.5"]:
            assert len(away) == 1, "one knot is enough"
            assert away <= {"power_0", "power_1", "power_2"}
        elif each["violated"] == ["always temperature >= 14"]:
            assert "outside" in away, "not by what is too warm"
    checked = started.run("perfbound", "verify", "by-2", "--resimulate", "3", "--system", "heater.py:heater")
    assert checked.code == 0, checked.out + checked.err
