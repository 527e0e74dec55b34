"""The certificate: an in-toto Statement v1 without time, host or path, so that no run differs from another."""

import json
from typing import Literal

from pydantic import Field

from ..base import Model
from ..file.composition import ClaimRule, Rule
from ..file.objectives import MethodName, ProblemName, Quantity, Sense
from ..values import StoppedBy

MAX_CERTIFICATE = 2**24
"""Bytes."""
STATEMENT_TYPE: Literal["https://in-toto.io/Statement/v1"] = "https://in-toto.io/Statement/v1"
PREDICATE_TYPE: Literal["urn:perfbound:certificate:v1"] = "urn:perfbound:certificate:v1"

OF_DRAWN_STARTS = ("subject", "requirement", "level", "factor", "samples")
OPTIONAL_IN_CLAIM = ("starts", "clipped", "by_clip", "without_data", "vacuous", *OF_DRAWN_STARTS)
"""Keys of a claim that are left out where they have no value."""
Status = Literal["derived", "assumed", "not refuted", "refuted"]


class Subject(Model):
    """The subject of the statement: the manifest of the evidence."""

    name: str
    digest: dict[Literal["sha256"], str]


class CampaignId(Model):
    """The campaign: its name, its seed and the digests of its inputs."""

    name: str
    seed: int
    config_sha256: str
    system_sha256: str = Field(description="of the system's specification")


class CertificateClaim(Model):
    """P[quantity (>= | <=) bound] >= probability, resting on the named assumptions."""

    quantity: Quantity
    sense: Literal[">=", "<="]
    bound: float
    probability: float
    rule: ClaimRule
    method: str
    assumptions: tuple[str, ...]
    refuted: tuple[str, ...] = Field(description="those of the assumptions that are refuted: do not rely on the claim")
    starts: int | None = Field(
        default=None,
        ge=1,
        description="number of listed starts, the only ones that the claim covers; null for a box",
    )
    clipped: tuple[float, float] | None = Field(
        default=None,
        description="the claim is about values that count as the nearer of these two beyond them, and the values "
        "themselves may contradict it; null where what is true of the clipped values is true of the values",
    )
    by_clip: float | None = Field(default=None, description="what the clip alone proves; `bound` is never weaker")
    without_data: float | None = Field(
        default=None, description="what B, the prior mean and the clip prove before the first rollout"
    )
    vacuous: bool | None = Field(
        default=None,
        description="whether the clip alone proves `bound`, so that it shows nothing",
    )
    subject: str | None = Field(
        default=None, description="the quantity in words, with its level; null where `quantity` says it"
    )
    requirement: str | None = Field(default=None, description="that it is about; null for the whole specification")
    level: float | None = Field(default=None, description="of a quantile, CVaR, share or next rollout")
    factor: float | None = Field(
        default=None,
        description="the claim holds for every distribution with at most so many times the declared density",
    )
    samples: int | None = Field(
        default=None,
        description="number of samples, fixed beforehand, at which the bound is claimed; null where it is valid after "
        "every sample",
    )


class Rollouts(Model):
    """Number of rollouts behind a bound."""

    nominal: int
    true: int


class ControlOfDisturbance(Model):
    """What the last control takes from a rollout for one disturbance, before the mean of that is subtracted.

    It is linear in the score between `knots`, and constant beyond. `levels` has its values at the knots: first those in
    the middle of the ranges, then for each parameter what is added at its upper end and subtracted at its lower one.
    """

    name: str
    standard_deviation: float = Field(description="of what it takes out, over uniform starts; unit of the objective")
    knots: tuple[float, ...] = Field(description="normal quantiles of the disturbance, or numbers of its choices")
    levels: tuple[tuple[float, ...], ...]


class ControlResult(Model):
    """The control by declared disturbances of one problem: it lowers the variance of rollouts, and changes no mean.

    Of method `scenario` it is that of the start with the lowest bound, of `sample` that of the first claim with one.
    """

    explained: float = Field(description="share of the variance of a rollout that it takes out")
    standard_deviation: float = Field(description="that is left, of rollouts that its fit did not have")
    before_fit: int = Field(description="rollouts before the first fit, from which nothing was taken out")
    disturbances: tuple[ControlOfDisturbance, ...]


