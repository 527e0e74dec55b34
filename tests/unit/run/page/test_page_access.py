"""Who may read a live page: the place that is asked for, its token, its certificate."""

import os
import re
from contextlib import suppress
from pathlib import Path

import pytest
import trustme
from cryptography.hazmat.primitives import serialization
from hypothesis import given
from hypothesis import strategies as st

from perfbound.orchestrator.run.page.address import Address
from perfbound.orchestrator.run.page.page_access import OPEN, PageAccess, PagePlace, PageTls, opened
from perfbound.schemas.errors import PerfboundError
from tests.facts import facts
from tests.fakes.certificates import DAY, Site

EVERYWHERE = Address("0.0.0.0", 0)
TOKEN = "a-token.of_this~TEST"


@pytest.fixture(scope="module")
def tls(tmp_path_factory: pytest.TempPathFactory) -> PageTls:
    folder = tmp_path_factory.mktemp("tls")
    found = trustme.CA().issue_cert("localhost", "127.0.0.1")
    found.cert_chain_pems[0].write_to_path(folder / "page.pem")
    found.private_key_pem.write_to_path(folder / "page.key")
    (folder / "page.key").chmod(0o600)
    return PageTls(str(folder / "page.pem"), str(folder / "page.key"))


def access(place: PagePlace, *, insecure: bool = False) -> PageAccess:
    listening, _, found = opened(place, insecure=insecure)
    listening.close()
    return found


def test_loopback_asks_for_no_token_unless_that_is_wanted() -> None:
    assert access(PagePlace()) == OPEN
    found = access(PagePlace(with_token=True))
    assert re.fullmatch("[A-Za-z0-9_-]{43}", found.token or "")
    assert found.token != access(PagePlace(with_token=True)).token


def test_beyond_loopback_there_is_a_token_and_tls_or_the_word_insecure(tls: PageTls) -> None:
    with pytest.raises(PerfboundError, match=facts("--web-tls-certificate --web-tls-key --insecure")):
        opened(PagePlace(EVERYWHERE), insecure=False)
    with pytest.raises(PerfboundError, match="or add --insecure"):
        opened(PagePlace(EVERYWHERE, token=TOKEN), insecure=False)
    encrypted, unencrypted = access(PagePlace(EVERYWHERE, tls)), access(PagePlace(EVERYWHERE), insecure=True)
    assert (encrypted.scheme, unencrypted.scheme) == ("https", "http")
    assert len(encrypted.token or "") == len(unencrypted.token or "") == 43
    address = Address("0.0.0.0", 80)
    assert list(encrypted.lines("live page", address)) == [
        f"live page: https://{os.uname().nodename}:80/?token={encrypted.token}"
    ]
    assert list(unencrypted.lines("live page", address)) == [
        f"live page: http://{os.uname().nodename}:80/?token={unencrypted.token}",
        "the token of the live page travels unencrypted; --web-tls-certificate and --web-tls-key encrypt it",
    ]


def test_the_token_of_the_environment_is_used_everywhere_and_printed_nowhere(tls: PageTls) -> None:
    for place in (PagePlace(token=TOKEN), PagePlace(EVERYWHERE, tls, token=TOKEN)):
        found = access(place)
        assert found.token == TOKEN
        assert TOKEN not in "".join(found.lines("live page", Address()))
        assert TOKEN not in repr(found) + repr(place)


@pytest.mark.parametrize(
    "token", ["", "short", "a" * 201, "sixteen letters!", "sixteen=letters=", "ä" * 20, "a" * 20 + "\n"]
)
def test_a_token_that_cannot_be_sent_is_refused(token: str) -> None:
    with pytest.raises(PerfboundError, match=facts("PERFBOUND_WEB_TOKEN: token")) as caught:
        opened(PagePlace(token=token), insecure=True)
    assert token == "" or token not in str(caught.value)


def test_a_key_that_others_can_read_is_refused(tls: PageTls) -> None:
    Path(tls.key).chmod(0o644)
    try:
        with pytest.raises(PerfboundError, match=facts("--web-tls-key page.key: private")):
            opened(PagePlace(tls=tls), insecure=False)
    finally:
        Path(tls.key).chmod(0o600)


@pytest.mark.parametrize(("begins", "words"), [(-9, "this certificate ended at"), (9, "is valid from")])
def test_a_certificate_out_of_its_time_is_refused(tmp_path: Path, begins: int, words: str) -> None:
    """Browsers would not open the page, and only in their own words say why."""
    found = Site(tmp_path).tls("page", "router", "localhost", at=begins * DAY, days=3)
    with pytest.raises(PerfboundError, match=rf"page\.pem: .*{words}"):
        opened(PagePlace(tls=PageTls(found.certificate, found.key)), insecure=False)


def test_certificates_that_cannot_be_used_are_refused_before_anything_listens(tls: PageTls, tmp_path: Path) -> None:
    other = trustme.CA().issue_cert("localhost")
    other.private_key_pem.write_to_path(tmp_path / "other.key")
    key = serialization.load_pem_private_key(Path(tls.key).read_bytes(), None)
    pem, form = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8
    encrypted = key.private_bytes(pem, form, serialization.BestAvailableEncryption(b"secret"))
    (tmp_path / "encrypted.key").write_bytes(encrypted)
    (tmp_path / "empty.pem").touch()
    for pair, text in (
        ((str(tmp_path / "none.pem"), tls.key), r"--web-tls-certificate .*none\.pem: No such file"),
        ((tls.certificate, str(tmp_path)), r"--web-tls-key .*: Is a directory"),
        ((tls.certificate, str(tmp_path / "other.key")), "choose a pair that belongs together"),
        ((tls.certificate, str(tmp_path / "encrypted.key")), "unencrypted key in PEM"),
        ((str(tmp_path / "empty.pem"), tls.key), "unencrypted key in PEM"),
        ((tls.key, tls.certificate), "unencrypted key in PEM"),
    ):
        with pytest.raises(PerfboundError, match=text):
            opened(PagePlace(tls=PageTls(*pair)), insecure=False)


@given(
    st.builds(
        PageAccess,
        token=st.none() | st.text(),
        chosen=st.booleans(),
        tls=st.none() | st.builds(PageTls, certificate=st.text(), key=st.text()),
        beyond=st.booleans(),
    )
)
def test_the_process_of_the_page_gets_what_was_decided(given: PageAccess) -> None:
    with suppress(UnicodeEncodeError):  # lone surrogates are no text of a path or token
        assert PageAccess.from_json(given.to_json()) == given
