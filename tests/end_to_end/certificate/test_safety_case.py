"""`perfbound export --safety-case` and `--bundle`: files for an assessor, and one file that verifies elsewhere."""

import shutil
import zipfile
from pathlib import Path

import pytest

from tests.end_to_end.processes import Processes

SAMPLE = Path(__file__).parents[2] / "fixtures" / "finished" / "sample"


@pytest.mark.journey
def test_a_bundle_verifies_on_another_machine_and_a_changed_one_does_not(started: Processes) -> None:
    shutil.copytree(SAMPLE, started.folder / "run")
    assert started.run("perfbound", "keygen", "alice", "--out", ".").code == 0
    assert started.run("perfbound", "keygen", "bob", "--out", ".").code == 0
    unsigned = started.run("perfbound", "export", "run", "--safety-case", "case", "--key", "alice.pub")
    assert unsigned.code == 1
    assert "no signature by alice.pub: it is not signed" in unsigned.err
    assert not (started.folder / "case").exists()
    assert started.run("perfbound", "sign", "run", "--key", "alice.key").code == 0
    line = ("perfbound", "export", "run", "--key", "alice.pub")
    other = started.run(*line, "--bundle", "run.zip", "--sign", "bob.key")
    assert other.code == 1
    assert "not signed by the key of --sign: no signature by key" in other.err
    made = started.run(*line, "--safety-case", "case", "--bundle", "run.zip", "--sign", "alice.key")
    assert made.code == 0, made.err
    assert made.out.startswith("SHOWN for the simulator ")
    assert {path.name for path in (started.folder / "case").iterdir()} == {
        "safety-case.pdf",
        "safety-case.svg",
        "safety-case.yaml",
    }
    assert "to check it anywhere: perfbound verify run.zip --key alice.pub" in made.out
    assert "not signed" not in made.out
    shutil.rmtree(started.folder / "run")
    verify = ("perfbound", "verify", "run.zip", "--key", "alice.pub")
    verified = started.run(*verify)
    assert verified.code == 0, verified.out
    assert verified.out.splitlines()[-1].startswith("VERIFIED: ")
    assert "made again" in verified.out
    with zipfile.ZipFile(started.folder / "run.zip", "a") as bundle:
        bundle.writestr("run/notes.txt", "more")
    changed = started.run(*verify)
    assert changed.code == 1
    assert changed.out.splitlines()[-1].startswith("NOT VERIFIED: ")
    assert "run/notes.txt is not in its list" in " ".join(changed.out.split())


@pytest.mark.journey
def test_digests_alone_verify_the_signature_and_say_what_they_do_not(started: Processes) -> None:
    shutil.copytree(SAMPLE, started.folder / "run")
    made = started.run("perfbound", "export", "run", "--bundle", "run.zip", "--digests")
    assert made.code == 0
    assert "Its list is not signed" in made.out
    found = started.run("perfbound", "verify", "run.zip")
    assert found.code == 0
    assert "what follows from the trajectories, which are not here, were not checked" in " ".join(found.out.split())
    assert started.run("perfbound", "verify", "run.zip", "--key", "missing.pub").code == 1
    for wrong in (("--digests",), ("--sign", "a.key", "--safety-case", "case"), ("--bundle", "b.zip", "tests")):
        assert started.run("perfbound", "export", "run", *wrong).code == 2
