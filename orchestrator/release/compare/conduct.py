"""A comparison from its first pair to its document: both campaigns grow together, and what they show is judged."""

import hashlib
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.text import Text

from ....schemas.amounts import counted
from ....schemas.atomic import write_whole
from ....schemas.errors import PerfboundError
from ....schemas.result.certificate import Certificate
from ....schemas.result.comparison import ComparedQuantity, ComparedSystem, Comparison, Difference
from ...certificate import files
from ...mathematics.gp.kernels import Floats
from ...run.directory import check_vacant, stored_differently
from ...run.options import RunOptions
from ...run.session import resume_campaign, start_campaign
from ...store.export_tables import robustness_unit
from ...store.progress import read_progress
from ...store.read import stored_header, system_revision
from ...store.robustness import read_values
from ...store.rows import DATABASE
from .differences import Pairs, differences, overall, quantities
from .systems import FIRST, Compared, in_common, looks

COMPARISON, REPORT = "comparison.json", "comparison.html"
SIDES = ("a", "b")
"""The run directories of both systems in the folder of a comparison."""


@dataclass(frozen=True, slots=True)
class Terms:
    """What a comparison was asked for."""

    most_pairs: int
    delta: float
    equal: Mapping[ComparedQuantity, float]
    """Differences that do not matter."""
    until_decided: bool = False
    """Whether it ends as soon as no verdict is UNDECIDED."""


def compare_pairs(
    systems: Sequence[Compared], out: Path, terms: Terms, options: RunOptions, console: Console
) -> Comparison:
    """Simulate both systems in pairs until the terms are met, and write what follows; the same call continues.

    Raises:
        PerfboundError: another comparison is in `out`, or a campaign cannot be run.
        Stopped: a signal arrived.

    """
    check_equal(terms.equal, quantities(systems[0].config.clip, listed=bool(systems[0].listed)))
    first = min(FIRST, terms.most_pairs) if terms.until_decided else terms.most_pairs
    both = _begun(systems, out, first)
    for number in looks(terms.most_pairs, first):
        for directory, system in both.items():
            console.print(
                Text(f"{directory.name.upper()}, {system.given}: to {counted(number, 'rollout')}"), soft_wrap=True
            )
            _grow(directory, system, number, options, console)
            ended(directory, system)
        pairs, starts = recorded_pairs(both)
        found = comparison(both, differences(pairs, terms.delta, terms.equal), terms, pairs=len(pairs.a))
        if all(each.verdict != "UNDECIDED" for each in found.differences):
            break
    write(out, found)
    from .report import write_report  # noqa: PLC0415  (late: matplotlib takes a second to load)

    write_report(out / REPORT, both, pairs, starts, found)
    return found


def write(out: Path, found: Comparison) -> None:
    """Write the document of a comparison."""
    write_whole(out / COMPARISON, (found.model_dump_json(indent=2) + "\n").encode())


def _begun(systems: Sequence[Compared], out: Path, first: int) -> dict[Path, Compared]:
    """Return both systems by their run directories, with the number of tests with which these have begun."""
    begun = [out / side for side in SIDES if (out / side / DATABASE).exists()]
    # It decides seeds of fewer than 53 bits, so that both begin with the same one.
    tests = stored_header(begun[0]).config.max_tests if begun else first
    sized = [replace(each, config=each.config.model_copy(update={"max_tests": tests})) for each in systems]
    return in_folder(sized, out)


def in_folder(systems: Sequence[Compared], out: Path) -> dict[Path, Compared]:
    """Return both systems by their run directories in the folder of a comparison.

    Raises:
        PerfboundError: other campaigns are there.

    """
    if out.is_dir() and {each.name for each in out.iterdir()} - {*SIDES, COMPARISON, REPORT}:
        raise PerfboundError(f"{out}: exists and is not the folder of a comparison; choose another --out")
    found = dict(zip([out / side for side in SIDES], systems, strict=True))
    for directory, system in found.items():
        if not (directory / DATABASE).exists():
            check_vacant(directory, system.config)
            continue
        if unlike := stored_differently(directory, system.config):
            if unlike.startswith("draws is "):
                unlike = "a system, its sources, the order of A and B, or the seed is another one"
            raise PerfboundError(f"{out}: the comparison here differs from this one: {unlike}; choose another --out")
        _check_system(directory, system)
    return found


def check_equal(equal: Mapping[ComparedQuantity, float], compared: Sequence[ComparedQuantity]) -> None:
    """Refuse a difference that does not matter, of a quantity that is not compared.

    Raises:
        PerfboundError: there is one.

    """
    for quantity in equal:
        if quantity not in compared:
            raise PerfboundError(f"--equal: {quantity} is not compared here, but {', '.join(compared)}; leave it out")