class ProblemResult(Model):
    """The bound of one problem; `bound` is a lower one for sense min, an upper one for sense max."""

    name: ProblemName
    objective: str
    method: MethodName
    sense: Sense
    bound: float
    partner: float | None = Field(
        description="from the other side, if the method has one; of a linearised risk, of its expectation"
    )
    probability: float
    probabilities: dict[Literal["gaussian", "sub-gaussian", "bound"], float]
    tests: int
    rollouts: Rollouts
    stopped_by: StoppedBy
    parameters: dict[str, object]
    last_F: float | None  # noqa: N815  (the paper's symbol)
    by_clip: float | None = Field(default=None, description="what the clip alone proves of the objective")
    control: ControlResult | None = Field(
        default=None,
        exclude_if=lambda control: control is None,
        description="by declared disturbances; null where none explains anything, or none is asked for",
    )
    requirement: str | None = Field(
        default=None,
        exclude_if=lambda name: name is None,
        description="that is bounded; null for the whole specification",
    )

    @property
    def key(self) -> str:
        """Name of the problem, with that of the requirement behind it where there is one."""
        return self.name if self.requirement is None else f"{self.name}/{self.requirement}"


class BoundedDisturbance(Model):
    """The values of one disturbance that a claim is for: with the unit `sd` its range is one of scores."""

    name: str
    low: float
    high: float
    unit: str
    values: tuple[float, float] = Field(description="the range in the unit of the disturbance")
    unit_of_values: str


class Bounded(Model):
    """The set of disturbances for every one of which the claims are."""

    disturbances: tuple[BoundedDisturbance, ...]
    outside: float = Field(description="upper bound of the probability that one of them is outside")
    failure_probability: float | None = Field(
        description="upper bound of the probability that a rollout fails, at every start, if the first claim is true; "
        "null where it does not follow, as where other things are random or the claim is below 0"
    )


class Assumption(Model):
    """One assumption of the claims, and its status by the data; `detail` follows from the form and the values."""

    id: str
    status: Status
    detail: str
    form: str | None = Field(
        default=None,
        exclude_if=lambda form: form is None,
        description="the form of the sentence, where it is not that of the id",
    )
    values: dict[str, int | float | str] = Field(
        default_factory=dict, description="the named numbers behind the status"
    )


class CompositionTerms(Model):
    """bound = nominal_bound - gap_term - risk_term."""

    rule: Rule
    nominal_bound: float
    gap_bound: float
    lipschitz: float
    gap_term: float
    risk_term: float
    bound: float


class Shrunk(Model):
    """The failing start that is nearest to the nominal one, of those that a bisection tried."""

    nominal: dict[str, float]
    start: dict[str, float]
    robustness: float = Field(description="below 0")
    rollout: str = Field(description="the counterexample itself, where no nearer start fails")
    rollouts: int = Field(description="of the bisection; no claim uses them")


class Simplest(Model):
    """The failing start with the fewest parameters away from their nominal values, of those that were tried."""

    nominal: dict[str, float]
    start: dict[str, float]
    away: tuple[str, ...] = Field(description="the parameters that are not at their nominal value")
    robustness: float = Field(description="below 0")
    rollout: str = Field(description="the failure itself, where no simpler one was found")
    rollouts: int = Field(description="of this search; no claim uses them")


class FailureAtStart(Model):
    """A bound of the probability that a rollout from one start fails, by importance sampling."""

    bound: float = Field(description="the probability is at least this; 0 where it shows none")
    probability: float = Field(description="with which the bound is right")
    rollouts: int
    failures: int
    share: float = Field(
        description="of the rollouts, on average, that have disturbances as in operation; the others have scores "
        "around those of the likeliest failure"
    )


class DrawnValue(Model):
    """The value of a disturbance in one rollout."""

    value: float
    unit: str


