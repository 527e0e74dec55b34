"""A bundle: it verifies without its run directory, and every tampering with it is found."""

import json
import shutil
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest

from perfbound.orchestrator.certificate import files
from perfbound.orchestrator.certificate.signing import keys, sign
from perfbound.orchestrator.certificate.verify.manifest import sha256_of
from perfbound.orchestrator.certificate.verify.run import Verification, verify_certificate
from perfbound.orchestrator.release.safety_case.bundle import (
    ENVELOPE,
    LIST,
    Content,
    is_bundle,
    verify_bundle,
    write_bundle,
)
from perfbound.orchestrator.release.safety_case.case import safety_case
from perfbound.orchestrator.release.safety_case.files import PDF, YAML
from perfbound.orchestrator.store.rows import DATABASE
from perfbound.schemas.errors import EvidenceError, PerfboundError
from tests.tampering import editing

SAMPLE = Path(__file__).parents[3] / "fixtures" / "finished" / "sample"
Entries = dict[str, bytes]
Change = Callable[[Entries], None]


def write(directory: Path, path: Path, key: Path | None = None, *, trajectories: bool = True) -> Path:
    """Write the bundle of a run directory, signed with the private key beside a public one."""
    found = verify_certificate(directory, key=None, again=0, report=lambda *_: None)
    assert found.certificate is not None
    lines = found.checks.lines()
    signers = [] if key is None else [key]
    case = safety_case(directory, signers, found.certificate, lines)
    private = None if key is None else keys.load_private(key.with_suffix(".key"))
    write_bundle(path, Content(directory, case, lines, signers, trajectories), private, lambda *_: None)
    return path


def verified(path: Path, key: Path | None = None) -> Verification:
    return verify_bundle(path, key=key, again=0, report=lambda *_: None, system=None)


