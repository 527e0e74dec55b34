"""Findings about single trajectories: errors, columns, numbers, times."""

import re
from collections.abc import Mapping

from ....schemas.system_check import Measured
from ....schemas.values import Stamps
from .findings import SystemFinding, failed, passed, warning
from .measurements import Measurements
from .trials import CORNER, START

STEP_SPREAD = 1e-6
"""Relative difference of the steps of a grid that is round-off of its times."""
STAMPS: Mapping[Stamps, str] = {
    "float32": "the times are rounded to float32, so a border of a window takes in the sample that is nearest to it",
    "accumulated": "the times are sums of a step with their round-off; better is the number of the step times the step",
}
"""What is said of times that are not exact."""


_REMEDY_HANG = (
    "fix what does not end there; if rollouts take longer, choose --timeout, or a `deadline` in the campaign file"
)


def judge_ends(measurements: Measurements) -> SystemFinding:
    """Judge how the processes ended: a crash, a hang."""
    run = next((run for run in measurements.runs if run.ended), None)
    if run is None:
        return passed("ends", f"{len(measurements.rolled)} rollouts ended within {measurements.limit:g} s each")
    if run.loaded is None:
        text = f"the process {run.ended} while it loaded the system{_at(run.place)}: {run.stderr}"
        return failed("ends", text, "fix what the file does when it is imported")
    at = f"at {run.trials[len(run.measured)].request.words(measurements.spec)}"
    if run.hung:
        where = f" in {measurements.program}" if measurements.program else _at(run.place)
        text = f"a rollout {run.ended}{where}: {at}"
        return failed("ends", text, _REMEDY_HANG)
    text = f"the process {run.ended}{_at(run.place)}: {at}" + (f" ({run.stderr})" if run.stderr else "")
    return failed("ends", text, "fix it: raise an exception instead; the campaign loses the worker, and stops")


def _at(place: str) -> str:
    return f" in {place}" if place else ""


_KINDS = (
    ("finite", re.compile(r"not finite")),
    ("times", re.compile(r"the time must|a third state in row|without time")),
    ("columns", re.compile(r"column|returned|differ in length|array of numbers|has the shape|samples have shape")),
)
"""What the refusal of a trajectory is about, by its words; the first that fits."""
_REMEDIES = {
    "errors": "fix it; if the system is not defined there, narrow the ranges of `parameters`",
    "finite": "fix the arithmetic at this start (a division by 0, an overflow, an unstable step), or narrow the ranges "
    "of `parameters` to where the system is defined",
    "times": "let the column t begin at 0 and increase, or give `step` and return no times",
    "seed": "give the decorator seed_bits=32 if a library takes no longer seed, or take every seed below 2**53",
    "columns": "return an array for each of the `columns`, in their order and of one length, or a dict of arrays",
}

_REMEDY_UNCOVERED = (
    "let the first sample be at 0 and the last one at the horizon, in seconds, or declare after_end. A "
    "system with a duration of its own takes that one: --horizon"
)


def _kind(found: Measured) -> str:
    if found.raised:
        return "errors"
    return next((kind for kind, words in _KINDS if words.search(found.error)), "errors")


def _is_of_seed(found: Measured) -> bool:
    """Whether a library refused a seed; an error that only has the word in it is another one."""
    return found.raised and re.match(r"(ValueError|OverflowError): .*seed", found.error, re.IGNORECASE) is not None


def _refusals(measurements: Measurements, kind: str) -> SystemFinding | None:
    """Return the finding about rollouts without a trajectory, if there are some of this kind."""
    rolled = measurements.rolled
    refused = [(trial.request, found) for trial, found in rolled if found.error and _kind(found) == kind]
    if not refused:
        return None
    request, found = refused[0]
    where = f"{found.place}: " if found.place else ""
    count = f"({len(refused)} of {len(rolled)} rollouts)"
    text = f"{where}{found.error}; at {request.words(measurements.spec)} {count}"
    return failed(kind, text, _REMEDIES["seed" if _is_of_seed(found) else kind])


def judge_errors(measurements: Measurements) -> SystemFinding | None:
    """Judge the exceptions of the system."""
    none = f"none in {len(measurements.rolled)} rollouts"
    return _refusals(measurements, "errors") or (passed("errors", none) if measurements.rolled else None)


def judge_columns(measurements: Measurements) -> SystemFinding | None:
    """Judge the columns of the trajectories."""
    names = ", ".join(f"{each.name} ({each.unit})" if each.unit else each.name for each in measurements.spec.columns)
    return _refusals(measurements, "columns") or (passed("columns", names) if measurements.good else None)


