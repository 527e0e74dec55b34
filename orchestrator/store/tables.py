"""The tables of the campaign database.

A row of `tests`, `rollouts` or `observations` may be that of a block: of consecutive tests, or of a batch of rollouts.
Its numbers are then those of the first of them, or the least or largest of all as its comment says, and the numbers of
each are in its last columns: little-endian arrays (float64, int64, uint64 or bytes). They are NULL in other rows.

Facts are insert-only and share one sequence number: `campaign`, `tests`, `rollouts`, `discards`, `observations`,
`bounds`, `extensions`; a discard moves its row from `rollouts` to `discards`. The nondeterministic part (workers, hosts
and times) is in `attempts`, `outcomes`, `sessions`, `set_aside` and `opinions`, outside the hash chain.
"""

from sqlalchemy import (
    Column,
    ForeignKeyConstraint,
    Integer,
    LargeBinary,
    MetaData,
    Table,
    TableClause,
    Text,
    UniqueConstraint,
    column,
    table,
)
from sqlalchemy.types import REAL

metadata = MetaData()

schema = Table("schema", metadata, Column("version", Integer, primary_key=True), sqlite_strict=True)

campaign = Table(
    "campaign",
    metadata,
    Column("seq", Integer, primary_key=True),
    Column("run", Text, nullable=False),  # random; names the keys of the protocol
    Column("name", Text, nullable=False),
    Column("seed", Integer, nullable=False),
    Column("config", Text, nullable=False),  # canonical JSON
    Column("config_sha256", Text, nullable=False),
    Column("system", Text, nullable=False),  # SystemSpec, canonical JSON
    Column("software", Text, nullable=False),  # versions, canonical JSON
    Column("rules", Integer, nullable=False),  # schemas.result.facts
    sqlite_strict=True,
)

tests = Table(
    "tests",
    metadata,
    Column("seq", Integer, primary_key=True),
    Column("problem", Text, nullable=False),
    Column("test", Integer, nullable=False),
    Column("node", Integer, nullable=False),  # index of z on the lattice
    Column("x", Text, nullable=False),  # z, JSON, units of the parameters
    Column("mu", REAL),
    Column("sigma", REAL),
    Column("beta", REAL),  # NULL for the first test, which nothing chose
    Column("F", REAL),
    Column("tests", Integer, nullable=False, server_default="1"),  # of the block; 1 without one
    Column("nodes", LargeBinary),  # int64, of each test
    Column("starts", LargeBinary),  # float64, z of each test
    UniqueConstraint("problem", "test"),
    sqlite_strict=True,
)

rollouts = Table(
    "rollouts",
    metadata,
    Column("seq", Integer, primary_key=True),
    Column("problem", Text, nullable=False),
    Column("test", Integer, nullable=False),
    Column("variant", Text, nullable=False),
    Column("replicate", Integer, nullable=False),
    Column("seed", Integer, nullable=False),
    Column("sha256", Text, nullable=False),
    Column("size", Integer, nullable=False),  # bytes
    Column("path", Text, nullable=False),  # relative to the run directory
    Column("robustness", REAL),  # clipped; recomputed from the trajectory by `verify`
    Column("by_tolerance", Integer, nullable=False),  # 1 where the tolerance around time stamps could decide its sign
    Column("ended", REAL),  # s at which it ended before the horizon, if it did
    Column("block", Integer, nullable=False),  # first test of its block; its own test without one
    Column("replicates", Integer, nullable=False, server_default="1"),  # of each test in the batch; 1 without one
    Column("places", Integer, nullable=False, server_default="1"),  # rollouts of the batch; 1 without one
    Column("rollouts", Integer, nullable=False, server_default="1"),  # of them, with a trajectory
    Column("violations", Integer, nullable=False, server_default="0"),  # of them, below robustness 0
    Column("seeds", LargeBinary),  # uint64, of each rollout
    Column("digests", LargeBinary),  # 32 bytes each: of the samples alone, zeros for a failed rollout
    Column("robustness_of", LargeBinary),  # float64, NaN for a failed rollout
    Column("by_tolerance_of", LargeBinary),  # a byte each
    Column("ended_of", LargeBinary),  # float64, NaN where it did not end
    Column("kept_of", LargeBinary),  # a byte each: whether the file has its samples; NULL where it has all of them
    Column("failures", Text),  # place in the batch and reason of each failed rollout, JSON
    Column("parts", Text),  # robustness of each part that a search has a model of, JSON; NULL where it models the whole
    # The retry of a rollout that failed in a batch is a batch of its own, perhaps with the same first rollout.
    UniqueConstraint("problem", "test", "variant", "replicate", "places"),
    ForeignKeyConstraint(["problem", "block"], ["tests.problem", "tests.test"]),
    sqlite_strict=True,
)

discards = Table(
    "discards",
    metadata,
    Column("seq", Integer, primary_key=True),
    Column("problem", Text, nullable=False),
    Column("test", Integer, nullable=False),
    Column("variant", Text, nullable=False),
    Column("replicate", Integer, nullable=False),
    Column("seed", Integer, nullable=False),
    Column("sha256", Text, nullable=False),
    Column("size", Integer, nullable=False),  # bytes
    Column("path", Text, nullable=False),  # of the kept file, relative to the run directory
    Column("robustness", REAL),
    Column("recorded", Integer, nullable=False),  # the sequence number that the row of `rollouts` had
    Column("reason", Text, nullable=False),
    UniqueConstraint("problem", "test", "variant", "replicate", "sha256"),
    ForeignKeyConstraint(["problem", "test"], ["tests.problem", "tests.test"]),
    sqlite_strict=True,
)

