"""The HTML of report and live page: template, styles, scripts and data, under a policy that allows no other script.

The Content-Security-Policy (CSP Level 3) names the hash of each inline script and style, so text of a campaign that a
browser took for markup could still not run.
"""

import base64
import hashlib
import html
import re
from collections.abc import Mapping
from functools import cache
from importlib import resources
from typing import NamedTuple

ASSETS = resources.files(__package__) / "page"
PLOT = "vendor/uPlot.iife.min.js"
INDEX = "index/index.js"
GLOSSARY = "glossary.json"
"""Word or symbol -> meaning, also for `perfbound explain`; names of one entry are separated by commas."""
OF_INDEX = ("dom.js", "format.js", INDEX)
"""Scripts of the index of campaigns."""
_INLINE = re.compile(r"<(script|style)>(.*?)</\1>", re.DOTALL)
_PLACEHOLDER = re.compile(r"\{\{(STORY|TITLE|CSP)\}\}")
_STYLES_AND_SCRIPTS = re.compile(r"/\*(UPLOT_CSS|CSS|UPLOT|PAGE)\*/")


class Page(NamedTuple):
    """A page, and its Content-Security-Policy."""

    html: str
    policy: str


def standalone_page(title: str, data: str) -> Page:
    """Return a page that needs no server; `data` is JSON from `data.to_json`."""
    return _page(_template(), title, data, "")


def served_page(title: str, data: str, index: str = "") -> Page:
    """Return a page that requests updates from the server that it came from; with a way to an index of campaigns.

    `index` is the relative address of that index, made of dots and slashes alone; empty where there is none.
    """
    way = f'<nav class="up"><a href="{html.escape(index)}">\u2190 All campaigns</a></nav>' if index else ""
    template = _template().replace("<body>", f'<body data-live="events">{way}')
    return _page(template, title, data, "connect-src 'self'; ")


def index_page(title: str, data: str) -> Page:
    """Return the page of many campaigns; `data` is JSON from `IndexChanges.to_json`."""
    return _page(_index_template(), title, data, "connect-src 'self'; ")


def _page(template: str, title: str, data: str, directive: str) -> Page:
    hashes = {"script": "", "style": ""}
    for tag, text in _INLINE.findall(template):
        hashes[tag] += f" 'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"
    policy = (
        f"default-src 'none'; script-src{hashes['script']}; style-src{hashes['style']}; img-src data:; {directive}"
        "base-uri 'none'; form-action 'none'"
    )
    parts = {"STORY": data, "TITLE": html.escape(title), "CSP": html.escape(policy, quote=False)}
    # All in one pass: a name of the campaign that has the form of a placeholder stays a name.
    return Page(_PLACEHOLDER.sub(lambda found: parts[found[1]], template), policy)


@cache
def _template() -> str:
    """Return the template with its styles and scripts; the placeholders of data, title and policy remain."""
    of_report = [f"{folder}{each.name}" for folder in ("", "charts/") for each in (ASSETS / folder).iterdir()]
    # By their names alone, so that a move between folders changes no page.
    scripts = sorted((name for name in of_report if name.endswith(".js")), key=lambda name: name.rpartition("/")[2])
    parts = {
        "UPLOT_CSS": _asset("vendor/uPlot.min.css"),
        "CSS": _asset("page.css"),
        "UPLOT": _asset(PLOT),
        "PAGE": "\n".join([f"const GLOSSARY = {_asset(GLOSSARY)};", *map(_asset, scripts)]),
    }
    return _filled("page.html", parts)


@cache
def _index_template() -> str:
    """Return the template of the index as `_template` does."""
    return _filled(
        "index/index.html",
        {"CSS": _asset("page.css") + _asset("index/index.css"), "PAGE": "\n".join(map(_asset, OF_INDEX))},
    )


def _filled(name: str, parts: Mapping[str, str]) -> str:
    found = _STYLES_AND_SCRIPTS.sub(lambda found: parts[found[1]], _asset(name))
    assert sorted(_PLACEHOLDER.findall(found)) == ["CSP", "STORY", "TITLE"], "the template has each placeholder once"
    return found


def _asset(name: str) -> str:
    text = (ASSETS / name).read_text("utf-8")
    assert "</script" not in text or name.endswith(".html"), f"{name} would end its own element"
    return text
