"""Refusals of certificates and of an authority, and what is wrong in a system or a script of a user."""

from functools import partial
from pathlib import Path

import pytest
from click.testing import CliRunner
from cryptography.hazmat.primitives.serialization import BestAvailableEncryption, Encoding, PrivateFormat

import perfbound as pb
from perfbound.orchestrator.cli.group import cli
from perfbound.orchestrator.mathematics.stl.horizon import check_horizon
from perfbound.orchestrator.mathematics.stl.parser import parse_formula
from perfbound.schemas.link.tls_files import check_host, check_role
from tests.fakes.certificates import Site
from tests.texts import Cases, refusal, rows
from tests.unit.hosts import test_pki
from tests.unit.library import test_campaign, test_search
from tests.unit.mathematics.stl import test_horizon, test_text
from tests.unit.schemas.link import test_tls_files
from tests.unit.workers.systems import test_function


def tls(folder: Path) -> Cases:
    """Yield refusals of the files of the TLS options."""
    site, check = Site(folder / "site"), test_tls_files.check
    one, other = site.tls("node-1", "worker"), site.tls("node-2", "worker")
    yield "the key of another certificate", refusal(partial(check, one.model_copy(update={"key": other.key})))
    yield "a worker that listens", refusal(partial(check, one, listens=True))
    yield "another role", refusal(partial(check_role, one.certificate, "orchestrator"))
    yield "no host", refusal(partial(check_host, one.certificate, "0.0.0.0"))
    gate = site.tls("gate", "router", "gate.example")
    yield "another host", refusal(partial(check_host, gate.certificate, "other.example"))
    locked = site.signer.key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, BestAvailableEncryption(b"x"))
    Path(other.key).write_bytes(locked)
    yield "a key with a password", refusal(partial(check, other))
    for name in ("ca", "certificate", "key"):
        path = Path(getattr(one, name))
        content = path.read_bytes()
        path.write_bytes(b"garbage")
        yield f"garbage in place of the {name}", refusal(partial(check, one))
        path.unlink()
        yield f"no {name}", refusal(partial(check, one))
        path.write_bytes(content)
        path.chmod(0o600)


def pki(folder: Path) -> Cases:
    """Yield refusals of `perfbound pki`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_STATE_HOME", str(folder / "state"))
        yield "no authority", test_pki.refused("issue", "n", "--worker")
        test_pki.done("init")
        home = folder / "state" / "perfbound" / "pki"
        yield "an authority is there", test_pki.refused("init")
        (folder / "full").mkdir()
        (folder / "full" / "thesis.tex").touch()
        yield "a folder that is not empty", test_pki.refused("init", "--folder", folder / "full")
        yield "no folder", test_pki.refused("init", "--folder", folder / "full" / "thesis.tex" / "pki")
        test_pki.done("issue", "main", "--orchestrator", "--host", "10.0.0.1", "--out", folder / "main")
        test_pki.done("issue", "node-1", "--worker", "--out", folder / "node-1")
        yield "a name of another role", test_pki.refused("issue", "main", "--worker", "--out", folder / "n")
        yield "a name that is not apart", test_pki.refused("issue", "node-1-2", "--worker", "--out", folder / "n")
        yield "a certificate is there", test_pki.refused("issue", "node-1", "--worker", "--out", folder / "node-1")
        (home / "ca-key.pem").chmod(0o644)
        yield "a key that others can read", test_pki.refused("issue", "n", "--worker", "--out", folder / "n")
        (home / "ca-key.pem").chmod(0o600)
        home.chmod(0o777)
        yield "a folder that others can write", test_pki.refused("issue", "n", "--worker", "--out", folder / "n")
        home.chmod(0o700)
        (home / "issued" / "x.pem").touch()
        yield "a foreign file", test_pki.refused("list")


def command_line(folder: Path) -> Cases:
    """Yield what is said of words of the command line that are none."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for words in (
            "rnu",
            "status",
            "show no-such-run",
            "run no-such.toml",
            "simulate no.py:cars --x 1 --out o.mcap",
        ):
            found = CliRunner().invoke(cli, words.split())
            yield f"perfbound {words}", found.output or str(found.exception)


def formulas(_folder: Path) -> Cases:
    """Yield what is wrong in formulas."""
    for test in (
        test_text.TestParser.test_the_spelling_of_other_tools_is_answered_by_this_one,
        test_text.TestParser.test_errors_point_at_the_place,
    ):
        for text, *_ in rows(test):
            yield text, refusal(partial(parse_formula, text, test_text.NAMES))
    for text, _ in rows(test_horizon.TestHorizon.test_the_message):
        yield f"15 s: {text}", refusal(partial(check_horizon, parse_formula(text), 15.0))


def library(_folder: Path) -> Cases:
    """Yield refusals of classes of the library and of systems in Python."""
    for number, (model, limits, fields, _) in enumerate(
        rows(test_campaign.test_what_is_written_in_python_is_refused_in_one_line)
    ):
        yield f"a class {number}: {model.__name__}", refusal(partial(model, *limits, **fields))
    signatures = rows(test_function.test_a_signature_that_does_not_fit_is_refused)
    for number, (function, changes, _) in enumerate(signatures):
        yield f"a signature {number}", refusal(partial(test_function.made, function, **changes))
    for number, (keys, _) in enumerate(rows(test_search.test_a_search_that_is_none_is_refused)):
        yield f"a search {number}", refusal(partial(pb.Search, **keys))
    for number, (start, _) in enumerate(rows(test_search.test_a_known_start_that_is_none_is_refused)):
        yield f"a known start {number}", refusal(partial(pb.Search(test_search.SPACE).add, start, 1.0))