def faults(path: Path, key: Path | None = None) -> dict[str, str]:
    return {each.name: each.detail for each in verified(path, key).checks.lines() if each.status == "failed"}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A signed run directory, its bundle with and without signature, and one without trajectories."""
    found = tmp_path_factory.mktemp("bundle")
    shutil.copytree(SAMPLE, found / "run")
    (found / "run" / "report.html").write_text("<p>report</p>")
    for name in ("alice", "mallory"):
        keys.new_pair(found, name)
    write(found / "run", found / "unsigned.zip")
    sign.sign_certificate(found / "run", keys.load_private(found / "alice.key"))
    write(found / "run", found / "signed.zip", found / "alice.pub")
    write(found / "run", found / "digests.zip", found / "alice.pub", trajectories=False)
    return found


def entries_of(path: Path) -> Entries:
    with zipfile.ZipFile(path) as bundle:
        return {each: bundle.read(each) for each in bundle.namelist()}


def changed(path: Path, to: Path, change: Change, *, listed: bool = False) -> Path:
    """Change the files of a bundle, and with `listed` their digests in its list as well."""
    entries = entries_of(path)
    before = dict(entries)
    change(entries)
    if listed:
        statement = json.loads(entries[LIST])
        there = {name: sha256_of(data) for name, data in entries.items() if name not in (LIST, ENVELOPE)}
        if entries[LIST] == before[LIST]:
            statement["subject"] = [{"name": name, "digest": {"sha256": each}} for name, each in sorted(there.items())]
        entries[LIST] = json.dumps(statement).encode()
    with zipfile.ZipFile(to, "w") as bundle:
        for name, data in entries.items():
            bundle.writestr(name, data)
    return to


def test_a_bundle_verifies_where_nothing_else_of_the_campaign_is(place: Path, tmp_path: Path) -> None:
    alone = tmp_path / "elsewhere.zip"
    shutil.copy(place / "signed.zip", alone)
    assert is_bundle(alone)
    assert not is_bundle(place / "run" / files.CERTIFICATE)
    found = verified(alone, place / "alice.pub")
    statuses = {each.name: each.status for each in found.checks.lines()}
    assert found.checks.good
    for name in ("signature", "files", "observations", "claims", "database", "bundle", "documents"):
        assert statuses[name] == "passed", name
    assert found.reissued is not None
    left = {each.name for each in (place / "run").iterdir()}
    assert not left & {f"{DATABASE}-wal", f"{DATABASE}-shm"}, "nothing is left beside the database"
    unsigned = verified(place / "unsigned.zip")
    assert unsigned.checks.good
    assert "give --key" in unsigned.checks.found["bundle"].detail


def test_without_trajectories_what_follows_from_them_is_skipped(place: Path) -> None:
    assert (place / "digests.zip").stat().st_size < (place / "signed.zip").stat().st_size
    found = verified(place / "digests.zip", place / "alice.pub")
    statuses = {each.name: each.status for each in found.checks.lines()}
    assert found.checks.good
    assert {name for name, status in statuses.items() if status == "passed"} == {
        "signature",
        "certificate",
        "header",
        "manifest",
        "bundle",
        "documents",
    }
    assert found.checks.found["files"].detail == "the trajectories are not here, only their digests"
    assert not any(name.endswith(".mcap") for name in entries_of(place / "digests.zip"))


def trajectory(entries: Entries) -> str:
    return next(name for name in entries if name.endswith(".mcap"))


def flipped(name: str, place: int = -10) -> Change:
    def change(entries: Entries) -> None:
        data = bytearray(entries[name if name != "mcap" else trajectory(entries)])
        data[place] ^= 1
        entries[name if name != "mcap" else trajectory(entries)] = bytes(data)

    return change


def replaced(name: str, old: str, new: str) -> Change:
    def change(entries: Entries) -> None:
        assert old.encode() in entries[name], name
        entries[name] = entries[name].replace(old.encode(), new.encode())

    return change


def without(name: str) -> Change:
    def change(entries: Entries) -> None:
        del entries[name if name != "mcap" else trajectory(entries)]

    return change


def added(name: str) -> Change:
    return lambda entries: entries.update({name: b"more"})


def better_bound(entries: Entries) -> None:
    certificate = json.loads(entries["run/certificate.json"])
    certificate["predicate"]["claims"][0]["bound"] /= 2
    entries["run/certificate.json"] = (json.dumps(certificate, sort_keys=True, indent=1) + "\n").encode()


def cut_database(entries: Entries) -> None:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / DATABASE).write_bytes(entries[f"run/{DATABASE}"])
        with editing(Path(folder)) as database:
            database.execute("DELETE FROM observations WHERE seq = (SELECT max(seq) FROM observations)")
        entries[f"run/{DATABASE}"] = (Path(folder) / DATABASE).read_bytes()


def claimed_checks(entries: Entries) -> None:
    statement = json.loads(entries[LIST])
    for each in statement["predicate"]["checks"]:
        if each[1] == "skipped":
            each[1] = "passed"
    entries[LIST] = json.dumps(statement).encode()


TAMPERINGS: list[tuple[str, Change, str]] = [
    # What is changed, and which check finds it where nothing is signed and the list is adapted to the change.
    ("a trajectory", flipped("mcap"), "files"),
    ("a trajectory is missing", without("mcap"), "files"),
    ("the manifest", flipped("run/manifest.sha256", 3), "manifest"),
    ("a better bound", better_bound, "claims"),
    ("bytes of the certificate", replaced("run/certificate.json", "\n", "\n "), "certificate"),
    ("the database", cut_database, "database"),
    ("the record of attempts", flipped("run/attempts.json", 90), "attempts"),
    ("the document", flipped(f"safety-case/{PDF}", 2000), "documents"),
    ("the argument", replaced(f"safety-case/{YAML}", "Argue over", "Prove all"), "documents"),
    ("the document is missing", without(f"safety-case/{PDF}"), "documents"),
    ("the certificate is missing", without("run/certificate.json"), "bundle"),
    ("a path outside", added("../../outside"), "bundle"),
    ("an absolute path", added("/outside"), "bundle"),
    ("a file elsewhere", added("other/file"), "bundle"),
    ("a file of the run that no run has", added("run/evil.py"), "bundle"),
    ("what its own verification skipped", claimed_checks, "documents"),
]


@pytest.mark.parametrize(("change", "check"), [each[1:] for each in TAMPERINGS], ids=[each[0] for each in TAMPERINGS])
def test_a_tampering_is_found(place: Path, tmp_path: Path, change: Change, check: str) -> None:
    # By one who adapts the list, of a bundle that nobody signed.
    found = faults(changed(place / "unsigned.zip", tmp_path / "a.zip", change, listed=True))
    assert check in found, found
    # Without the list, and of a signed bundle, whatever is adapted.
    assert faults(changed(place / "unsigned.zip", tmp_path / "b.zip", change))
    for listed in (False, True):
        signed = changed(place / "signed.zip", tmp_path / "c.zip", change, listed=listed)
        assert faults(signed, place / "alice.pub").keys() & {"bundle", "documents"}


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (flipped("run/report.html", 3), "bundle.json is not the signed list"),
        (without(ENVELOPE), "its list is not signed; who signs exports it with --sign KEY"),
        (flipped(ENVELOPE, 400), "signature|base64|envelope"),
        (without(LIST), "it has no bundle.json"),
        (replaced(LIST, "urn:perfbound:bundle:v1", "urn:perfbound:bundle:v2"), "bundle.json is not the signed list"),
    ],
)
def test_a_signature_covers_the_report_and_the_list(place: Path, tmp_path: Path, change: Change, text: str) -> None:
    import re

    path = changed(place / "signed.zip", tmp_path / "a.zip", change, listed="report" in text or "is not the" in text)
    found = faults(path, place / "alice.pub")
    assert re.search(text, found["bundle"]), found


def test_a_bundle_by_another_key_is_refused(place: Path) -> None:
    found = faults(place / "signed.zip", place / "mallory.pub")
    assert "no signature by key" in found["bundle"]
    assert "its list is not signed" in faults(place / "unsigned.zip", place / "alice.pub")["bundle"]


def test_a_file_that_is_there_twice_a_cut_one_and_no_zip_file_are_refused(place: Path, tmp_path: Path) -> None:
    twice = tmp_path / "twice.zip"
    shutil.copy(place / "unsigned.zip", twice)
    with pytest.warns(UserWarning, match="Duplicate name"), zipfile.ZipFile(twice, "a") as bundle:
        bundle.writestr("run/report.html", "another")
    assert faults(twice)["bundle"] == "a file is there twice"
    data = (place / "unsigned.zip").read_bytes()
    cut = tmp_path / "cut.zip"
    cut.write_bytes(data[: len(data) // 2] + data[len(data) // 2 + 100 :])
    assert is_bundle(cut)
    assert faults(cut)
    (tmp_path / "none.zip").write_bytes(data[:1000])
    with pytest.raises(EvidenceError, match=r"none\.zip: no zip file, or one that was cut off"):
        is_bundle(tmp_path / "none.zip")
    empty = tmp_path / "empty.zip"
    with zipfile.ZipFile(empty, "w"):
        pass
    assert "no bundle of perfbound" in faults(empty)["bundle"]


@pytest.mark.parametrize(
    "statement",
    [b"", b"[]", b"{}", b'{"_type": 1}', b"\xff", b"[" * 100_000, b'{"_type": "https://in-toto.io/Statement/v1"}'],
)
def test_a_list_that_is_none_is_one_failed_check(place: Path, tmp_path: Path, statement: bytes) -> None:
    path = changed(place / "unsigned.zip", tmp_path / "a.zip", lambda entries: entries.update({LIST: statement}))
    found = faults(path)
    assert list(found) == ["bundle"]
    assert "\n" not in found["bundle"]


def test_a_file_that_is_longer_than_it_says_is_not_unpacked_further(place: Path, tmp_path: Path) -> None:
    path = tmp_path / "bomb.zip"
    entries = entries_of(place / "unsigned.zip")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as bundle:
        for name, data in entries.items():
            bundle.writestr(name, data if name != "run/report.html" else b"\0" * 50_000_000)
    assert "run/report.html has another digest" in faults(path)["bundle"]


def test_documents_of_another_version_are_skipped_and_say_so(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:

    monkeypatch.setattr(mpl, "__version__", "0.0.1")
    found = verified(place / "unsigned.zip")
    assert found.checks.good
    check: Any = found.checks.found["documents"]
    assert check.status == "skipped"
    assert "here are other versions" in check.detail


def test_a_bundle_is_not_written_among_the_evidence(place: Path) -> None:
    with pytest.raises(PerfboundError, match="trajectories is for evidence alone"):
        write(place / "run", place / "run" / "trajectories" / "a.zip")
    assert not (place / "run" / "trajectories" / "a.zip").exists()
