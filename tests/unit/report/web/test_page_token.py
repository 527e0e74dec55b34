"""The token of a live page: without it no route answers but one, with it every route does."""

import asyncio
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl, urlencode, urljoin, urlsplit

import pytest
from hypothesis import given
from hypothesis import strategies as st
from starlette.routing import Route

from perfbound.orchestrator.report.collect.campaign import Collector
from perfbound.orchestrator.report.web import app
from perfbound.orchestrator.report.web.campaign_index import CampaignIndex
from perfbound.orchestrator.report.web.index_app import index_application
from perfbound.orchestrator.report.web.index_cache import IndexCache
from perfbound.orchestrator.report.web.open_campaigns import OpenCampaigns
from perfbound.orchestrator.report.web.page_token import MISSING, WRONG, equal, without_token
from perfbound.orchestrator.report.web.snapshots import SnapshotCache
from perfbound.orchestrator.run.page.address import Address
from perfbound.orchestrator.run.page.page_access import PageAccess, PageTls
from perfbound.schemas.file.reader import parse_campaign
from tests.campaigns import FOLDER, UNCHECKED
from tests.fakes.inmemory import campaign
from tests.unit.report.web.test_app import HOST, RECORDED, Answer, Client

TOKEN = "the-token-of-these-tests"
ADDRESS = Address("127.0.0.1", 8000)
WITH_TLS = PageAccess(TOKEN, tls=PageTls("page.pem", "page.key"))
BEARER = ("authorization", f"Bearer {TOKEN}")
NAMES = ("test-function", "maximum", "robustness")
"""Texts of the campaign, which no refusal has."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the run directory `run` of a finished campaign."""
    found = tmp_path_factory.mktemp("token")
    text = (FOLDER / "test-function.toml").read_bytes()
    campaign(found / "run", parse_campaign(text, "test", resolution=5, max_tests=3, **UNCHECKED))
    return found


def application(folder: Path, access: PageAccess) -> Any:
    return app.application(folder / "run", SnapshotCache(Collector(folder / "run"), pytest.fail), ADDRESS, access)


def index(folder: Path, access: PageAccess) -> Any:
    cache = IndexCache(CampaignIndex(folder, pytest.fail), pytest.fail)
    return index_application(cache, OpenCampaigns(pytest.fail), ADDRESS, access)


def ask(served: Any, path: str, *headers: tuple[str, str], **asked: Any) -> Answer:
    return asyncio.run(Client(served).ask(path, headers=(*HOST, *headers), **asked))


def paths(folder: Path) -> list[str]:
    """Return a path for every route of a page, from its routing table: a new one is tested, too."""
    directory = folder / "run"
    campaign_app = app.campaign_application(
        directory, SnapshotCache(Collector(directory), pytest.fail), app.ServerLimits()
    )
    routes = [each.path for each in campaign_app.routes if isinstance(each, Route)]
    assert len(routes) == len(campaign_app.routes) >= 10
    return [f"/{RECORDED}" if each.startswith("/trajectories/") else each for each in routes]


def queries(path: str) -> str:
    return "problem=maximum&test=0" if path.endswith("/scene") else ""


def refused(answer: Answer, status: int, sentence: str) -> None:
    assert (answer.status, answer.text) == (status, sentence)
    assert answer.headers["content-type"].startswith("text/plain")
    assert not any(name in answer.text + str(answer.headers) for name in NAMES)
    assert "set-cookie" not in answer.headers
    assert TOKEN not in str(answer.headers)


def test_without_the_token_every_route_but_one_refuses(folder: Path) -> None:
    served, many = application(folder, PageAccess(TOKEN)), index(folder, PageAccess(TOKEN))
    for page, path in [
        *((served, path) for path in paths(folder)),
        *((many, f"/runs/run{path}") for path in paths(folder)),
        *((many, path) for path in ("/", "/campaigns.json", "/metrics", "/healthz", "/readyz", "/runs/run")),
        (served, "/nowhere"),
        (served, "//healthz"),
        (served, "/healthz/"),
    ]:
        for method in ("GET", "HEAD", "POST", "OPTIONS"):
            answer = ask(page, path, query=queries(path), method=method)
            if path == "/healthz":
                assert (answer.status, answer.text) in ((200, "ok"), (200, "ok\n"), (405, "Method Not Allowed"))
            else:
                refused(answer, 401, MISSING)
                assert answer.headers["www-authenticate"] == "Bearer"


def test_with_the_token_every_route_answers(folder: Path) -> None:
    served = application(folder, PageAccess(TOKEN))
    for path in paths(folder):
        method = "HEAD" if path == "/events" else "GET"  # its stream would have no end
        assert ask(served, path, BEARER, query=queries(path), method=method).status == 200, path
    many = index(folder, PageAccess(TOKEN))
    assert ask(many, "/", BEARER).status == 200
    assert ask(many, "/runs/run/story.json", BEARER).status == 200
    assert b"perfbound_rollouts_total" in ask(many, "/runs/run/metrics", BEARER).body
    assert ask(many, "/metrics", BEARER).status == 404
    assert "/runs/FOLDER/metrics" in ask(many, "/metrics", BEARER).text


