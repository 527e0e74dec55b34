"""The page as one text: template, styles, scripts and story in it, and a policy under which nothing else may run."""

import base64
import hashlib
import html
import re
from functools import cache
from importlib.resources import files
from typing import NamedTuple

ASSETS = files("perfbound.orchestrator.report") / "page"
PLOT = "uPlot.iife.min.js"
_INLINE = re.compile(r"<(script|style)>(.*?)</\1>", re.DOTALL)
_PLACEHOLDER = re.compile(r"\{\{(STORY|TITLE|CSP)\}\}")
_STYLES_AND_SCRIPTS = re.compile(r"/\*(UPLOT_CSS|CSS|UPLOT|PAGE)\*/")


class Page(NamedTuple):
    """A page, and its Content-Security-Policy."""

    html: str
    policy: str


def report(title: str, story: str) -> Page:
    """Return a page that needs no server; `story` is JSON from `story.to_json`."""
    return _page(_template(), title, story, "")


def live(title: str, story: str) -> Page:
    """Return a page that asks the server from which it came for more."""
    return _page(_template().replace("<body>", '<body data-live="events">'), title, story, "connect-src 'self'; ")


def _page(template: str, title: str, story: str, more: str) -> Page:
    policy = _policy(template, more)
    parts = {"STORY": story, "TITLE": html.escape(title), "CSP": html.escape(policy, quote=False)}
    # All at once: a name that looks like a placeholder is a name.
    return Page(_PLACEHOLDER.sub(lambda found: parts[found[1]], template), policy)


def _policy(template: str, more: str) -> str:
    hashes = {kind: " ".join(_hash(text) for tag, text in _INLINE.findall(template) if tag == kind) for kind in _KINDS}
    return (
        f"default-src 'none'; script-src {hashes['script']}; style-src {hashes['style']}; img-src data:; {more}"
        "base-uri 'none'; form-action 'none'"
    )


_KINDS = ("script", "style")


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


@cache
def _template() -> str:
    """Return the template with its styles and scripts; story, title and policy are still to come."""
    scripts = sorted(each.name for each in ASSETS.iterdir() if each.name.endswith(".js") and each.name != PLOT)
    parts = {
        "UPLOT_CSS": _asset("uPlot.min.css"),
        "CSS": _asset("page.css"),
        "UPLOT": _asset(PLOT),
        "PAGE": "\n".join(_asset(name) for name in scripts),
    }
    found = _STYLES_AND_SCRIPTS.sub(lambda found: parts[found[1]], _asset("page.html"))
    assert sorted(_PLACEHOLDER.findall(found)) == ["CSP", "STORY", "TITLE"], "each stands in the template, and once"
    return found


def _asset(name: str) -> str:
    text = (ASSETS / name).read_text("utf-8")
    assert "</script" not in text or name == "page.html", f"{name} would end the element in which it stands"
    return text
