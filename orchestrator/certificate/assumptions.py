"""What the claims rest on, and what the data say about it: the audit of a finished campaign."""

import itertools
from collections.abc import Iterator, Mapping

from orchestrator.bounds import audit
from orchestrator.bounds.audit import Assumption
from orchestrator.certificate.claims import PAIR, Methods
from orchestrator.gp.lattice import Lattice
from orchestrator.ledger import Account
from orchestrator.methods import Rigorous, candidates, derived_noise, kernel, noise_per_test
from orchestrator.store.journal import Header
from schemas.campaign import ROLLED_OUT, PaperProblem, RigorousProblem, ScenarioProblem


def assumptions(header: Header, accounts: Mapping[str, Account], methods: Methods) -> list[Assumption]:
    """Return every assumption of the campaign, problem by problem, then those of the whole."""
    found: list[Assumption] = []
    for name, account in accounts.items():
        problem = account.problem
        if isinstance(problem, PaperProblem):
            found += _paper(header, account, problem)
        elif isinstance(problem, RigorousProblem):
            method = methods[name]
            assert isinstance(method, Rigorous)
            found += _rigorous(header, account, problem, method)
        else:
            found += _scenario(account, problem, size=methods[name].size)
        if account.robustness and header.config.clip is not None:
            found.append(audit.clipped_share(name, account.robustness, header.config.clip))
    found.append(_finite(accounts))
    pair = [name for name in accounts if name in PAIR]
    if len(pair) == len(PAIR):
        product = header.config.composition == "product"
        found.append(audit.independent_problems(pair, "product" if product else "sum"))
    return [*found, audit.workers_honest()]


def _finite(accounts: Mapping[str, Account]) -> Assumption:
    rollouts = sum(sum(account.counts.values()) for account in accounts.values())
    detail = (
        f"all {rollouts} rollouts behind the bounds are finite, and none was dropped or redrawn because of its "
        "outcome: one that is never finite ends the campaign without a certificate."
    )
    return Assumption("finite_rollouts", "derived", detail)


def _paper(header: Header, account: Account, problem: PaperProblem) -> Iterator[Assumption]:
    config, name = header.config, problem.name
    noise, replicates = noise_per_test(config, header.spec, problem), config.replicates_of(problem)
    lattice = candidates(config, header.spec, problem)
    assert isinstance(lattice, Lattice), "the campaign file was checked"
    yield audit.rkhs_norm(
        name,
        account.observations,
        prior_mean=problem.prior_mean,
        rkhs_norm=problem.rkhs_norm,
        noise_scale=noise,
        delta=problem.delta,
    )
    yield audit.noise_scale(name, noise_scale=noise, replicates=replicates)
    yield audit.noise_tail(name, c=problem.c, delta=problem.delta, noise_scale=noise, tail=problem.tail)
    yield audit.sigma_reading(name, problem.sigma)
    yield audit.regulariser(name, problem.regulariser)
    yield audit.lattice_for_box(name, lattice, kernel(problem), problem.rkhs_norm)
    if name == "true_risk":
        yield audit.centred_risk(name, replicates)


def _rigorous(header: Header, account: Account, problem: RigorousProblem, method: Rigorous) -> Iterator[Assumption]:
    config, name, bound = header.config, problem.name, method.method.bound()
    noise, last = noise_per_test(config, header.spec, problem), account.last_bound
    yield audit.norm_from_data(
        name, b_min=bound.b_min, rkhs_norm=problem.rkhs_norm, delta=problem.delta, noise_scale=noise
    )
    yield audit.misspecification(
        name,
        tau=problem.misspecification,
        nu=problem.kernel.nu,
        length_scale=problem.kernel.length_scale,
        rkhs_norm=problem.rkhs_norm,
    )
    if last is not None and last.upper is not None and last.lower is not None:
        yield audit.bounds_agree(name, upper=last.upper, lower=last.lower)
    yield from _noise(header, account, problem, noise)
    if isinstance(method.candidates, Lattice):
        yield audit.certified_box(name, nodes=bound.candidates_upper, slack=bound.slack)


def _noise(header: Header, account: Account, problem: RigorousProblem, noise: float) -> Iterator[Assumption]:
    name = problem.name
    if noise == 0:
        noisy = set(ROLLED_OUT[name]) & set(header.spec.noisy)
        if noisy:
            yield audit.deterministic_variant(name, account.each)
        else:
            places = zip(account.nodes, account.each, strict=True)
            by_place = itertools.groupby(sorted(places), key=lambda place: place[0])
            yield audit.deterministic_variant(name, [[v for _, each in group for v in each] for _, group in by_place])
        return
    per_rollout = noise * header.config.replicates_of(problem) ** 0.5
    if name != "maximum":
        yield audit.noise_range(
            name, noise_scale=per_rollout * (1 + 1e-12), hoeffding=derived_noise(header.config, header.spec, problem)
        )
    else:
        yield audit.noise_scale(name, noise_scale=noise, replicates=header.config.replicates_of(problem))
    yield audit.replicate_spread(name, account.each, noise_scale=per_rollout)


def _scenario(account: Account, problem: ScenarioProblem, *, size: int) -> Iterator[Assumption]:
    name, bound = problem.name, account.last_bound
    rollouts = sum(account.counts.values())
    yield Assumption(
        f"finite_space/{name}",
        "derived",
        f"the claim is about the {size} listed starts and no others; for these the minimum is exact.",
    )
    yield Assumption(
        f"independent_rollouts/{name}",
        "derived",
        f"the {rollouts} rollouts have seeds of their own, and those of one start differ in nothing else; the bound "
        "needs no more of the noise than this and the clip.",
    )
    if bound is not None and bound.upper is not None and bound.lower is not None:
        ell, reach = -bound.upper, -bound.lower
        yield Assumption(
            f"one_law_per_start/{name}",
            "refuted" if reach < ell else "not refuted",
            f"the bound is {ell:.6g} and what it tends to is at most {reach:.6g}, each at its own confidence; "
            + (
                "they contradict each other, so the rollouts of a start do not have one law."
                if reach < ell
                else "that they agree is not evidence."
            ),
        )
    if problem.linearised is not None:
        yield Assumption(
            f"linearised/{name}",
            "derived",
            f"the risk is bounded by an expectation with the constants {problem.linearised.centre:g} and "
            f"{problem.linearised.spread:g}, fixed beforehand: any constants are valid, good ones lose less.",
        )
