"""The output of `perfbound calibrate`: a table, a campaign file, pictures, and the numbers behind them as JSON."""

import itertools
import json
import shlex
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Column, Table

from ....schemas import atomic
from ....schemas.errors import PerfboundError
from ...campaign.consistency import scope
from ...certificate.words.format import duration
from ...mathematics.calibration.trust import KernelTrial
from ..size import WORKERS
from .answer import answer
from .budget import RANGE, THOUSAND, BudgetForecast
from .calibrate import Calibration, CalibrationWish, Report, calibrate_draft
from .constants import ProblemCalibration
from .figures import calibration_picture
from .forecast import Forecast
from .tolerance import ToleranceForecast

NUMBERS = "calibration.json"
MOST_CLIPPED = 0.05
"""Share of clipped values from which the clip decides the claim."""


def calibration_of(wish: CalibrationWish, folder: Path, report: Report) -> Calibration:
    """Calibrate a draft, and write campaign file, pictures and numbers; all of them or none.

    Raises:
        PerfboundError: as `calibrate_draft`; or one of the files exists, which is found before the first rollout.

    """
    _check_new(wish.out, folder)
    found = calibrate_draft(wish, report)
    files = {folder / NUMBERS: json.dumps(_json_numbers(found), indent=1).encode() + b"\n"}
    for problem, guess in itertools.zip_longest(found.problems, found.forecasts):
        files[folder / f"calibration-{problem.name}.png"] = calibration_picture(problem, guess)
    if found.text is not None:
        files[wish.out] = found.text.encode()
    folder.mkdir(parents=True, exist_ok=True)
    try:
        atomic.write_new({path.absolute(): (data, 0o666) for path, data in files.items()})
    except FileExistsError as error:
        raise _exists_already(Path(error.filename2 or wish.out), wish.out) from None
    return found


def _check_new(out: Path, folder: Path) -> None:
    for path in (out, folder / NUMBERS):
        if path.exists():
            raise _exists_already(path, out)


def _exists_already(path: Path, out: Path) -> PerfboundError:
    # The campaign file belongs beside the draft, whatever --out says.
    remedy = "move or rename it" if path.name == out.name else "choose another --out"
    return PerfboundError(f"{path}: exists already and stays as it is; {remedy}")


def constants_table(found: Calibration, problem: ProblemCalibration) -> Table:
    """Return the constants of a problem with their reasons."""
    table = Table("constant", Column("proposal", max_width=26), "reason", box=None, padding=(0, 2, 0, 0))
    clip = [] if found.clip is None else [found.clip]
    for each in (*clip, *problem.constants):
        table.add_row(each.key, _value_text(each.value), each.why)
    return table


def closing_lines(found: Calibration, folder: Path) -> Iterator[str]:
    """Yield what follows below the tables."""
    yield from found.violations
    for problem in found.problems:
        if problem.choice.chosen is None:
            yield f"{problem.name}: no kernel is trustworthy."
            yield from (f"  {doubt}" for doubt in problem.doubts)
        if problem.measured.plan.controlled:
            yield (
                f"{problem.name}: the declared disturbances explain {100 * problem.measured.explained:.0f} % of the "
                "variance of a rollout at its start; the constants are those of what is left."
            )
        clipped = problem.measured.clipped
        if clipped is not None and clipped > MOST_CLIPPED:
            yield (
                f"{problem.name}: {100 * clipped:.2g} % of the values are at an end of the clip; the claim is about "
                "the clipped robustness. Choose a wider one, unless that is meant."
            )
    for problem, guess in zip(found.problems, found.forecasts, strict=False):
        lines = _FORECAST_LINES[type(guess)](guess)
        yield f"{problem.name}: forecast{next(lines)}"
        yield from lines
        yield f"{problem.name}: times are at the pace of the pilot, {problem.measured.pace.words}"
    if found.trusted:
        yield from scope({each.name: each.measured.plan for each in found.problems}, listed_alone=True)
    yield from _other_methods(found)
    yield f"evidence: {folder}/{NUMBERS} and calibration-*.png"
    if found.text is None:
        yield "No campaign file is written: without a specification there is nothing to sample; give one."
        return
    what = "with these constants" if found.trusted else "by method sample, which needs no kernel"
    workers = found.problems[0].measured.pace.workers
    options = [] if workers == WORKERS else ["--workers", str(workers)]  # those whose time the answer has
    command = ["perfbound", "run", str(found.wish.out), *options]
    yield f"{found.wish.out}: the campaign {what}. Then: {shlex.join(command)}"


def _tolerance_lines(guess: ToleranceForecast) -> Iterator[str]:
    seconds = f"{guess.rollouts:,} rollouts in about {duration(guess.seconds)}"
    if guess.tests is None:
        yield (
            f": {len(guess.widths):,} tests leave {guess.widths[-1]:.3g} between the bounds, and alpha = {guess.alpha} "
            f"is out of reach; raise alpha, or accept the wider bound after {guess.budget} tests ({seconds})"
        )
    else:
        yield f": alpha = {guess.alpha} after about {guess.tests:,} tests; {seconds}, closing checks included"


