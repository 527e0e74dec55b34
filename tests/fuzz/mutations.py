"""Mutations of bytes and of JSON values: what a disk, a peer or a forger may make of a good input."""

import json
import random
import re
from typing import Any

NUMBER = re.compile(rb"-?\d+(\.\d+)?")
EXTREMES = (0, 1, 0x7F, 0x80, 0xFF)
NUMBERS = (b"0", b"-1", b"1e400", b"nan", b"inf", b"-0.0", b"1.7e308", b"5e-324", b"9" * 400, b"18446744073709551616")
VALUES: tuple[Any, ...] = (
    None,
    True,
    0,
    -1,
    2**63,
    2**70,
    1.7e308,
    5e-324,
    "",
    "x" * 10_000,
    "\x00\x1b[2J",
    [],
    {},
    [[]],
)


def mutated(luck: random.Random, data: bytes) -> bytes:
    """Return the data with one to four changes."""
    found = bytearray(data)
    for _ in range(luck.choice((1, 1, 1, 2, 4))):
        place = luck.randrange(len(found) + 1)
        size = luck.choice((1, 2, 8, 100, 5000))
        match luck.randrange(7):
            case 0:
                found[place : place + 1] = bytes([luck.choice(EXTREMES)])
            case 1 if place < len(found):
                found[place] ^= 1 << luck.randrange(8)
            case 2:
                del found[place : place + size]
            case 3:
                found[place:place] = luck.randbytes(size)
            case 4:  # a part once more, elsewhere
                start = luck.randrange(len(found) + 1)
                found[place:place] = found[start : start + size]
            case 5:
                del found[place:]
            case 6 if numbers := list(NUMBER.finditer(bytes(found[: 2**16]))):
                start, end = luck.choice(numbers).span()
                found[start:end] = luck.choice(NUMBERS)
    return bytes(found)


def flipped(luck: random.Random, data: bytes) -> bytes:
    """Return the data with up to four bytes of other values; the length stays, so that a structure is found."""
    found = bytearray(data)
    for _ in range(luck.choice((1, 1, 2, 4))):
        found[luck.randrange(len(found))] = luck.choice((*EXTREMES, luck.randrange(256)))
    return bytes(found)


def rewritten(luck: random.Random, text: bytes) -> bytes:
    """Return a JSON document with one value changed, left out or added."""
    document = json.loads(text)
    places = list(_places(document))
    parent, key = luck.choice(places)
    match luck.randrange(4):
        case 0:
            del parent[key]
        case 1 if isinstance(parent, dict):
            parent[luck.choice(("more", "", str(key) * 2))] = luck.choice(VALUES)
        case 2:
            other, name = luck.choice(places)
            parent[key] = json.loads(json.dumps(other[name]))
        case _:
            parent[key] = luck.choice(VALUES)
    return (json.dumps(document, sort_keys=True, indent=1) + "\n").encode()


def _places(value: Any) -> Any:
    keys = list(value) if isinstance(value, dict) else range(len(value)) if isinstance(value, list) else ()
    for key in keys:
        yield value, key
        yield from _places(value[key])