def _check_system(directory: Path, system: Compared) -> None:
    if stored_header(directory).spec.digest != system.header.spec.digest:
        raise PerfboundError(
            f"{directory}: was simulated with other sources of the system than {system.given} has now; restore them, "
            "or compare anew with another --out"
        )


def ended(directory: Path, system: Compared) -> Certificate:
    """Return the certificate of one system, whose claim rests on no refuted assumption.

    Raises:
        PerfboundError: it does, or the system was changed meanwhile.

    """
    _check_system(directory, system)
    certificate = files.read(directory)
    assert certificate is not None, "the campaign has ended"
    if refuted := certificate.predicate.claims[0].refuted:
        raise PerfboundError(
            f"{directory}: the certificate refutes {', '.join(refuted)}, so that nothing can be compared; "
            f"`perfbound show {shlex.quote(str(directory))}` says why"
        )
    return certificate


def run_to_end(directory: Path, system: Compared, options: RunOptions, console: Console) -> None:
    """Run or resume the campaign of one system to its certificate; raises as `start_campaign`."""
    options = replace(options, system=system.reference)
    if not (directory / DATABASE).exists():
        start_campaign(system.config, system.given, directory, options, console)
    elif files.read(directory) is None:
        resume_campaign(directory, options, console)


def _grow(directory: Path, system: Compared, pairs: int, options: RunOptions, console: Console) -> None:
    """Bring the campaign of one system to so many tests at least."""
    run_to_end(directory, system, options, console)
    options = replace(options, system=system.reference)
    if read_progress(directory).problems[0].tests < pairs:
        resume_campaign(directory, options, console, pairs)


def comparison(
    both: Mapping[Path, Compared], found: Sequence[Difference], terms: Terms, *, pairs: int = 0
) -> Comparison:
    """Return the document of a comparison; one without pairs is of the worst case.

    Raises:
        OSError: the certificate of one cannot be read.

    """
    a, b = (_document(*each) for each in both.items())
    one, other = both.values()
    return Comparison(
        a=a,
        b=b,
        specification=one.config.formula or "",
        clip=one.config.clip,
        pairs=pairs,
        most_pairs=max(terms.most_pairs, pairs) if pairs else 0,
        common=in_common(one, other) if pairs else (),
        probability=1.0 - terms.delta,
        differences=tuple(found),
        verdict=overall([each.verdict for each in found]),
    )


def recorded_pairs(both: Mapping[Path, Compared]) -> tuple[Pairs, Floats]:
    """Return all pairs that are recorded, in their order, and their starts (n, p).

    Raises:
        PerfboundError: a database cannot be read, or the two have not drawn the same starts.

    """
    (a, starts), (b, others) = (_recorded(*each) for each in both.items())
    number = min(len(a), len(b))
    a, b, starts, others = a[:number], b[:number], starts[:number], others[:number]
    if not np.array_equal(starts, others):
        place = " and ".join(map(str, both))
        raise PerfboundError(f"{place}: not simulated from the same starts; choose another --out")
    one = next(iter(both.values()))
    header, numbers = one.header, {row: number for number, row in enumerate(one.listed)}
    found = Pairs(
        a,
        b,
        header.config.clip,
        robustness_unit(header.config, header.spec),
        start=[numbers[tuple(row)] for row in starts.tolist()] if numbers else None,
        listed=len(numbers),
        exact=not any(each.header.claimed_variant in each.spec.noisy for each in both.values()),
    )
    return found, starts


def _recorded(directory: Path, system: Compared) -> tuple[Floats, Floats]:
    """Return robustness (n,) and starts (n, p) of the tests of a campaign."""
    header = system.header
    problem = header.config.problems[0].name
    blocks = [each for each in read_values(directory, header.claimed_variant, [problem]) if each.series == problem]
    values = np.concatenate([np.array(each.robustness) for each in blocks])
    starts = np.concatenate([np.frombuffer(each.starts).reshape(each.tests, -1) for each in blocks])
    return values, starts


def _document(directory: Path, system: Compared) -> ComparedSystem:
    """Return what a comparison says of one system; raises OSError where its certificate cannot be read."""
    certificate = (directory / files.CERTIFICATE).read_bytes()
    return ComparedSystem(
        campaign=str(system.given),
        system=system.reference,
        options=system.config.system.options,
        revision=system_revision(directory),
        system_sha256=system.spec.digest,
        certificate_sha256=hashlib.sha256(certificate).hexdigest(),
    )