def _budget_lines(guess: BudgetForecast) -> Iterator[str]:
    sign, share = guess.sign, RANGE[1] - RANGE[0]
    yield (
        f" of the bound, if every assumption holds; without any rollout it is {sign * guess.without:.3g}, and the "
        f"worst start of the fitted function has {sign * guess.fitted:.3g}"
    )
    yield f"  {'rollouts':>9}  {'max_tests':>9}  {'replicates':>10}  {f'bound, {100 * share:.0f} % range':<26}  time"
    for each in guess.budgets:
        mark = "  <- proposed" if each == guess.proposed and not guess.vain else ""
        yield (
            f"  {each.enters:>9}  {each.tests:>9}  {each.replicates:>10}  {each.bound.words(sign):<26}  "
            f"{duration(each.seconds)}{mark}"
        )
    if guess.vain:
        yield (
            "  No budget proves more than the constants alone: remove `method` from the draft, for one by rigorous (of "
            "more than three parameters with `candidates`, about listed starts alone)."
        )
    yield f"  {THOUSAND} further rollouts would bring about {guess.thousand:.2g}; times include the closing checks"


_FORECAST_LINES: Mapping[type[Forecast], Callable[[Any], Iterator[str]]] = {
    ToleranceForecast: _tolerance_lines,
    BudgetForecast: _budget_lines,
}


def _other_methods(found: Calibration) -> Iterator[str]:
    """Yield a line for each problem without a method for which another one may be expected to prove more."""
    numbers = {problem.name: number for number, problem in enumerate(found.problems)}
    for each in found.instead:
        if not each.is_tighter:
            continue
        given = found.draft.given(numbers[each.problem])
        unused = [key for key in ("alpha", "noise_scale", "slack", "regulariser") if key in given]
        change = f"put it in place of {', '.join(unused)}" if unused else "add it"
        yield (
            f"{each.problem}: method kriging may be expected to prove {each.kriging.words(each.sign)} with "
            f"{each.rollouts:,} rollouts, where rigorous proves {each.sign * each.default:.3g}; for a file with "
            f'method = "kriging", {change} in a copy of {found.wish.campaign.name} and calibrate that'
        )


def _value_text(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_value_text(each)}" for key, each in value.items())
    if isinstance(value, list):
        return f"[{', '.join(map(_value_text, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def _json_numbers(found: Calibration) -> dict[str, Any]:
    """Return everything that the proposal rests on."""
    wish = found.wish
    return {
        "campaign": wish.campaign.name,
        "digest": found.draft.config.digest,
        "system": found.spec.name,
        "seed": wish.seed,
        "answer": answer(found),
        "trustworthy": found.trusted,
        "clip": None if found.clip is None else found.clip.value,
        "problems": [_problem_numbers(each) for each in found.problems],
        "forecasts": [each.numbers for each in found.forecasts],
        "kriging_instead": [
            {"problem": each.problem, "rollouts": each.rollouts, "default": each.sign * each.default}
            | {"bound": each.sign * each.kriging.middle, "range": list(each.kriging.ends(each.sign))}
            for each in found.instead
        ],
    }


def _problem_numbers(found: ProblemCalibration) -> dict[str, Any]:
    measured = found.measured
    chosen = found.choice.chosen
    return {
        "name": found.name,
        "rollouts": measured.rollouts,
        "seconds_per_rollout": measured.pace.cost,
        "workers": measured.pace.workers,
        "constants": [
            {"key": each.key, "value": each.value, "reason": each.reason, "margin": each.margin}
            for each in found.constants
        ],
        "doubts": list(found.doubts),
        "nu": None if chosen is None else chosen.fit.nu,
        "kernels": [_of_trial(each, measured.box.widths.tolist()) for each in found.choice.trials],
        "starts": measured.box.starts(measured.shares),
        "values": measured.values.tolist(),
        "noisiest": list(measured.noisiest),
        "values_at_noisiest": measured.at_noisiest.tolist(),
        "steepest": [
            {
                "jump": each.is_jump,
                "places": [
                    {"distance": place.distance, "difference": place.difference, "quotient": place.quotient}
                    for place in each.places
                ],
            }
            for each in measured.descents
        ],
        "clipped": measured.clipped,
        "explained_by_disturbances": measured.explained if measured.plan.controlled else None,
    }


def _of_trial(trial: KernelTrial, widths: list[float]) -> dict[str, Any]:
    return {
        "nu": trial.fit.nu,
        "length_scale": (trial.fit.lengths * np.array(widths)).tolist(),
        "sizes": list(trial.growth.sizes),
        "norms": list(trial.growth.norms),
        "limit": trial.growth.limit,
        "rkhs_norm": trial.bound,
        "explained": trial.predictions.explained,
        "prediction_error_over_noise": None if np.isinf(trial.predictions.excess) else trial.predictions.excess,
        "largest_deviation": trial.predictions.largest,
        "faults": list(trial.faults),
    }