class LikeliestFailure(Model):
    """The failing rollout whose disturbances are likeliest, of those that a search tried."""

    start: dict[str, float] = Field(description="with the scores of the disturbances, in sd")
    disturbances: dict[str, DrawnValue] = Field(description="their values")
    distance: float = Field(description="of the scores from the medians: the root of the sum of their squares, in sd")
    robustness: float = Field(description="below 0")
    rollout: str = Field(description="the counterexample itself, where no likelier one was found")
    rollouts: int = Field(description="of this search; no claim uses them")
    at_start: FailureAtStart | None = Field(
        default=None,
        exclude_if=lambda at_start: at_start is None,
        description="how likely a failure is at this start, with disturbances as declared",
    )


class FailureCluster(Model):
    """Failing tests of one kind: the same parts of the specification are violated, from starts of one cluster."""

    violated: tuple[str, ...] = Field(description="these parts; empty where the specification is one part")
    tests: int
    starts: dict[str, tuple[float, float]] = Field(description="least and largest value of each parameter")
    start: dict[str, float] = Field(description="of the worst rollout")
    robustness: float = Field(description="of the worst rollout, below 0")
    rollout: str = Field(description="the worst one")
    seed: int
    simplest: Simplest | None = Field(
        default=None, exclude_if=lambda simplest: simplest is None, description="with `falsify.simplest_tests`"
    )


class Failures(Model):
    """The failures of a search that continued after the first one."""

    clusters: tuple[FailureCluster, ...] = Field(description="in the order in which they were found")
    undecided: int = Field(description="failing tests of which it is open whether they are of a cluster")


class RandomTests(Model):
    """The drawn tests of a search, of which no outcome chose a start: how often a random search fails."""

    tests: int
    failures: int
    share: tuple[float, float] = Field(description="bounds of the probability that such a test fails")
    probability: float = Field(description="with which both hold, however the campaign ended")


class ClosestStart(Model):
    """The rollout of least robustness, where none fails."""

    start: dict[str, float]
    robustness: float
    rollout: str
    seed: int


class Search(Model):
    """What the tests of a search show beside its failures."""

    at_random: RandomTests | None = Field(description="with method `sample`, after the first drawn test")
    closest: ClosestStart | None = Field(description="where no test fails")


class Counterexample(Model):
    """The worst rollout of the test that ended the campaign, or of all tests of a search that continued."""

    rollout: str
    test: int
    rollouts: int = Field(description="of this test; where nothing is random, one shows the violation for good")
    start: dict[str, float]
    seed: int
    disturbances: dict[str, DrawnValue] = Field(
        default_factory=dict,
        exclude_if=lambda values: not values,
        description="their values, of a system that declares some",
    )
    robustness: float = Field(description="below 0; clipped, if the campaign has a clip")
    shrunk: Shrunk | None = Field(
        default=None, exclude_if=lambda shrunk: shrunk is None, description="with `falsify.shrink`"
    )
    likeliest: LikeliestFailure | None = Field(
        default=None,
        exclude_if=lambda likeliest: likeliest is None,
        description='with `over = "disturbances"` in `falsify`',
    )
    simplest: Simplest | None = Field(
        default=None,
        exclude_if=lambda simplest: simplest is None,
        description="with `falsify.simplest_tests`, of a search that ended with it",
    )


class CertifiedRegions(Model):
    """The division of the box by the sign of the robustness, or of the risk, at every start of a part.

    All boxes are right at once, and the bound of the problem with them, with `probability`.
    """

    safe: float = Field(description="share of the box where the sign is proven to be positive at every start")
    unsafe: float = Field(description="share of the box where it is proven to be negative at every start")
    undecided: float = Field(description="share of the box where neither is proven")
    probability: float
    unsafe_below: float | None = Field(
        description="value of the bounded objective below which a start is unsafe; null if no value of it proves that"
    )
    checked: int | None = Field(
        description="starts of the spot check in certified boxes; null where values are noisy or there was none"
    )
    contradicted: int | None = Field(description="those of them whose value has another sign, which refutes the norm")
    boxes: int = Field(ge=1, description="rows of `regions.csv`")
    sha256: str = Field(description="digest of `regions.csv`")


