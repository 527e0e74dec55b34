"""Certificates of a private authority: their extensions, their names, and that every worker's name can be allowed."""

import ipaddress
from datetime import timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID as Usage
from hypothesis import assume, given
from hypothesis import strategies as st

from perfbound.orchestrator.hosts import authority
from perfbound.orchestrator.hosts.authority import Order, check_apart, checked_order
from perfbound.schemas.errors import AuthorityError, LinkError
from perfbound.schemas.link import key_expressions
from perfbound.schemas.link.access import access_rules
from perfbound.schemas.link.tls_files import Role, role_of
from tests.facts import facts
from tests.fakes.certificates import now

TEXTS = st.text("abz019-._A/$* \n'\"", max_size=70) | st.from_regex(authority.HOST, fullmatch=True)
NOW = now()
"""One moment for all: between two readings of the clock a second may end."""


def issued(role: Role, *hosts: str, days: int = 30) -> x509.Certificate:
    signer = authority.new_authority(NOW, 365)
    return authority.issue_certificate(signer, checked_order("a-name", role, hosts), NOW, days)[0]


def test_the_authority_signs_certificates_and_no_authorities() -> None:
    certificate = authority.new_authority(NOW, 365).certificate
    basic = certificate.extensions.get_extension_for_class(x509.BasicConstraints)
    assert (basic.critical, basic.value) == (True, x509.BasicConstraints(ca=True, path_length=0))
    usage = certificate.extensions.get_extension_for_class(x509.KeyUsage)
    assert (usage.critical, usage.value.key_cert_sign, usage.value.crl_sign) == (True, True, True)
    assert not usage.value.digital_signature
    assert certificate.not_valid_after_utc == NOW + timedelta(days=365)
    certificate.verify_directly_issued_by(certificate)


@pytest.mark.parametrize(
    ("role", "uses", "hosts"),
    [
        ("worker", [Usage.CLIENT_AUTH], None),
        ("orchestrator", [Usage.CLIENT_AUTH, Usage.SERVER_AUTH], ["a-name"]),
        ("router", [Usage.CLIENT_AUTH, Usage.SERVER_AUTH], ["a-name"]),
    ],
)
def test_a_certificate_is_for_its_role(role: Role, uses: list[x509.ObjectIdentifier], hosts: list[str] | None) -> None:
    certificate = issued(role)
    found = certificate.extensions
    assert list(found.get_extension_for_class(x509.ExtendedKeyUsage).value) == uses
    assert found.get_extension_for_class(x509.BasicConstraints).value == x509.BasicConstraints(False, None)
    assert found.get_extension_for_class(x509.KeyUsage).value.digital_signature
    assert role_of(certificate) == role
    assert certificate.not_valid_after_utc - NOW == timedelta(days=30)
    if hosts is None:
        with pytest.raises(x509.ExtensionNotFound):
            found.get_extension_for_class(x509.SubjectAlternativeName)
    else:
        names = found.get_extension_for_class(x509.SubjectAlternativeName).value
        assert names.get_values_for_type(x509.DNSName) == hosts


def test_hosts_are_names_and_addresses() -> None:
    names = issued("router", "Gate.example", "10.0.0.1", "[fe80::1]", "10.0.0.1")
    found = names.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert found.get_values_for_type(x509.DNSName) == ["gate.example"]
    addresses = [ipaddress.ip_address(each) for each in ("10.0.0.1", "fe80::1")]
    assert found.get_values_for_type(x509.IPAddress) == addresses


def test_no_certificate_outlives_its_authority() -> None:
    signer = authority.new_authority(NOW, 10)
    with pytest.raises(AuthorityError, match=facts("--days 30: --days 10 less")):
        authority.issue_certificate(signer, Order("a", "worker"), NOW, 30)
    with pytest.raises(AuthorityError, match=facts("`perfbound pki init --folder`")):
        authority.issue_certificate(signer, Order("a", "worker"), NOW + timedelta(days=10), 1)


@given(TEXTS)
def test_every_name_of_a_worker_can_be_allowed(name: str) -> None:
    try:
        checked_order(name, "worker", [])
    except AuthorityError:
        return
    assert key_expressions.NAME.fullmatch(name)
    assert key_expressions.PROCESS.fullmatch(key_expressions.fresh_id(name))
    assert access_rules([name], "main")
    assert Path(name).name == name, "it names files"


@pytest.mark.rest
@given(st.lists(st.from_regex(r"\A[ab]-?[ab]?-?[ab]?\Z"), min_size=2, max_size=4, unique=True))
def test_names_that_were_issued_together_can_be_allowed_together(names: list[str]) -> None:
    orders: list[Order] = []
    for name in names:
        try:
            order = checked_order(name, "worker", [])
            check_apart(order, orders)
        except AuthorityError:
            assume(False)
        orders.append(order)
    assert access_rules(names, "main")


@given(st.lists(st.from_regex(r"\A[ab](-[ab]){0,2}\Z"), min_size=2, max_size=3, unique=True))
def test_names_that_are_not_apart_are_told_when_they_are_issued(names: list[str]) -> None:
    orders = [checked_order(name, "worker", []) for name in names]
    try:
        access_rules(names, "main")
        apart = True
    except LinkError:
        apart = False
    assert apart == all(is_apart(order, orders[:number]) for number, order in enumerate(orders))


def is_apart(order: Order, others: list[Order]) -> bool:
    try:
        check_apart(order, others)
    except AuthorityError:
        return False
    return True


def test_a_name_has_one_role() -> None:
    with pytest.raises(AuthorityError, match=facts("'main': orchestrator another")):
        check_apart(Order("main", "worker"), [Order("main", "orchestrator")])
    with pytest.raises(AuthorityError, match=facts("'main': orchestrator")):
        check_apart(Order("main", "worker"), [], [Order("main", "orchestrator")])
    check_apart(Order("main", "worker"), [Order("main", "worker"), Order("main-2", "orchestrator")])
    check_apart(Order("node-1", "worker"), [], [Order("node-1-2", "worker"), Order("node-1", "worker")])


@pytest.mark.parametrize("role", ["worker", "orchestrator", "router"])
@pytest.mark.parametrize(
    "name", ["", "-a", "a-", "A", "a_b", "a b", "a/b", "..", ".a", "a.", "a..b", "a\n", "x" * 65, "é", "$(id)", "local"]
)
def test_names_that_are_none(name: str, role: Role) -> None:
    with pytest.raises(AuthorityError) as refused:
        checked_order(name, role, [])
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("host", ["", "a b", "0.0.0.0", "::", "10.0.0", "10.0.0.1:7447", "tls/a", "fe80::1%eth0", "*"])
def test_hosts_that_are_none(host: str) -> None:
    with pytest.raises(AuthorityError, match="no name or address of a host"):
        checked_order("gate", "router", [host])


def test_a_worker_has_no_host() -> None:
    with pytest.raises(AuthorityError, match="leave --host out"):
        checked_order("a", "worker", ["a.example"])
