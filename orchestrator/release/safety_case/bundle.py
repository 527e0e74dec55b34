"""A bundle: one zip file with a certificate, its evidence and its safety case, which can be verified anywhere.

| file                | content                                                                                   |
|---------------------|-------------------------------------------------------------------------------------------|
| `bundle.json`       | an in-toto statement whose subjects are all other files, by their SHA-256                 |
| `bundle.dsse.json`  | the same, signed; only of a signed bundle                                                 |
| `run/`              | the run directory: certificate, signature, manifest, database, report, trajectories       |
| `safety-case/`      | the safety case as PDF, SVG and YAML                                                      |
| `signers/`          | the public keys whose signatures the safety case names; nobody need trust them            |
"""

import hashlib
import io
import json
import shutil
import sqlite3
import tempfile
import zipfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path, PurePosixPath
from typing import IO, Any, get_args

import matplotlib as mpl
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from ....schemas import __version__
from ....schemas.amounts import counted
from ....schemas.errors import EvidenceError, one_line
from ....schemas.result.certificate import STATEMENT_TYPE
from ...certificate import files
from ...certificate.signing.keys import load_public
from ...certificate.signing.sign import MAX_ENVELOPE, sign, signed_payload
from ...certificate.verify.checks import CHECKS, Check, CheckFailed, Checks, Status
from ...certificate.verify.manifest import parse_manifest, split_manifest
from ...certificate.verify.run import Verification, verify_certificate
from ...certificate.verify.stages import Report
from ...store.export import whole
from ...store.files import DISCARDED, FOLDER, contents
from ...store.readonly import snapshot
from ...store.rows import DATABASE
from .case import SafetyCase, safety_case
from .files import case_files

LIST, ENVELOPE = "bundle.json", "bundle.dsse.json"
RUN, CASE, SIGNERS = "run", "safety-case", "signers"
PREDICATE_TYPE = "urn:perfbound:bundle:v1"
OF_RUN = (
    files.CERTIFICATE,
    files.ENVELOPE,
    files.MANIFEST,
    files.REGIONS,
    files.ATTEMPTS,
    files.ATTEMPTS_ENVELOPE,
    "report.html",
)
MAX_LIST = 2**28
"""Bytes; a trajectory takes 150 of a list."""
CHUNK = 2**20


@dataclass(frozen=True, slots=True)
class Content:
    """What a bundle is made of."""

    directory: Path
    """The run directory."""
    case: SafetyCase
    lines: Sequence[Check]
    """Of its verification."""
    signers: Sequence[Path] = ()
    """Public keys."""
    trajectories: bool = True
    """Whether they are in it."""


def write_bundle(path: Path, content: Content, key: Ed25519PrivateKey | None, report: Report) -> int:
    """Write a bundle, with a key signed; return its number of files.

    Raises:
        EvidenceError: a file cannot be read.
        PerfboundError: it cannot be written.

    """
    sources, listed = _sources(content), dict[str, str]()
    with whole(content.directory, [path]) as (out,), zipfile.ZipFile(out, "w", allowZip64=True) as bundle:
        for number, (name, opened) in enumerate(sources, 1):
            with opened() as file:
                listed[name] = _added(bundle, name, file)
            report("bundle", number, len(sources))
        statement = _statement(content, listed)
        _added(bundle, LIST, io.BytesIO(statement))
        if key is not None:
            _added(bundle, ENVELOPE, io.BytesIO(sign(statement, key)))
    return len(listed)


def _sources(content: Content) -> list[tuple[str, Callable[[], AbstractContextManager[IO[bytes]]]]]:
    """Return the names of the files of a bundle, each with what opens its content."""
    directory = content.directory
    names = [name for name in OF_RUN if (directory / name).is_file()]
    names += _trajectories(directory) if content.trajectories else []
    paths = {f"{RUN}/{name}": directory / name for name in names}
    paths |= {f"{SIGNERS}/{number}.pub": signer for number, signer in enumerate(content.signers, 1)}
    return [
        *((name, partial(_opened, path)) for name, path in paths.items()),
        (f"{RUN}/{DATABASE}", partial(_database, directory)),
        *((f"{CASE}/{name}", partial(io.BytesIO, data)) for name, data in case_files(content.case).items()),
    ]


def _opened(path: Path) -> IO[bytes]:
    return path.open("rb")