class RiskAtStart(Model):
    """The risk of the robustness at the named start of a refuted bound, from fresh rollouts there.

    The refuted bound is one of an expectation below the risk, so that it says nothing of the risk itself. The bounds
    hold together, at the level of the spot check, after any number of rollouts.
    """

    status: Literal["below", "not decided"] = Field(description="whether the risk is shown to be below `limit`")
    rollouts: int = Field(description="fresh ones at this start; not among those of the spot check")
    mean: float = Field(description="upper bound of the expectation")
    deviation: float = Field(description="lower bound of the standard deviation")
    risk: float = Field(description="upper bound of the risk, from these two")


class SpotCheckedProblem(Model):
    """The finding of the spot check for the bound of one problem; `limit` is that bound, in its sense."""

    name: ProblemName
    status: Literal["refuted", "not refuted", "not testable", "beyond"] = Field(
        description="`beyond`: the bound is one of listed starts, and false at others of the box"
    )
    limit: float
    noisy: bool
    rollouts: int = Field(description="that tested this bound, follow-ups included")
    violations: int = Field(description="starts whose first rollout is beyond the limit; of noisy values no refutation")
    violated_share: float | None = Field(
        description="upper bound of the violated share of the box; not of noisy values"
    )
    start: tuple[float, ...] | None = Field(description="a start at which the bound is refuted, if one is known")
    wealth: float | None = Field(description="of the test of noisy values; 1 / level refutes")
    undecided: int | None = Field(description="starts whose noisy values are suspicious, and not refuted")
    requirement: str | None = Field(
        default=None,
        exclude_if=lambda name: name is None,
        description="whose bound is tested; null for that of the whole specification",
    )
    risk: RiskAtStart | None = Field(
        default=None,
        exclude_if=lambda risk: risk is None,
        description="at `start`, where the bound is one of a risk with noise, is refuted, and tests were left",
    )

    @property
    def key(self) -> str:
        """Name of the problem, with that of the requirement behind it where there is one."""
        return self.name if self.requirement is None else f"{self.name}/{self.requirement}"


class MostStarts(Model):
    """A lower bound at all starts of the box but a share, from the rollouts of the spot check; it needs no kernel."""

    share: float
    quantity: Literal["robustness", "expected_robustness"]
    bound: float
    probability: float
    clipped: tuple[float, float] | None = Field(
        default=None, exclude_if=lambda clip: clip is None, description="as of a claim"
    )


class SpotCheck(Model):
    """Fresh uniform starts after the campaign; each statement fails with probability `level` at most."""

    starts: int
    rollouts: Rollouts
    level: float
    failures: int | None = Field(description="starts whose first rollout violates the specification")
    failure_probability: float | None = Field(
        description="upper bound of the probability that a rollout at a uniform start violates the specification"
    )
    most_starts: MostStarts | None = Field(
        description="of the system whose failures are counted; null without a specification, and where noisy values "
        "have no clip or prove no more than it"
    )
    problems: tuple[SpotCheckedProblem, ...]


class Recheck(Model):
    """Recorded rollouts, drawn when the other evidence was fixed and simulated once more."""

    rollouts: int
    agreed: int = Field(description="rollouts that gave the same trajectory, bit by bit")
    unseen_share: float = Field(
        description="if a larger share of all rollouts were irreproducible, the recheck would have shown it with 0.95"
    )


class Sensitivity(Model):
    """A claim with one constant of its kernel problems multiplied by `factor`, or without a control (0), from the same
    tests.

    It is what the last test proves, without the bounds after earlier tests, which may have been stronger.
    """

    claim: int = Field(ge=0, description="number of the claim, from 0")
    constant: Literal["rkhs_norm", "length_scale", "control"]
    factor: float
    bound: float | None = Field(
        description="of the claim's quantity, with its sense and probability; null if the data refute that constant, "
        "or the method gives no bound with it"
    )


class Evidence(Model):
    """The evidence behind the certificate: manifest, hash chain and number of rollouts."""

    manifest_sha256: str
    chain_head: str
    rollouts: int