def test_a_browser_exchanges_the_token_for_a_cookie(folder: Path) -> None:
    for access, secure in ((PageAccess(TOKEN), False), (WITH_TLS, True)):
        served = application(folder, access)
        answer = ask(served, "/scene", query=f"problem=maximum&token={TOKEN}&test=0")
        assert (answer.status, answer.headers["location"]) == (303, "/scene?problem=maximum&test=0")
        cookie, *attributes = answer.headers["set-cookie"].split("; ")
        assert {each.lower() for each in attributes} == {"httponly", "samesite=strict", "path=/"} | (
            {"secure"} if secure else set()
        )
        assert cookie.startswith("perfbound-8000=")
        assert TOKEN not in cookie, "who reads the cookie has no token for programs"
        for path in paths(folder):
            method = "HEAD" if path == "/events" else "GET"
            assert ask(served, path, ("cookie", cookie), query=queries(path), method=method).status == 200, path
        refused(ask(application(folder, PageAccess("another-token-than-this")), "/", ("cookie", cookie)), 401, MISSING)
        refused(ask(served, "/", ("cookie", cookie[:-1])), 401, MISSING)
        refused(ask(served, "/", ("authorization", f"Bearer {cookie.partition('=')[2]}")), 403, WRONG)


@pytest.mark.parametrize(
    "given",
    [
        *(
            "",
            "Bearer",
            "Bearer ",
            f"Bearer {TOKEN[:-1]}",
            f"Bearer {TOKEN}x",
            f"Bearer {TOKEN.upper()}",
            f"Basic {TOKEN}",
        ),
        *(TOKEN, f"Bearer  {TOKEN}", "Bearer \xe4\xf6", f"Bearer {TOKEN}, Bearer x"),
    ],
)
def test_a_wrong_header_is_refused(folder: Path, given: str) -> None:
    scope_headers = (("host", "127.0.0.1:8000"), ("authorization", given))
    answer = asyncio.run(Client(application(folder, PageAccess(TOKEN))).ask("/metrics", headers=scope_headers))
    refused(answer, 403, WRONG)


def test_a_wrong_token_in_an_address_is_refused(folder: Path) -> None:
    served = application(folder, PageAccess(TOKEN))
    for query in ("token=", "token=wrong", f"token={TOKEN}x", "token=%ff%fe", f"token=wrong&token={TOKEN}x"):
        refused(ask(served, "/", query=query), 403, WRONG)


def test_the_host_is_checked_where_a_browser_could_be_misled_and_not_for_programs(folder: Path) -> None:
    """Prometheus reaches a page by whatever address the machine has, and no web site knows the token."""
    served = application(folder, PageAccess(TOKEN))

    def status(path: str, *headers: tuple[str, str], query: str = "") -> int:
        headers = (("host", "10.1.2.3:8000"), *headers)
        return asyncio.run(Client(served).ask(path, headers=headers, query=query)).status

    assert status("/metrics", BEARER) == 200
    assert status("/metrics", ("authorization", "Bearer wrong")) == 403
    assert status("/") == status("/", query=f"token={TOKEN}") == 400
    assert status("/healthz") == 200
    unguarded = app.application(folder / "run", SnapshotCache(Collector(folder / "run"), pytest.fail), ADDRESS)
    for path, answer in (("/healthz", 200), ("/readyz", 400), ("/metrics", 400)):
        assert asyncio.run(Client(unguarded).ask(path, headers=(("host", "10.1.2.3:8000"),))).status == answer


@given(
    st.text(st.characters(min_codepoint=33, max_codepoint=126, exclude_characters="?#")),
    st.lists(st.tuples(st.text(max_size=5), st.text(max_size=5))),
)
def test_the_exchange_leads_nowhere_else(path: str, pairs: list[tuple[str, str]]) -> None:
    query = urlencode([*pairs, ("token", TOKEN)], errors="replace")
    found = without_token(f"/{path}".encode(), query.encode())
    origin = "http://127.0.0.1:8000"
    assert found.startswith("/")
    assert not found.startswith(("//", "/\\"))
    assert urlsplit(urljoin(f"{origin}/", found)).netloc == "127.0.0.1:8000"
    assert TOKEN not in [value for name, value in parse_qsl(urlsplit(found).query) if name == "token"]


@given(st.text(), st.text())
def test_texts_are_equal_or_not(one: str, other: str) -> None:
    try:
        other.encode()
    except UnicodeEncodeError:
        return
    assert equal(one, other) == (one == other)
    assert equal(other, other)