def _statement(content: Content, listed: Mapping[str, str]) -> bytes:
    statement = {
        "_type": STATEMENT_TYPE,
        "subject": [{"name": name, "digest": {"sha256": digest}} for name, digest in sorted(listed.items())],
        "predicateType": PREDICATE_TYPE,
        "predicate": {
            "campaign": content.case.campaign,
            "certificate_sha256": content.case.certificate_sha256,
            "trajectories": content.trajectories,
            "software": {"perfbound": __version__, "matplotlib": mpl.__version__},
            "checks": [[each.name, each.status, each.detail] for each in content.lines],
        },
    }
    return (json.dumps(statement, indent=1) + "\n").encode()


def _added(bundle: zipfile.ZipFile, name: str, file: IO[bytes]) -> str:
    """Add a file; return its digest."""
    # Trajectories are compressed already. No date: it would say nothing.
    info = zipfile.ZipInfo(name)
    info.compress_type = zipfile.ZIP_STORED if name.endswith(".mcap") else zipfile.ZIP_DEFLATED
    info.external_attr = 0o644 << 16
    digest = hashlib.sha256()
    with bundle.open(info, "w", force_zip64=True) as entry:
        while chunk := file.read(CHUNK):
            digest.update(chunk)
            entry.write(chunk)
    return digest.hexdigest()


