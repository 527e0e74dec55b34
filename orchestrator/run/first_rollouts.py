"""The first rollout of a new campaign, simulated before its run directory and its workers.

A fault of a user's own simulator is then one line at once, and not a worker's failed attempts. The rollout is no
evidence: nothing of it is kept, and a worker simulates it again.
"""

import hashlib
import math
import shlex
import tempfile
import time
from collections.abc import Callable, Sequence
from importlib.metadata import entry_points
from pathlib import Path

from ...schemas.batch import BatchRequest, alone
from ...schemas.errors import CampaignError, EvidenceError
from ...schemas.ids import RolloutId
from ...schemas.result.facts import Header
from ...schemas.rollout import RolloutRequest
from ..campaign.admission import admit_either
from ..campaign.plan import Plans, ProblemPlan, plans
from ..campaign.proposals import first_start
from ..campaign.seeds import rollout_seeds
from ..fleet.children.child import in_file
from ..fleet.children.rollouts import ChildRolloutError, ChildSystem, SlowRolloutError, file_of, simulate_in_child

PATIENCE = 10.0
"""Seconds after which the campaign begins without the end of such a rollout, whose deadline may be an hour."""
NOTICE = 4.0
"""Seconds after which a line says what the command waits for; on a busy machine the process starts in two."""
ATTEMPTS = 2
"""As in a campaign, where a rollout may fail once: a crash need not be a fault of the simulator."""
TOGETHER = 2
"""Rollouts of the batch of a vectorised system: with one, an axis that is missing or turned need not show."""
GROUP, OURS = "perfbound.systems", "perfbound"
"""Entry points of installed systems, and the distribution whose systems are tested where it is."""


class _UnusableError(ChildRolloutError):
    """A campaign would refuse a rollout; the reason is first, since it need not depend on the start."""


def is_own_system(reference: str) -> bool:
    """Whether a system, as a worker finds it, is none that perfbound brings along."""
    return in_file(reference) or not any(
        each.dist is not None and each.dist.name == OURS for each in entry_points(group=GROUP, name=reference)
    )


def check_first_rollouts(header: Header, reference: str, where: str, print_line: Callable[[str], None]) -> None:
    """Simulate the first rollout of a campaign in a child process; of two simulators one of each.

    `reference` names the system as a worker finds it, `where` the file and the key that do. One that takes longer than
    `PATIENCE` is left to the workers.

    Raises:
        CampaignError: a rollout fails, does not end within the deadline, or would be refused by the campaign.

    """
    spec, limit = header.spec, min(header.config.deadline, PATIENCE)
    requests, columns = first_requests(header, plans(header.config, spec)), tuple(each.name for each in spec.columns)
    system = ChildSystem(reference, spec, limit, seconds=math.inf)
    notice = _notice(spec.name, print_line)
    for attempt in range(ATTEMPTS):
        try:
            _simulate(system, requests, columns, notice)
        except SlowRolloutError as fault:
            if limit == header.config.deadline:
                raise _refusal(fault, system, where, "let it end, or give a longer `deadline`") from None
            print_line(f"the first rollout of {spec.name} has not ended within {limit:g} s; it is left to the workers")
            return
        except ChildRolloutError as fault:
            if attempt + 1 == ATTEMPTS:
                raise _refusal(fault, system, where) from None
        else:
            return


def _simulate(
    system: ChildSystem,
    requests: Sequence[RolloutRequest | BatchRequest],
    columns: tuple[str, ...],
    notice: Callable[[int], None],
) -> None:
    with tempfile.TemporaryDirectory(prefix="perfbound-first-") as name:
        simulate_in_child(system, requests, Path(name), notice)
        for number, request in enumerate(requests):
            payload = file_of(Path(name), number).read_bytes()
            try:
                admit_either(request, columns, payload, hashlib.sha256(payload).hexdigest())
            except EvidenceError as fault:
                raise _UnusableError(f"{fault}; at {alone(request).words(system.spec)}") from None


def first_requests(header: Header, found: Plans) -> list[RolloutRequest | BatchRequest]:
    """Return the first rollout that each simulator of the system has in the campaign; a vectorised one has a batch."""
    template, first = header.template, dict[str, tuple[ProblemPlan, RolloutId]]()
    for plan in found.values():
        for variant, replicate in plan.rollouts:
            place = RolloutId(plan.name, 0, variant, replicate)
            first.setdefault(template.common(place)["spec_sha256"], (plan, place))
    return [_request(header, *each) for each in first.values()]


def _request(header: Header, plan: ProblemPlan, place: RolloutId) -> RolloutRequest | BatchRequest:
    start = first_start(plan, header)
    together = TOGETHER if header.config.batch > 1 and header.spec.vectorised else 1
    seeds = rollout_seeds(header, place, 1, together)
    if together == 1:
        return header.template.request(place, start, seeds[0])
    return header.template.batch(place, [start], seeds)


def _notice(name: str, print_line: Callable[[str], None]) -> Callable[[int], None]:
    """Return the progress callback that prints one line, once the rollout takes long."""
    due = [time.monotonic() + NOTICE]

    def done(_rollouts: int) -> None:
        if due and time.monotonic() >= due[0]:
            due.clear()
            print_line(f"simulating the first rollout of {name}, before workers start")

    return done


def _refusal(fault: ChildRolloutError, system: ChildSystem, where: str, remedy: str = "fix this") -> CampaignError:
    # By its file the campaign is tried: with its horizon and its inputs.
    file = Path(where.rpartition(": ")[0])
    check = shlex.join(["perfbound", "check-system", str(file) if file.is_file() else system.reference])
    what = f": {fault}" if isinstance(fault, _UnusableError) else f", at {fault}"
    return CampaignError(
        f"{where}: the first rollout of {system.spec.name} fails{what}; {remedy}, then run again (nothing was started, "
        f"and `{check}` tries more rollouts)"
    )
