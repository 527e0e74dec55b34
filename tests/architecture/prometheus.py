"""Queries of Prometheus as far as the files of this project use them: their metrics, with the labels that are named."""

import re
from collections.abc import Iterator
from dataclasses import dataclass

FUNCTIONS = frozenset({"rate", "increase", "sum", "max", "max_over_time", "histogram_quantile", "time", "label_values"})
LISTS = frozenset({"by", "without", "on", "ignoring", "group_left", "group_right"})
"""Words before a list of labels."""
OPERATORS = frozenset({"and", "or", "unless", "bool"})
_TOKEN = re.compile(
    r"""\s*(?:(?P<text>"[^"\\]*")|(?P<range>\[[^\]]*\])|(?P<number>[0-9]+(?:\.[0-9]+)?)|(?P<name>[a-zA-Z_:$][\w:$]*)"""
    r"""|(?P<sign>=~|!~|!=|==|>=|<=|[-+*/<>={}(),]))"""
)
_RANGE = re.compile(r"\[(?:[0-9]+[smhd]|\$__rate_interval)\]")


@dataclass(frozen=True, slots=True)
class Query:
    """The names in a query."""

    metrics: dict[str, frozenset[str]]
    """Labels in the braces behind each metric."""
    listed: frozenset[str]
    """Labels in lists, such as `by (...)`."""


def parsed(query: str) -> Query:
    """Return the names in a query.

    >>> found = parsed('sum by (host) (rate(up{job="a"}[5m])) / 2')
    >>> found.metrics, found.listed
    ({'up': frozenset({'job'})}, frozenset({'host'}))

    Raises:
        ValueError: it is no query, or has a part that is not known here.

    """
    tokens = list(_tokens(query))
    metrics, listed, place = dict[str, frozenset[str]](), frozenset[str](), 0
    while place < len(tokens):
        kind, text = tokens[place]
        following = tokens[place + 1][1] if place + 1 < len(tokens) else ""
        place += 1
        if kind != "name" or text in OPERATORS:
            continue
        if text in LISTS:
            names, place = _names(tokens, place, "(", ")")
            listed |= names
        elif following in {"(", "by", "without"}:
            if text not in FUNCTIONS:
                raise ValueError(f"{query}: {text} is no function that is known here")
            if text == "label_values":  # of Grafana: a metric and the label whose values are wanted
                listed |= {tokens[-2][1]}
                del tokens[-3:-1]
        else:
            names, place = _matched(tokens, place) if following == "{" else (frozenset(), place)
            metrics[text] = metrics.get(text, frozenset()) | names
    if not metrics:
        raise ValueError(f"{query}: names no metric")
    return Query(metrics, listed)


def _tokens(query: str) -> Iterator[tuple[str, str]]:
    place, depth = 0, list[str]()
    while place < len(query.rstrip()):
        found = _TOKEN.match(query, place)
        if found is None or found.lastgroup is None:
            raise ValueError(f"{query}: not understood from {query[place:]!r}")
        text = found[found.lastgroup]
        if found.lastgroup == "range" and not _RANGE.fullmatch(text):
            raise ValueError(f"{query}: {text} is no time span")
        if text in ("(", "{"):
            depth.append(text)
        elif text in (")", "}") and (not depth or depth.pop() + text not in ("()", "{}")):
            raise ValueError(f"{query}: the brackets do not match")
        place = found.end()
        yield found.lastgroup, text
    if depth:
        raise ValueError(f"{query}: the brackets do not match")


def _names(tokens: list[tuple[str, str]], place: int, begin: str, end: str) -> tuple[frozenset[str], int]:
    """Return the names between two brackets, and the place behind them."""
    if tokens[place][1] != begin:
        raise ValueError(f"{begin} is missing before {tokens[place][1]}")
    last = place + [text for _, text in tokens[place:]].index(end)
    return frozenset(text for kind, text in tokens[place:last] if kind == "name"), last + 1


def _matched(tokens: list[tuple[str, str]], place: int) -> tuple[frozenset[str], int]:
    """Return the labels of matchers, `name operator "text"` each, and the place behind them."""
    names, last = _names(tokens, place, "{", "}")
    kinds = [kind if kind != "sign" else text for kind, text in tokens[place + 1 : last - 1]]
    groups = [kinds[at : at + 4] for at in range(0, len(kinds), 4)]
    for number, group in enumerate(groups):
        wanted = ["name", group[1] if len(group) > 1 else "", "text", *([","] if number < len(groups) - 1 else [])]
        if group != wanted or group[1] not in {"=", "!=", "=~", "!~"}:
            raise ValueError(f"matchers are not understood: {kinds}")
    return names, last
