"""Files of the TLS options: each fault has one line, before anything is opened."""

import os
import re
import ssl
from collections.abc import Callable
from datetime import timedelta
from functools import partial
from pathlib import Path

import pytest
import trustme
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import BestAvailableEncryption, Encoding, PrivateFormat, PublicFormat
from hypothesis import given
from hypothesis import strategies as st

from perfbound.schemas.errors import LinkError
from perfbound.schemas.link.configuration import Tls
from perfbound.schemas.link.tls_files import check_host, check_link_files, check_role, common_name
from tests.facts import says
from tests.fakes.certificates import DAY, Site, now


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "site")


def check(tls: Tls, *, listens: bool = False, connects: bool = True) -> None:
    check_link_files(tls.ca, tls.certificate, tls.key, listens=listens, connects=connects)


def fault(call: Callable[[], object]) -> str:
    with pytest.raises(LinkError) as refused:
        call()
    assert "\n" not in str(refused.value)
    return str(refused.value)


def test_issued_certificates_are_accepted(site: Site) -> None:
    check(site.tls("node-1", "worker"))
    check(site.tls("main", "orchestrator", "10.0.0.1"), listens=True)
    check(site.tls("gate", "router", "gate.example"), listens=True)


def test_certificates_of_another_kind_of_authority_are_accepted(tmp_path: Path) -> None:
    """Also with an authority between, and without a usage: what Zenoh accepts is never refused."""
    root = trustme.CA()
    between = root.create_child_ca()
    leaf = between.issue_cert("127.0.0.1", common_name="w")
    root.cert_pem.write_to_path(tmp_path / "ca.pem")
    for number, pem in enumerate(leaf.cert_chain_pems):
        pem.write_to_path(tmp_path / "w.pem", append=number > 0)
    leaf.private_key_pem.write_to_path(tmp_path / "w-key.pem")
    (tmp_path / "w-key.pem").chmod(0o600)
    tls = Tls(ca=str(tmp_path / "ca.pem"), certificate=str(tmp_path / "w.pem"), key=str(tmp_path / "w-key.pem"))
    check(tls, listens=True)
    check_role(tls.certificate, "worker")
    leaf.cert_chain_pems[0].write_to_path(tmp_path / "w.pem")
    assert f"{tls.ca} is " in fault(lambda: check(tls))


def test_one_of_several_authorities_is_enough(site: Site, tmp_path: Path) -> None:
    tls = site.tls("node-1", "worker")
    both = tmp_path / "both.pem"
    both.write_bytes(Site(tmp_path / "other").ca.read_bytes() + site.ca.read_bytes())
    check(tls.model_copy(update={"ca": str(both)}))


def test_a_certificate_of_another_authority(site: Site, tmp_path: Path) -> None:
    tls, other = site.tls("node-1", "worker"), Site(tmp_path / "other")
    ca, own = (f"perfbound authority {'.' * 8}" for _ in range(2))
    found = fault(lambda: check(tls.model_copy(update={"ca": str(other.ca)})))
    assert re.match(
        f"{re.escape(tls.certificate)}: issued by '{ca}', and {other.ca} is '{own}', which has not signed it; ", found
    )


def test_an_authority_of_the_same_name_has_not_signed(site: Site, tmp_path: Path) -> None:
    """As of a fleet whose authority was made anew, by other means."""
    key = ec.generate_private_key(ec.SECP256R1())
    builder = x509.CertificateBuilder().subject_name(site.signer.certificate.subject)
    builder = builder.issuer_name(site.signer.certificate.subject).public_key(key.public_key()).serial_number(7)
    forged = builder.not_valid_before(now() - DAY).not_valid_after(now() + DAY).sign(key, hashes.SHA256())
    (tmp_path / "ca.pem").write_bytes(forged.public_bytes(Encoding.PEM))
    tls = site.tls("node-1", "worker").model_copy(update={"ca": str(tmp_path / "ca.pem")})
    assert "has not signed it" in fault(lambda: check(tls))


@pytest.mark.parametrize(
    ("at", "words"),
    [(-40 * DAY, "this certificate ended at "), (3 * DAY, "this certificate is valid from ")],
)
def test_a_certificate_that_is_not_valid_now(site: Site, at: timedelta, words: str) -> None:
    tls = site.tls("node-1", "worker", at=at)
    found = fault(lambda: check(tls))
    assert found.startswith(f"{tls.certificate}: {words}")
    assert f"the clock of this machine shows {now():%Y-%m-%d %H:}" in found
    assert "fix the clock" in found


def test_a_clock_may_be_an_hour_behind(site: Site) -> None:
    check(site.tls("node-1", "worker", at=timedelta(minutes=59)))


def test_a_key_of_another_certificate(site: Site) -> None:
    one, other = site.tls("node-1", "worker"), site.tls("node-2", "worker")
    found = fault(lambda: check(one.model_copy(update={"key": other.key})))
    assert says(found, f"^{other.key}: not key {one.certificate} TLS")


def test_a_key_with_a_password_is_not_asked_for(site: Site) -> None:
    tls = site.tls("node-1", "worker")
    locked = site.signer.key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, BestAvailableEncryption(b"x"))
    Path(tls.key).write_bytes(locked)
    assert says(fault(lambda: check(tls)), f"^{tls.key}: private encrypted password")


def test_the_certificate_of_a_worker_cannot_listen(site: Site) -> None:
    tls = site.tls("node-1", "worker")
    assert "no serverAuth in its extended key usage" in fault(lambda: check(tls, listens=True))


