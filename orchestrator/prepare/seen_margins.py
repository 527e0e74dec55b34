"""The robustness of rollouts that enter no certificate: how many violate the specification, and which is the worst."""

from dataclasses import dataclass, field

from ...schemas.file.config import CampaignConfig
from ...schemas.file.draft import CLIP
from ...schemas.file.objectives import OBJECTIVES
from ...schemas.result.known import Violations
from ...schemas.rollout import RolloutRequest
from ...schemas.system import SystemSpec, Variant
from ...schemas.trajectory.trajectory import Trajectory
from ..campaign.observation import Observer
from ..certificate.words.known_text import violations_in_words
from ..certificate.words.refutation_text import margin_words, named_start
from ..store.export_tables import robustness_unit


@dataclass(slots=True)
class SeenMargins:
    """The robustness of rollouts, each once however often it is simulated. Not thread-safe."""

    config: CampaignConfig
    spec: SystemSpec
    _observer: Observer | None = None
    _found: dict[tuple[tuple[float, ...], Variant, int], float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        measured = {OBJECTIVES[problem.name].measured for problem in self.config.problems}
        if self.config.formula is not None and measured != {"column"}:
            self._observer = Observer(self.config.model_copy(update={"clip": CLIP}), self.spec)

    def add(self, request: RolloutRequest, trajectory: Trajectory) -> None:
        """Add a rollout, if there is a specification.

        Raises:
            ValueError: the formula cannot be evaluated on this trajectory.

        """
        margin = None if self._observer is None else self._observer.robustness(trajectory)
        if margin is not None:
            given = zip(self.spec.disturbances, request.disturbances, strict=True) if request.disturbances else ()
            bounded = tuple(value for law, value in given if law.name in self.spec.as_parameters)
            self._found[(*request.x, *bounded), request.variant, request.seed] = margin

    @property
    def violations(self) -> Violations | None:
        """How many rollouts violate the specification, with the worst one in words; None without a robustness."""
        if not self._found:
            return None
        x, variant, seed = worst = min(self._found, key=lambda each: (self._found[each], each))
        units = {each.name: each.unit for each in self.spec.own_parameters}
        units |= {law.name: law.unit for law in self.spec.disturbances if law.name in self.spec.as_parameters}
        start = named_start(dict(zip(units, x, strict=True)), units)
        of_several = f", variant {variant}" if len(self.spec.variants) > 1 else ""
        drawn = f", seed {seed}" if variant in self.spec.noisy else ""
        below = [place for place, _, _ in (each for each in self._found if self._found[each] < 0.0)]
        return Violations(
            rollouts=len(self._found),
            violations=len(below),
            starts=len({place for place, _, _ in self._found}),
            violating_starts=len(set(below)),
            least=self._found[worst],
            rollout=f"{start}{of_several}{drawn}",
        )

    @property
    def words(self) -> str:
        """The same in one sentence; empty without a robustness."""
        seen = self.violations
        if seen is None or seen.least is None:
            return ""
        worst = margin_words(seen.least, robustness_unit(self.config, self.spec))
        return f"{violations_in_words(seen)}; the worst {worst} at {seen.rollout}"
