"""The two systems of a comparison, and the campaigns that make their rollouts in pairs."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ....schemas.base import digest
from ....schemas.errors import CampaignError
from ....schemas.file.config import CampaignConfig
from ....schemas.file.reader import differences, load_campaign, validated
from ....schemas.file.space import Scenarios
from ....schemas.result.comparison import Common
from ....schemas.result.facts import Header
from ....schemas.system import SystemSpec
from ...mathematics.stl.parser import parse_formula
from ...mathematics.stl.tree import columns
from ...run.session import system_of
from ...store import read

QUESTION = ("horizon", "clip", "specification", "specifications", "beyond", "space", "where")
"""The keys in which two campaigns that are compared agree."""
OWN = ("system", "disturbances", "batch", "keep", "recheck", "second_opinion")
OF_MACHINES = ("max_attempts", "hung_after", "deadline", "platform")
KEPT = (*QUESTION, *OWN, *OF_MACHINES)
"""The keys of a campaign file that a comparison takes over."""
OF_REQUIREMENT = ("name", "formula", "id", "text", "link")
"""The keys of a requirement that are none of a bound."""
FIRST = 50
"""Pairs after which a comparison that may end early looks for the first time."""
RECHECK = 5
"""Rollouts that are simulated again before each look, where the file does not say how many."""
GROWTH = 2
"""Of their number from look to look."""


@dataclass(frozen=True, slots=True)
class Compared:
    """One system of a comparison, with the campaign of its rollouts."""

    given: Path
    config: CampaignConfig
    reference: str
    """The system as a worker finds it."""
    spec: SystemSpec
    listed: tuple[tuple[float, ...], ...]
    """The starts that the file lists; empty where they are drawn from ranges or a table."""

    @property
    def header(self) -> Header:
        """What the campaign will have in its header, but for its run id and its software."""
        return Header.new(self.config, self.spec, {}, run="0" * 16)


def compared(given: Path) -> Compared:
    """Read a campaign file, or the campaign of a run directory, with its system as it is now.

    Raises:
        PerfboundError: there is no campaign, or its system cannot be loaded.

    """
    if given.is_dir():
        header, reference = read.stored_header(given), read.system_reference(given)
        config = header.config
    else:
        config = load_campaign(given)
        reference = config.system.reference(given)
    listed = config.space.rows if isinstance(config.space, Scenarios) else ()
    found = Compared(given, config, reference, system_of(config, given, reference), listed)
    if given.is_dir() and found.header.spec.digest != header.spec.digest:
        raise CampaignError(
            f"{given}: its system has other sources now, and these would be simulated; check out the version into a "
            "folder of its own, as by `git worktree add`, and give the campaign file there"
        )
    return found


def paired(a: Compared, b: Compared, seed: int | None = None) -> tuple[Compared, Compared]:
    """Return both systems with the campaigns that draw the same starts for them, and the same seeds.

    What they draw follows from the question, both systems with their sources, and the seed: a changed system gets other
    draws, so that no version is fitted to those of the last comparison.

    Raises:
        CampaignError: the campaigns ask different questions, or the systems have different parameters.

    """
    seed = a.config.seed if seed is None else seed
    questions = [_campaign(each, {"seed": seed, "name": "pair"}) for each in (a, b)]
    unlike = [line for line in differences(*questions) if _is_of_question(line.partition(" ")[0])]
    if unlike:
        more = f"; and {len(unlike) - 3} more" if len(unlike) > 3 else ""
        raise CampaignError(
            f"{a.given} and {b.given}: ask different questions: {'; '.join(unlike[:3])}{more}, respectively; give both "
            "the same specification, starts and clip"
        )
    draws = digest({"campaigns": [each.digest for each in questions], "systems": [each.spec.digest for each in (a, b)]})
    keys = {"seed": seed, "draws": draws}
    first, second = (replace(each, config=_campaign(each, keys)) for each in (a, b))
    starts = [[(one.name, one.unit) for one in each.header.spec.parameters] for each in (first, second)]
    if starts[0] != starts[1]:
        words = [", ".join(f"{name} in {unit or '1'}" for name, unit in each) for each in starts]
        raise CampaignError(
            f"{a.given} and {b.given}: the parameters of a start are {words[0]}, and {words[1]}; give both systems the "
            "same ones in one order"
        )
    _check_columns(first, second)
    return first, second


def _is_of_question(key: str) -> bool:
    """Whether a key decides what is asked; the words of a requirement do not."""
    first, *others = key.split(".")
    return first in QUESTION and not (first == "specifications" and others[-1:] in (["id"], ["text"], ["link"]))


def _check_columns(a: Compared, b: Compared) -> None:
    """Refuse systems that do not both have the columns of the specification, in the same units."""
    units = [{each.name: each.unit for each in one.header.spec.columns} for one in (a, b)]
    for name in sorted(columns(parse_formula(a.config.formula or "0 >= 0"))):
        found = [each.get(name) for each in units]
        if None in found or found[0] != found[1]:
            words = ["no such column" if each is None else f"in {each or '1'}" for each in found]
            raise CampaignError(
                f"{a.given} and {b.given}: column {name} of the specification: {words[0]}, and {words[1]}; give both "
                "systems the same one"
            )


def in_common(a: Compared, b: Compared) -> tuple[Common, ...]:
    """Return what the two rollouts of a pair share."""
    one, other = a.header, b.header
    found: list[Common] = ["starts"]
    declared = bool(one.spec.disturbances), bool(other.spec.disturbances)
    # The seed of a rollout depends on its variant, unless disturbances are declared.
    alike = all(declared) or (not any(declared) and one.claimed_variant == other.claimed_variant)
    if alike and one.spec.seed_bits == other.spec.seed_bits:
        found.append("seeds")
        if one.spec.disturbances and one.spec.disturbances == other.spec.disturbances:
            found.append("disturbances")
    return tuple(found)


def looks(most: int, first: int) -> list[int]:
    """Return the numbers of pairs after which a comparison looks.

    >>> looks(500, 100), looks(50, 100)
    ([100, 200, 400, 500], [50])

    """
    found, pairs = list[int](), first
    while pairs < most:
        found.append(pairs)
        pairs *= GROWTH
    return [*found, most]


def _campaign(compared: Compared, keys: dict[str, Any]) -> CampaignConfig:
    given = compared.config.model_dump(mode="json", exclude_defaults=True)
    table = {key: given[key] for key in KEPT if given.get(key) is not None}
    if "specifications" in table:
        table["specifications"] = [
            {key: each[key] for key in OF_REQUIREMENT if key in each} for each in table["specifications"]
        ]
    if compared.listed:
        # Rows of a table are drawn: equally often on average, and with one law.
        table["space"] = {"table": table["space"]["scenarios"]}
    if "recheck" not in compared.config.model_fields_set:
        table["recheck"] = RECHECK
    table |= {"name": compared.config.name, "visual": "none", "anytime": True, **keys}
    return validated(table | {"problems": [{"name": "robustness", "method": "sample"}]}, table, str(compared.given))