class Predicate(Model):
    """The content of the certificate."""

    question: dict[str, object] = Field(
        description="system, space, specification, clip, r: the keys of the campaign file that the claims are about"
    )
    campaign: CampaignId
    claims: tuple[CertificateClaim, ...] = Field(min_length=1)
    problems: tuple[ProblemResult, ...]
    composition: CompositionTerms | None
    assumptions: tuple[Assumption, ...]
    counterexample: Counterexample | None = Field(
        default=None, description="of a campaign with `until_counterexample` or `falsify` that found one"
    )
    failures: Failures | None = Field(
        default=None,
        exclude_if=lambda failures: failures is None,
        description="with `falsify.until`, if some test fails",
    )
    search: Search | None = Field(
        default=None, exclude_if=lambda search: search is None, description="of a campaign with `falsify`"
    )
    bounded: Bounded | None = Field(
        default=None,
        exclude_if=lambda bounded: bounded is None,
        description="of a campaign with ranges of disturbances",
    )
    regions: CertifiedRegions | None = Field(
        default=None, description="of a campaign with `regions`, unless the data refute its assumptions"
    )
    spot_check: SpotCheck | None = Field(default=None, description="of a campaign with one")
    recheck: Recheck | None = Field(default=None, description="of a campaign with one")
    evidence: Evidence
    software: dict[str, str]
    rules: int = Field(ge=1, description="of seeds, digests and decisions")
    sensitivity: tuple[Sensitivity, ...] | None = Field(
        default=None, description="the claims that rest on a kernel, with other constants"
    )

    def __repr__(self) -> str:
        """Return campaign, first claim, and the number of refuted assumptions, in one line."""
        claim = self.claims[0]
        text = f"{claim.quantity} {claim.sense} {claim.bound:.6g} with probability at least {claim.probability:.6g}"
        more = f", and {len(self.claims) - 1} more" if len(self.claims) > 1 else ""
        refuted = f"; {len(claim.refuted)} assumptions refuted" if claim.refuted else ""
        clipped = "" if claim.clipped is None else f", clipped to [{claim.clipped[0]:g}, {claim.clipped[1]:g}]"
        return f"<Certificate of {self.campaign.name}: {text}{clipped}{more}{refuted}>"

    __str__ = __repr__


class Certificate(Model):
    """in-toto Statement v1."""

    type_: Literal["https://in-toto.io/Statement/v1"] = Field(default=STATEMENT_TYPE, alias="_type")
    subject: tuple[Subject, ...]
    predicateType: Literal["urn:perfbound:certificate:v1"] = PREDICATE_TYPE  # noqa: N815  (the name in the in-toto specification)
    predicate: Predicate

    def __repr__(self) -> str:
        """Return its content in one line."""
        return repr(self.predicate)

    __str__ = __repr__

    def to_json(self) -> str:
        """Return the one text of this certificate, ending with a newline."""
        value = self.model_dump(mode="json", by_alias=True)
        # What a campaign has not is left out.
        predicate = value["predicate"]
        for part, key in (
            *((predicate, key) for key in ("sensitivity", "counterexample", "regions", "spot_check", "recheck")),
            *((claim, key) for claim in predicate["claims"] for key in OPTIONAL_IN_CLAIM),
            *((problem, "by_clip") for problem in predicate["problems"]),
        ):
            if part[key] is None:
                del part[key]
        return json.dumps(value, sort_keys=True, indent=1, ensure_ascii=True, allow_nan=False) + "\n"


# The DSSE envelope of a signed certificate (https://github.com/secure-systems-lab/dsse, version 1)

PAYLOAD_TYPE = "application/vnd.in-toto+json"
MAX_SIGNATURES = 100


class Signature(Model):
    """One signature; `keyid` is a hint for the choice of a key, and is not signed."""

    keyid: str = Field(default="", max_length=200, description="empty: unknown")
    sig: str = Field(max_length=1000, description="base64; 64 bytes for Ed25519")


class DsseEnvelope(Model):
    """A payload, its type, and its signatures."""

    payload: str = Field(description="base64 of the exact bytes of certificate.json")
    payloadType: str = Field(max_length=200)  # noqa: N815  (the name in the specification)
    # Not strict: JSON has lists and no tuples.
    signatures: tuple[Signature, ...] = Field(strict=False, min_length=1, max_length=MAX_SIGNATURES)
