"""CPU milliseconds of one proposal and one observation (ask + tell) of method `paper`, beside those of peers."""

import statistics
import sys
import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from perfbound.orchestrator.mathematics.bounds.paper.formulas import PaperParameters, Regulariser
from perfbound.orchestrator.mathematics.bounds.paper.method import PaperMethod
from perfbound.orchestrator.mathematics.gp.kernels import Matern
from perfbound.orchestrator.mathematics.gp.lattice import Lattice
from tests.fakes.observations import an_observation
from tests.studies.benchmarks import data
from tests.studies.benchmarks.report import Row

REPEATS = 5
LONGEST: dict[tuple[Regulariser, bool], int] = {
    (1.0, False): 2000,
    ("1+eta", False): 2000,
    (1.0, True): 1000,
    ("1+eta", True): 385,
}
"""Tests of a campaign, by regulariser and refinement: refined points seldom repeat, so 2,000 would take minutes."""
WANTED = {(385, True): 8.0, (2000, False): 100.0}
"""Least ratio to the best peer, by size and refinement."""
AROUND = 20
"""Tests of a campaign whose median is the cost at a size."""
REGULARISERS: tuple[Regulariser, ...] = (1.0, "1+eta")

Peers = Mapping[str, Mapping[str, Mapping[str, Any]]]


def main(peers: Peers) -> list[Row]:
    """Measure ours and put the best peers beside it; `peers` by name and size, empty without them."""
    rows = [*_peer_rows(peers)]
    for refine in (False, True):
        for regulariser in REGULARISERS:
            rows += _distinct(regulariser, refine, peers)
            rows += _campaign(regulariser, refine, peers)
    return rows


def _method(
    nu: float, regulariser: Regulariser, refine: bool, *, rkhs_norm: float = 0.25, noise_scale: float = 0.005
) -> PaperMethod:
    box = (data.LOW,) * 2, (data.HIGH,) * 2
    parameters = PaperParameters(
        rkhs_norm=rkhs_norm,
        noise_scale=noise_scale,
        delta=0.05,
        alpha=1e-9,
        c=0.01,
        regulariser=regulariser,
        sigma="std",
    )
    return PaperMethod(Lattice(*box, data.RESOLUTION), Matern(nu, data.LENGTH_SCALE), parameters, refine=refine)


def _distinct(regulariser: Regulariser, refine: bool, peers: Peers) -> list[Row]:
    """The dearest data there can be: every test at another node. beta = B = `data.SCALE`, as the noise scale is 0."""
    method = _method(data.NU, regulariser, refine, rkhs_norm=data.SCALE, noise_scale=0.0)
    nodes, y = (values.tolist() for values in data.distinct())
    rows = []
    for n in data.SIZES:
        while method.n < n:
            method.observe(*an_observation(nodes[method.n], y[method.n]))
        times, proposed = [], []
        for i in range(n, n + REPEATS):
            start = time.process_time_ns()
            method.observe(*an_observation(nodes[i], y[i]))
            proposed.append(method.propose().node)
            times.append((time.process_time_ns() - start) / 1e6)
        if regulariser == data.REGULARISER and not refine:
            _check_agreement(n, proposed[0], peers)
        wanted = WANTED.get((n, True)) if refine else None  # repeats or not
        name = f"proposal, n = {n}: all distinct, {_kind(regulariser, refine)}"
        rows.append(best_beside(name, statistics.median(times), peers, n, wanted))
    return rows


def _check_agreement(n: int, node: int, peers: Peers) -> None:
    """Raise if a peer that was asked for the same proposal made another one: then the times compare nothing."""
    for name, found in peers.items():
        theirs = found.get(str(n), {}).get("node")
        if theirs is not None and theirs != node:
            raise RuntimeError(f"after {n} tests {name} proposes node {theirs}, ours is {node}")


def _campaign(regulariser: Regulariser, refine: bool, peers: Peers) -> list[Row]:
    """A campaign of the paper's kernel that observes what it proposes, so that points repeat."""
    method = _method(10.0, regulariser, refine)
    rng = np.random.default_rng(0)
    times: list[float] = []
    proposal = method.propose(int(rng.integers(data.RESOLUTION**2)))
    seen = set()
    tests = LONGEST[regulariser, refine]
    while method.n < tests + REPEATS:
        seen.add(proposal.x)
        value = float(data.objective(np.array([proposal.x]))[0] + rng.normal(0.0, data.NOISE))
        start = time.process_time_ns()
        method.observe(*an_observation(proposal.node, value, proposal.x))
        proposal = method.propose()
        times.append((time.process_time_ns() - start) / 1e6)
    kind, rows = _kind(regulariser, refine), []
    for n in (size for size in data.SIZES if size <= tests):
        near = statistics.median(times[max(0, n - AROUND) : n + REPEATS])
        rows.append(best_beside(f"proposal, n = {n}: repeats merged, {kind}", near, peers, n, WANTED.get((n, refine))))
    total, name = sum(times[:tests]) / 1000, f"proposal, campaign of {tests} tests: {kind}"
    rows.append(Row(name, total, "s", at_most=None if refine else 5.0))
    return [*rows, Row(f"{name}, distinct points", len(seen), "points")]


def best_beside(name: str, milliseconds: float, peers: Peers, n: int, wanted: float | None = None) -> Row:
    """Return a row beside the quickest peer at this size; `wanted` is the least ratio."""
    best = min(((found[str(n)]["ms"], peer) for peer, found in peers.items() if str(n) in found), default=(None, ""))
    return Row(name, milliseconds, "ms", best[1], best[0], ratio_at_least=wanted)


def _kind(regulariser: Regulariser, refine: bool) -> str:
    return f"lambda = {regulariser}, {'refined' if refine else 'lattice'}"


def _peer_rows(peers: Peers) -> list[Row]:
    """Times of the peers, as rows of their own; "-" where the limit of time was reached."""
    rows = []
    for name, found in peers.items():
        for n in data.SIZES:
            if str(n) in found:
                rows.append(Row(f"peer, n = {n}: {name}", found[str(n)]["ms"], "ms"))
            else:
                sys.stderr.write(f"  peer, n = {n}: {name}: -, above the limit of time\n")
    return rows
