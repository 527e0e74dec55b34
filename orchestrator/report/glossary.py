"""The words of the field: one sentence each, for the page, the documents and `perfbound explain`."""

import json
from functools import cache

from ...schemas.errors import PerfboundError, meant
from .html import ASSETS, GLOSSARY


@cache
def glossary() -> dict[str, str]:
    """Return the meaning of every entry; the names of one entry are separated by commas."""
    entries: dict[str, str] = json.loads((ASSETS / GLOSSARY).read_text("utf-8"))
    return entries


def entries_of(word: str) -> list[str]:
    """Return the entries of which a word is a name or, where there is none, a part of a name, in any case.

    Raises `PerfboundError` where no entry has the word.
    """
    wanted = word.casefold()
    named = {entry: [name.strip().casefold() for name in entry.split(",")] for entry in glossary()}
    found = [entry for entry, names in named.items() if wanted in names]
    found = found or [entry for entry, names in named.items() if any(wanted in name.split() for name in names)]
    if not found:
        listed = ", ".join(entry.split(",")[0] for entry in named)
        near = meant(word, [name for names in named.values() for name in names])
        raise PerfboundError(f"{word}: not in the glossary; {near}choose one of {listed}")
    return found
