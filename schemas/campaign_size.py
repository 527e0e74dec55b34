"""The first keys of a campaign file: its name, its seed, and its size, for every problem or for one."""

from pydantic import Field

from .base import Model
from .method_spaces import RESOLUTION
from .problem_models import Problem


class CampaignSize(Model):
    """Name, seed and size of a campaign; a problem may have its own size."""

    name: str = Field(
        pattern=r"^[a-z0-9][a-z0-9_-]{0,63}$",
        description="names the run directory; with `seed`, decides on all seeds",
    )
    seed: int = Field(default=1, ge=0, lt=2**53, description="determines every random choice; `--seed` overrides it")
    window: int = Field(default=1, ge=1, le=10_000, description="tests in flight per problem")
    replicates: int = Field(default=1, ge=1, le=100_000, description="rollouts per test and variant")
    resolution: int = Field(default=RESOLUTION, ge=2, description="lattice nodes per parameter")
    max_tests: int = Field(default=2000, ge=1, le=1_000_000, description="largest number of tests per problem")

    def window_of(self, problem: Problem) -> int:
        """Return the tests in flight of one problem."""
        return problem.window or self.window

    def replicates_of(self, problem: Problem) -> int:
        """Return the rollouts per test and variant of one problem."""
        return problem.replicates or self.replicates

    def resolution_of(self, problem: Problem) -> int:
        """Return the lattice nodes per parameter of one problem."""
        return problem.resolution or self.resolution

    def max_tests_of(self, problem: Problem) -> int:
        """Return the budget of one problem."""
        return problem.max_tests or self.max_tests
