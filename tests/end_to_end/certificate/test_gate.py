"""`perfbound gate` in a pipeline: its exit codes, its files, and a system that is simulated again."""

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest

from perfbound.orchestrator.certificate.signing import keys, sign
from tests.end_to_end.processes import Processes, contents

CAMPAIGN = Path(__file__).parents[2] / "fixtures" / "finished" / "sample.toml"


@pytest.mark.journey
def test_a_gate_is_green_red_or_unreadable(started: Processes) -> None:
    run = started.folder / "sample"
    assert started.run("perfbound", "run", CAMPAIGN, "--out", run).code == 0
    policy, junit, sarif, summary = (started.folder / name for name in ("p.toml", "gate.xml", "gate.sarif", "gate.md"))
    before = contents(run)
    gate = ("perfbound", "gate", run, "--policy", policy)
    policy.write_text("at_most = 0.45\nresimulated = 2\n")
    ended = started.run(*gate)
    assert ended.code == 0, ended.out + ended.err
    assert "GATE PASSED: 3 rules hold" in ended.out
    policy.write_text("at_most = 0.1\n")
    for times in (1, 2):
        ended = started.run(*gate, "--junit", junit, "--sarif", sarif, "--markdown", summary)
        assert ended.code == 3
        assert "GATE FAILED: 1 rule fails" in ended.out
        assert ElementTree.parse(junit).find(".//failure").attrib["type"] == "at_most"  # type: ignore[union-attr]
        assert [each["ruleId"] for each in json.loads(sarif.read_text())["runs"][0]["results"]][:1] == ["at_most"]
        assert summary.read_text().count("GATE FAILED") == times, "a summary is appended"
    assert contents(run) == before
    keys.new_pair(started.folder, "ci")
    attestation = started.folder / "gate.intoto.json"
    signed = ("--attestation", attestation, "--sign", started.folder / "ci.key")
    assert started.run(*gate, *signed).code == 3
    public = keys.load_public(started.folder / "ci.pub")
    statement = json.loads(sign.signed_payload(attestation.read_bytes(), public))
    assert statement["predicate"]["result"] == "FAILED"
    assert statement["subject"][0]["name"] == f"{run}/certificate.json"
    assert started.run(*gate, *signed[2:]).code == 2
    policy.write_text("at_mst = 0.1\n")
    ended = started.run(*gate)
    assert ended.code == 1
    assert "did you mean 'at_most'?" in ended.err
    policy.write_text("")
    (run / "certificate.json").unlink()
    assert started.run(*gate).code == 1
    assert started.run("perfbound", "gate", "--policy", policy).code == 2
