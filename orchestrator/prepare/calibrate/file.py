"""The campaign file that a calibration writes: the draft with its constants, or a campaign without a kernel."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from ....schemas.file.defaults import leaves_out_problems
from ....schemas.file.toml_text import toml_comment, toml_key, toml_value
from ..size import first_samples
from .constants import Constant

KEPT = (
    "seed",
    "horizon",
    "risk_weight",
    "clip",
    "specification",
    "where",
    "visual",
    "max_attempts",
    "hung_after",
    "deadline",
    "second_opinion",
    "platform",
    "recheck",
)
"""Keys of the draft that a campaign of drawn starts keeps."""
TABLES = ("system", "space", "problems")
Lines = Iterator[str]


def kernel_file(
    draft: Mapping[str, Any], constants: Sequence[Sequence[Constant]], clip: Constant | None, head: str
) -> str:
    """Return the draft with the constants of each problem, in its order; comments of the draft are not in it."""
    first = [] if clip is None else [clip]
    if leaves_out_problems(draft):
        first += constants[0]
    return "".join(f"{line}\n" for line in _kernel_lines(draft, constants, first, head))


def _kernel_lines(
    draft: Mapping[str, Any], constants: Sequence[Sequence[Constant]], first: Sequence[Constant], head: str
) -> Lines:
    yield from toml_comment(head)
    yield ""
    yield from _keys((key, value) for key, value in draft.items() if key not in TABLES and not _replaced(key, first))
    yield from _constant_lines(first)
    yield from _system_and_space(draft)
    if leaves_out_problems(draft):
        return
    for problem, found in zip(draft["problems"], constants, strict=True):
        yield ""
        yield "[[problems]]"
        yield from _keys((key, value) for key, value in problem.items() if not _replaced(key, found))
        yield from _constant_lines(found)


def without_keys(draft: Mapping[str, Any], *keys: str) -> dict[str, Any]:
    """Return the table of a draft without some keys, of the campaign and of each problem."""
    found = {key: value for key, value in draft.items() if key not in keys}
    if not leaves_out_problems(draft):
        found["problems"] = [{key: each[key] for key in each if key not in keys} for each in draft["problems"]]
    return found


def sample_file(draft: Mapping[str, Any], clip: Sequence[float], cost: float, doubts: Sequence[str]) -> str:
    """Return a campaign of drawn starts for the specification of the draft."""
    return "".join(f"{line}\n" for line in _sample_lines(draft, clip, cost, doubts))


def _sample_lines(draft: Mapping[str, Any], clip: Sequence[float], cost: float, doubts: Sequence[str]) -> Lines:
    yield from toml_comment(
        "Written by `perfbound calibrate`: no kernel is trustworthy here, so starts are drawn, which needs none. "
        + " ".join(doubts)
    )
    yield ""
    yield from _keys((key, draft[key]) for key in KEPT if key in draft)
    if "clip" not in draft:
        yield "# Range to which the robustness is clipped; means are claimed of the clipped one."
        yield f"clip = {toml_value(list(clip))}"
    yield "# Number of samples, fixed beforehand; more of them give sharper claims."
    yield f"max_tests = {first_samples(cost).max_tests}"
    yield from toml_comment(
        "At most this share of the rollouts fails; all rollouts but 5 % have at least this robustness; all starts but "
        "a tenth have it as a mean."
    )
    yield "claims = ["
    for claim in (
        {"quantity": "failure_probability"},
        {"quantity": "quantile", "level": 0.05},
        {"quantity": "share_of_starts", "level": 0.1},
    ):
        yield f"    {toml_value(claim)},"
    yield "]"
    yield from _system_and_space(draft)


def _replaced(key: str, constants: Iterable[Constant]) -> bool:
    return any(each.key == key for each in constants)


def _keys(items: Iterable[tuple[str, Any]]) -> Lines:
    yield from (f"{toml_key(key)} = {toml_value(value)}" for key, value in items)


def _constant_lines(constants: Iterable[Constant]) -> Lines:
    for each in constants:
        yield from toml_comment(each.why)
        yield f"{each.key} = {toml_value(each.value)}"


def _system_and_space(draft: Mapping[str, Any]) -> Lines:
    """Yield system and space, a line for each of their keys."""
    for table in ("system", "space"):
        yield ""
        yield from (f"{table}.{toml_key(key)} = {toml_value(value)}" for key, value in draft[table].items())
