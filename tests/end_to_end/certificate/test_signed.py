"""Signatures of real campaigns: made at the end of a run, of a resume, and afterwards."""

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from perfbound.orchestrator.certificate.signing import keys, sign
from perfbound.schemas.errors import SignatureError
from tests.campaigns import FOLDER, with_few_checks
from tests.end_to_end.processes import Processes, processes, recorded, wait_for, write_campaign


@pytest.fixture
def here(tmp_path: Path) -> Iterator[Processes]:
    """Return what starts processes, in a folder with the keys `a` and `b`."""
    with processes(tmp_path) as started:
        for name in "ab":
            assert started.run("perfbound", "keygen", name, "--out", ".").code == 0
        yield started


def signers(directory: Path, folder: Path) -> str:
    """Return whose signature is on exactly the certificate in `directory`."""
    envelope, found = (directory / "certificate.dsse.json").read_bytes(), ""
    for name in "ab":
        try:
            payload = sign.signed_payload(envelope, keys.load_public(folder / f"{name}.pub"))
        except SignatureError:
            continue
        assert payload == (directory / "certificate.json").read_bytes()
        found += name
    return found


@pytest.mark.journey
def test_a_run_signs_and_others_may_sign_after_it(here: Processes) -> None:
    campaign, directory = with_few_checks(here.folder / "c.toml", "test-function"), here.folder / "run"
    ended = here.run("perfbound", "run", campaign, "--out", directory, "--sign", "a.key")
    assert ended.code == 0, ended.err
    assert f"signed       {directory / 'certificate.dsse.json'}" in here.run("perfbound", "show", directory).out
    assert signers(directory, here.folder) == "a"
    alone = (directory / "certificate.dsse.json").read_bytes()
    assert here.run("perfbound", "resume", directory, "--sign", "a.key").code == 0
    assert (directory / "certificate.dsse.json").read_bytes() == alone
    assert here.run("perfbound", "sign", directory, "--key", "b.key").code == 0
    assert signers(directory, here.folder) == "ab"
    for name in "ab":
        verified = here.run("perfbound", "verify", directory, "--key", f"{name}.pub")
        assert verified.code == 0, verified.out


def test_an_interrupted_campaign_is_signed_at_its_end_alone(here: Processes) -> None:
    campaign, directory = write_campaign(here.folder / "c.toml"), here.folder / "run"
    process = here.start("perfbound", "run", campaign, "--out", directory, "--sign", "a.key")
    wait_for(lambda: recorded(directory) > 2)
    process.signal_group(signal.SIGINT)
    assert process.wait().code == 130
    assert not (directory / "certificate.dsse.json").exists()
    ended = here.run("perfbound", "resume", directory, "--sign", "b.key")
    assert ended.code == 0, ended.err
    assert signers(directory, here.folder) == "b"


def test_a_key_that_cannot_sign_starts_nothing(here: Processes) -> None:
    (here.folder / "a.key").chmod(0o644)
    ended = here.run("perfbound", "run", FOLDER / "test-function.toml", "--out", "run", "--sign", "a.key")
    assert ended.code == 1
    assert ended.fault.startswith("perfbound: a.key: others can read this file (mode 0644); run `chmod 600` on it")
    assert not (here.folder / "run").exists()