def test_a_certificate_that_cannot_connect(tmp_path: Path) -> None:
    site = Site(tmp_path)
    tls = site.tls("main", "orchestrator")
    old = x509.load_pem_x509_certificate(Path(tls.certificate).read_bytes())
    builder = x509.CertificateBuilder().subject_name(old.subject).issuer_name(old.issuer).public_key(old.public_key())
    builder = builder.serial_number(9).not_valid_before(now() - DAY).not_valid_after(now() + DAY)
    server = x509.ExtendedKeyUsage([x509.oid.ExtendedKeyUsageOID.SERVER_AUTH])
    made = builder.add_extension(server, critical=False).sign(site.signer.key, hashes.SHA256())
    Path(tls.certificate).write_bytes(made.public_bytes(Encoding.PEM))
    assert "no clientAuth in its extended key usage" in fault(lambda: check(tls))
    check(tls, listens=True, connects=False)


@pytest.mark.parametrize("file", ["ca", "certificate", "key"])
@pytest.mark.parametrize("content", [b"", b"garbage", b"\x00\xff" * 99, b"-----BEGIN CERTIFICATE-----\nAAAA\n-----END"])
def test_garbage_names_its_file(site: Site, file: str, content: bytes) -> None:
    tls = site.tls("node-1", "worker")
    path = Path(getattr(tls, file))
    path.write_bytes(content)
    assert fault(lambda: check(tls)).startswith(f"{path}: not the PEM file of a ")
    path.unlink()
    assert says(fault(lambda: check(tls)), f"^{path}: no file TLS PEM")
    os.mkfifo(path)  # which nobody waits for
    assert says(fault(lambda: check(tls)), f"^{path}: no file TLS PEM")


@given(
    st.sampled_from(["ca", "certificate", "key"]),
    st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(0, 255)), min_size=1, max_size=5),
)
def test_damaged_files_end_in_no_other_error(
    tmp_path_factory: pytest.TempPathFactory, file: str, damage: list[tuple[float, int]]
) -> None:
    tls = Site(tmp_path_factory.mktemp("site")).tls("node-1", "worker")
    path = Path(getattr(tls, file))
    content = bytearray(path.read_bytes())
    for place, value in damage:
        content[int(place * len(content))] = value
    path.write_bytes(content)
    reason = refusal(lambda: check(tls))
    assert reason is None or str(path) in reason


def test_a_certificate_with_a_damaged_key_is_refused(tmp_path: Path) -> None:
    tls = Site(tmp_path).tls("node-1", "worker")
    path = Path(tls.certificate)
    whole = x509.load_pem_x509_certificate(path.read_bytes())
    key = whole.public_key().public_bytes(Encoding.DER, PublicFormat.SubjectPublicKeyInfo)
    # Another last byte is a point that is not on the curve.
    damaged = whole.public_bytes(Encoding.DER).replace(key, key[:-1] + bytes([key[-1] ^ 1]))
    path.write_text(ssl.DER_cert_to_PEM_cert(damaged))
    reason = refusal(lambda: check(tls))
    assert reason is not None
    assert f"{path}: not the PEM file of a certificate" in reason


def refusal(call: Callable[[], None]) -> str | None:
    """Return the line of a known error; any other one fails the test."""
    try:
        call()
    except LinkError as error:
        return str(error)
    return None


@pytest.mark.parametrize(
    ("hosts", "host", "good"),
    [
        (["gate.example"], "gate.example", True),
        (["gate.example"], "GATE.example", True),
        (["gate.example"], "other.example", False),
        (["gate.example"], "10.0.0.1", False),
        (["10.0.0.1"], "10.0.0.1", True),
        (["gate.example", "fe80::1"], "fe80:0::1", True),
        (["10.0.0.1"], "0.0.0.0", True),
        (["10.0.0.1"], "::", True),
    ],
)
def test_the_host_of_a_side_that_listens(site: Site, hosts: list[str], host: str, good: bool) -> None:
    tls = site.tls("gate", "router", *hosts)
    if good:
        check_host(tls.certificate, host)
    else:
        found = fault(lambda: check_host(tls.certificate, host))
        assert says(found, f"^{tls.certificate}: {hosts[0]} not {host}")
        assert f"`--host {host}`" in found


def test_a_certificate_without_hosts_cannot_be_reached(site: Site) -> None:
    tls = site.tls("node-1", "worker")
    assert "names no host" in fault(lambda: check_host(tls.certificate, "0.0.0.0"))


def test_a_certificate_of_another_role(site: Site) -> None:
    tls = site.tls("node-1", "worker")
    check_role(tls.certificate, "worker")
    assert says(
        fault(lambda: check_role(tls.certificate, "orchestrator")),
        f"^{tls.certificate}: worker 'node-1' orchestrator `perfbound pki issue NAME --orchestrator`",
    )
    check_role(tls.certificate, "router", "worker")


def test_the_common_name_of_a_certificate(tmp_path: Path) -> None:
    authority, path = trustme.CA(), tmp_path / "c.pem"
    for name in ("worker-1", None):
        authority.issue_cert("127.0.0.1", common_name=name).cert_chain_pems[0].write_to_path(path)
        assert common_name(str(path)) == (name or "")
    path.write_text("no certificate")
    for wrong in (path, tmp_path):
        assert "not the PEM file of a certificate" in fault(partial(common_name, str(wrong)))
    assert "no such file" in fault(lambda: common_name(str(tmp_path / "missing")))