@contextmanager
def _database(directory: Path) -> Iterator[IO[bytes]]:
    """Open a copy of the database at one moment, without the files that SQLite keeps beside one."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / DATABASE
        with snapshot(directory) as one, closing(sqlite3.connect(copy)) as other:
            one.backup(other)
            other.execute("PRAGMA journal_mode=DELETE")
        with copy.open("rb") as file:
            yield file


def _trajectories(directory: Path) -> list[str]:
    text = contents(directory / files.MANIFEST, files.MAX_MANIFEST).decode()
    observed, kept = split_manifest(text)
    return [*(each.path for each in parse_manifest(observed).values()), *(each.path for _, each in kept)]


# Verification


def is_bundle(path: Path) -> bool:
    """Whether a path is a zip file.

    Raises:
        EvidenceError: by its name it is one, and its content is another.

    """
    found = path.is_file() and zipfile.is_zipfile(path)
    if path.suffix == ".zip" and not found:
        raise EvidenceError(f"{path}: no zip file, or one that was cut off; get the bundle again")
    return found


def verify_bundle(path: Path, *, key: Path | None, again: int, report: Report, system: str | None) -> Verification:
    """Verify a bundle: its list, the certificate and its evidence, and the safety case; as `verify_certificate`.

    Raises:
        PerfboundError: the key cannot be read, or there is no space to unpack it.
        Stopped: a signal arrived.

    """
    checks = Checks()
    with tempfile.TemporaryDirectory(prefix="perfbound-bundle-") as folder:
        place = Path(folder)
        try:
            with checks.making("bundle"):
                predicate = _unpacked(path, place, key, checks, report)
        except CheckFailed as failed:
            checks.failed(failed.name, str(failed))
            return Verification(checks, None, None)
        whole_run = predicate.get("trajectories") is True
        found = verify_certificate(
            place / RUN,
            key=key,
            again=again if whole_run else 0,
            report=report,
            system=system,
            trajectories=whole_run,
        )
        found.checks.found.update(checks.found)
        if found.checks.good:
            try:
                with found.checks.making("documents"):
                    _documents(place, found, predicate)
            except CheckFailed as failed:
                found.checks.failed(failed.name, str(failed))
    return found


def _unpacked(path: Path, place: Path, key: Path | None, checks: Checks, report: Report) -> dict[str, Any]:
    """Unpack a bundle into an empty folder, as far as it is what its list says; return what its list says of it."""
    with zipfile.ZipFile(path) as bundle:
        entries = bundle.infolist()
        names = [each.filename for each in entries]
        if len(set(names)) < len(names):
            raise CheckFailed("bundle", "a file is there twice")
        if LIST not in names:
            raise CheckFailed("bundle", f"it has no {LIST}: it is no bundle of perfbound")
        statement = _read(bundle, LIST, MAX_LIST)
        if key is not None:
            _check_signature(bundle, names, statement, key)
        listed, predicate = _parsed(statement)
        if f"{RUN}/{files.CERTIFICATE}" not in listed:
            raise CheckFailed("bundle", "it has no certificate")
        others = [name for name in names if name not in (LIST, ENVELOPE)]
        if missing := sorted(listed.keys() - set(others)):
            raise CheckFailed("bundle", f"{one_line(missing[0])} is missing ({len(missing):,} in all)")
        if more := sorted(set(others) - listed.keys()):
            raise CheckFailed("bundle", f"{one_line(more[0])} is not in its list ({len(more):,} in all)")
        size, free = sum(each.file_size for each in entries), shutil.disk_usage(place).free
        if size > free:
            raise CheckFailed("bundle", f"its files take {size:,} bytes, and {free:,} are free in {place.parent}")
        for number, each in enumerate((each for each in entries if each.filename in listed), 1):
            _unpack(bundle, each, place, listed[each.filename])
            report("bundle", number, len(listed))
    words = "its list is signed" if key is not None else "its list is not checked against a signature: give --key"
    checks.passed("bundle", f"{counted(len(listed), 'file')}; {words}")
    return predicate


def _check_signature(bundle: zipfile.ZipFile, names: Sequence[str], statement: bytes, key: Path) -> None:
    public = load_public(key)
    if ENVELOPE not in names:
        raise CheckFailed("bundle", "its list is not signed; who signs exports it with --sign KEY")
    if signed_payload(_read(bundle, ENVELOPE, MAX_ENVELOPE), public) != statement:
        raise CheckFailed("bundle", f"{LIST} is not the signed list")


def _read(bundle: zipfile.ZipFile, name: str, most: int) -> bytes:
    with bundle.open(name) as file:
        data = file.read(most + 1)
    if len(data) > most:
        raise CheckFailed("bundle", f"{name} has more than {most:,} bytes")
    return data


def _parsed(statement: bytes) -> tuple[dict[str, str], dict[str, Any]]:
    """Return the digests of the files by their names, and the predicate."""
    found = json.loads(statement)
    if found["_type"] != STATEMENT_TYPE or found["predicateType"] != PREDICATE_TYPE:
        raise CheckFailed("bundle", f"{LIST} is no list of a bundle")
    listed = {str(each["name"]): str(each["digest"]["sha256"]) for each in found["subject"]}
    for name in listed:
        parts = PurePosixPath(name).parts
        # Nothing is written outside of the folder, whatever the names are.
        of_run = parts[:1] == (RUN,) and parts[1:2] in [(each,) for each in (*OF_RUN, DATABASE, FOLDER, DISCARDED)]
        plain = name == "/".join(parts) and ".." not in parts and "\\" not in name
        if not (plain and (of_run or parts[:1] in ((CASE,), (SIGNERS,)))):
            raise CheckFailed("bundle", f"{one_line(name)!r} is no path of a bundle")
    predicate: dict[str, Any] = dict(found["predicate"])
    return listed, predicate


def _unpack(bundle: zipfile.ZipFile, entry: zipfile.ZipInfo, place: Path, digest: str) -> None:
    target, found, size = place / entry.filename, hashlib.sha256(), 0
    target.parent.mkdir(parents=True, exist_ok=True)
    with bundle.open(entry) as file, target.open("xb") as out:
        while chunk := file.read(CHUNK):
            size += len(chunk)
            if size > entry.file_size:
                raise CheckFailed("bundle", f"{one_line(entry.filename)} is longer than it says")
            found.update(chunk)
            out.write(chunk)
    if found.hexdigest() != digest:
        raise CheckFailed("bundle", f"{one_line(entry.filename)} has another digest than in the list: it was changed")


def _documents(place: Path, found: Verification, predicate: Mapping[str, Any]) -> None:
    """Compare the safety case with the one that follows from the certificate."""
    made = dict(predicate.get("software", {}))
    here = {"perfbound": __version__, "matplotlib": mpl.__version__}
    if made != here:
        theirs = ", ".join(f"{one_line(str(name))} {one_line(str(version))}" for name, version in made.items())
        found.checks.skipped("documents", f"it was made by {theirs[:200]}, and here are other versions")
        return
    assert found.certificate is not None, "its check passed"
    # That verification was made by who exported it; this one is the table above.
    lines = [Check(str(name), status, str(detail)) for name, status, detail in predicate["checks"]]
    if {each.name for each in lines} - CHECKS.keys() or any(each.status not in get_args(Status) for each in lines):
        raise CheckFailed("documents", "its list names checks that do not exist")
    case = safety_case(place / RUN, sorted((place / SIGNERS).glob("*.pub")), found.certificate, lines)
    for name, data in case_files(case).items():
        path = place / CASE / name
        if not path.is_file():
            raise CheckFailed("documents", f"{name} is missing")
        if path.read_bytes() != data:
            raise CheckFailed("documents", f"{name} is not the one that follows from the certificate")
    found.checks.passed("documents", f"{case.verdict}; the report is the one of the list, and was not made again")