def judge_finite(measurements: Measurements) -> SystemFinding | None:
    """Judge whether every number is finite."""
    starts = {(trial.request.problem == CORNER, trial.request.x) for trial, _ in measurements.good}
    corners = sum(corner for corner, _ in starts)
    text = f"at {corners} corners and {len(starts) - corners} random starts"
    return _refusals(measurements, "finite") or (passed("finite", text) if measurements.good else None)


def judge_times(measurements: Measurements) -> SystemFinding | None:
    """Judge the sample times: from 0 to the horizon, in equal steps, the same ones in all rollouts."""
    refused = _refusals(measurements, "times")
    if refused or not measurements.good:
        return refused
    grids = [(trial.request, found.grid) for trial, found in measurements.good if found.grid is not None]
    for request, grid in grids:
        if grid.uncovered:
            text = f"{grid.uncovered}; at {request.words(measurements.spec)}"
            return failed("times", text, _REMEDY_UNCOVERED)
    for request, grid in grids:
        if grid.greatest_step - grid.least_step > STEP_SPREAD * grid.greatest_step:
            text = f"the steps of one trajectory are {grid.least_step:g} to {grid.greatest_step:g} s"
            remedy = "return samples in equal steps: a violation between two distant samples is not seen"
            return warning("times", f"{text}; at {request.words(measurements.spec)}", remedy)
    kinds = sorted({(grid.samples, float(f"{grid.greatest_step:.6g}")) for _, grid in grids})
    if len(kinds) > 1:
        one, other = (f"{samples} samples in steps of {step:g} s" for samples, step in (kinds[0], kinds[-1]))
        remedy = "return the same times at every start: the gap between the nominal and the true system needs them"
        return warning("times", f"rollouts of one horizon have different times: {one}, {other}", remedy)
    samples, step = kinds[0]
    text = f"{samples} samples from 0 to {grids[0][1].last:g} s in steps of {step:g} s"
    given: list[Stamps] = [grid.stamps for _, grid in grids if grid.stamps != "exact"]
    text = (text if samples > 1 else "one sample at 0") + (f"; {STAMPS[given[0]]}" if given else "")
    declared = measurements.spec.stamps
    if given and given[0] != declared:
        remedy = f'declare stamps = "{given[0]}", so that the certificate is about a system whose times are known'
        return warning("times", f"{text}; the system says that they are {declared}", remedy)
    return passed("times", text)


def judge_horizon(measurements: Measurements) -> SystemFinding | None:
    """Inform about the effect of the horizon; no certificate rests on it."""
    if not measurements.good:
        return None
    horizon = measurements.horizon
    if measurements.own_horizon:
        key = f"a campaign file has horizon = {horizon:g}" if horizon else "a campaign file has no `horizon`"
        return passed("horizon", f"its rollouts last {horizon:g} s, whatever horizon is requested; {key}")
    starts = {trial.request.variant: found for trial, found in measurements.good if trial.request.problem == START}
    pairs = [
        (found, starts[trial.request.variant])
        for trial, found in measurements.shorter
        if not found.error and trial.request.variant in starts
    ]
    if not pairs:
        return passed("horizon", f"{horizon:g} s; no other one was tried")
    if not all(short.grid and long.grid and short.grid.last < long.grid.last for short, long in pairs):
        return passed("horizon", f"half of {horizon:g} s gives a trajectory of the same length")
    same = all(short.beginning_sha256 == long.beginning_sha256 for short, long in pairs)
    agree = "agree in the part that they share" if same else "do not agree: the horizon changes more than the end"
    return passed("horizon", f"trajectories of {horizon:g} s and of half of it {agree}")


def judge_actions(measurements: Measurements) -> SystemFinding | None:
    """Judge what a policy or a controller does: actions outside their limits, or none at all."""
    acting = [(trial.request, found.acts) for trial, found in measurements.good if found.acts]
    outside = [(request, acts) for request, acts in acting if acts.outside]
    if outside:
        request, acts = outside[0]
        return warning(
            "actions",
            f"{acts.outside}; at {request.words(measurements.spec)} ({len(outside)} of {len(acting)} rollouts)",
            "scale the actions, or clip them in the policy, as by np.clip(action, low, high): what such an action does "
            "is up to the environment, of which many clip it and say nothing",
        )
    if acting and all(acts.idle for _, acts in acting):
        return warning(
            "actions",
            f"{acting[0][1].idle}, in {len(acting)} of {len(acting)} rollouts",
            "end the controller with `return [...]`, a number for each actuator, or let it write data.ctrl",
        )
    return passed("actions", f"within their limits in {len(acting)} rollouts") if acting else None