observations = Table(
    "observations",
    metadata,
    Column("seq", Integer, primary_key=True),
    Column("problem", Text, nullable=False),
    Column("test", Integer, nullable=False),
    Column("y", REAL, nullable=False),  # of the maximised objective J
    Column("each", Text, nullable=False),  # what each replicate contributed, JSON
    Column("chain", Text, nullable=False),  # head of the problem's hash chain after this observation
    Column("tests", Integer, nullable=False, server_default="1"),  # of the block; 1 without one
    Column("y_of", LargeBinary),  # float64, of each test
    Column("each_of", LargeBinary),  # float64, what each replicate of each test contributed
    UniqueConstraint("problem", "test"),
    ForeignKeyConstraint(["problem", "test"], ["tests.problem", "tests.test"]),
    sqlite_strict=True,
)

bounds = Table(
    "bounds",
    metadata,
    Column("seq", Integer, primary_key=True),
    Column("problem", Text, nullable=False),
    Column("test", Integer, nullable=False),  # after which it holds: of a block the last one
    Column("upper", REAL),  # upper bound on max J if the campaign stopped here; NULL where the method has none yet
    Column("lower", REAL),  # its partner; NULL in method paper, which has none
    Column("stopped_by", Text),
    Column("block", Integer, nullable=False),  # first test of its block; its own test without one
    UniqueConstraint("problem", "test"),
    ForeignKeyConstraint(["problem", "block"], ["observations.problem", "observations.test"]),
    sqlite_strict=True,
)

extensions = Table(
    "extensions",
    metadata,
    Column("seq", Integer, primary_key=True),
    Column("number", Integer, nullable=False, unique=True),  # from 1
    Column("budgets", Text, nullable=False),  # [problem, tests at most from now on] of those that continue, JSON
    sqlite_strict=True,
)

attempts = Table(
    "attempts",
    metadata,
    Column("rollout", Text, primary_key=True),
    Column("attempt", Integer, primary_key=True),
    Column("worker", Text, nullable=False),
    Column("host", Text, nullable=False),
    Column("pid", Integer, nullable=False),
    Column("session", Integer, nullable=False),
    Column("started", REAL, nullable=False),  # Unix time, s
    sqlite_strict=True,
)

outcomes = Table(
    "outcomes",
    metadata,
    Column("rollout", Text, primary_key=True),
    Column("attempt", Integer, primary_key=True),
    Column("worker", Text, nullable=False),
    Column("ended", REAL, nullable=False),  # Unix time, s
    Column("outcome", Text, primary_key=True),  # "recorded", or why there is no result; both, if it came late
    Column("cpu_seconds", REAL, nullable=False),
    Column("wall_seconds", REAL, nullable=False),
    Column("kind", Text),  # schemas.failure, of a failed attempt
    sqlite_strict=True,
)

sessions = Table(
    "sessions",
    metadata,
    Column("session", Integer, primary_key=True),
    Column("host", Text, nullable=False),
    Column("pid", Integer, nullable=False),
    Column("started", REAL, nullable=False),  # Unix time, s
    Column("system", Text),  # FILE.py:NAME or campaign file, with its folder, of a system that is not installed
    Column("revision", Text),  # of this folder: the commit, and whether files are changed
    Column("platform", Text, nullable=False),  # schemas.platforms, of the orchestrator
    Column("account", Text),  # name of the user who ran the orchestrator
    Column("options", Text),  # of a `perfbound resume` that waits for the same workers, JSON; no secret is one
    sqlite_strict=True,
)

set_aside = Table(
    "set_aside",
    metadata,
    Column("entry", Integer, primary_key=True),
    Column("session", Integer, nullable=False),
    Column("kind", Text, nullable=False),  # worker or host
    Column("name", Text, nullable=False),
    Column("at", REAL, nullable=False),  # Unix time, s
    Column("seconds", REAL, nullable=False),  # length of the pause; 0 where it ends early
    Column("reason", Text, nullable=False),
    sqlite_strict=True,
)

opinions = Table(
    "opinions",
    metadata,
    Column("entry", Integer, primary_key=True),
    Column("kind", Text, nullable=False),  # compared, outvoted, or reviewed: simulated again for an outvoted worker
    Column("rollout", Text, nullable=False),
    Column("attempt", Integer, nullable=False),
    Column("worker", Text, nullable=False),
    Column("sha256", Text, nullable=False),
    Column("at", REAL, nullable=False),  # Unix time, s
    Column("digests", LargeBinary),  # of a batch that is compared: 32 bytes for each rollout, zeros for a failed one
    sqlite_strict=True,
)

# Views of a reading connection, see `readonly`: a row for each test and each rollout.


def _view(name: str, *columns: str) -> TableClause:
    return table(name, *map(column, columns))


each_test = _view("each_test", "seq", "problem", "test", "node", "x", "mu", "sigma", "beta", "F")
each_observation = _view("each_observation", "seq", "problem", "test", "y", "each", "chain")
each_rollout = _view(
    "each_rollout",
    *("seq", "problem", "test", "variant", "replicate", "seed", "sha256", "size", "path", "robustness"),
    *("by_tolerance", "ended", "batch", "kept", "parts"),
)

FACTS = (campaign, tests, rollouts, discards, observations, bounds, extensions)


def insert_only() -> list[str]:
    """Return the triggers that refuse to change or remove a row."""
    return [
        f"CREATE TRIGGER {table.name}_no_{verb.lower()} BEFORE {verb} ON {table.name} "
        f"BEGIN SELECT RAISE(ABORT, '{table.name} is insert-only'); END"
        for table in (*FACTS, schema, attempts, outcomes, sessions, set_aside, opinions)
        for verb in ("UPDATE", "DELETE")
    ]
