"""The counterexample of a certificate in words, and what a bisection made of it, if it was sought."""

from collections.abc import Mapping

from ...schemas.result.certificate import Counterexample
from .bound_text import DIGITS, in_unit


def counterexample_words(found: Counterexample, unit: str, units: Mapping[str, str] | None = None) -> str:
    """Return what a counterexample is; `unit` is that of the robustness, `units` those of the parameters."""
    start = named_start(found.start, units)
    others = f", the worst of its {found.rollouts} rollouts" if found.rollouts > 1 else ""
    margin = margin_words(found.robustness, unit)
    words = f"test {found.test} violates the specification: robustness {margin} at {start}, seed {found.seed}"
    return f"{words} (rollout {found.rollout}{others}){_shrunk_words(found, unit, units)}"


def _shrunk_words(found: Counterexample, unit: str, units: Mapping[str, str] | None) -> str:
    """Return where the system still fails nearer to the nominal start; empty where that was not sought."""
    near = found.shrunk
    if near is None:
        return ""
    tried = f"{near.rollouts} rollout{'' if near.rollouts == 1 else 's'} towards {named_start(near.nominal, units)}"
    if near.rollout == found.rollout:
        return f"; after {tried} no start that was tried on the line there fails"
    where = (
        f"{named_start(near.start, units)}, robustness {margin_words(near.robustness, unit)} (rollout {near.rollout})"
    )
    return f"; on the line there, with this seed, the failing start next to one that passes, after {tried}: {where}"


def margin_words(robustness: float, unit: str) -> str:
    """Return a robustness with its unit, if it has one."""
    return in_unit(f"{robustness:.{DIGITS}f}", unit)  # a value, no bound


def named_start(start: Mapping[str, float], units: Mapping[str, str] | None = None) -> str:
    """Return a start with the names of its parameters; where units are given, with these, and in their order.

    >>> named_start({"mass": 0.25, "gap": 5.0}, {"gap": "m", "mass": "1"})
    'gap = 5 m, mass = 0.25'
    """
    shown = units or {}
    names = [name for name in shown if name in start] + [name for name in start if name not in shown]
    return ", ".join(in_unit(f"{name} = {start[name]:.7g}", shown.get(name, "")) for name in names)
