"""Which starts of a box the claims of a campaign are about, in sentences for its beginning."""

from collections.abc import Iterator

from .plan import Plans


def scope(plans: Plans) -> Iterator[str]:
    """Yield a line for the problems that choose among starts of a box; none for a list, which is its own box."""
    # The problems of a campaign have one list or none: the file is checked for that.
    found = [plan for plan in plans.values() if plan.box and plan.candidates is not None]
    if not found:
        return
    names, listed = ", ".join(plan.name for plan in found), found[0].listed
    if listed is None:
        yield f"{names}: the claim is about every start of the box"
        return
    count = len(found[0].parameters)
    yield (
        f"{names}: the claim is about the worst of {listed:,} fixed starts, spread over the ranges of {count} "
        f"parameter{'s' if count > 1 else ''}, and about no start between them; method 'sample' makes claims about all"
    )
