"""The policy file of a gate: what a release asks of a certificate."""

import json
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

from packaging.specifiers import InvalidSpecifier, SpecifierSet
from pydantic import BeforeValidator, Field, StringConstraints, ValidationError, field_validator

from ....schemas.amounts import seconds_of
from ....schemas.base import Model
from ....schemas.errors import PerfboundError, meant, shortened
from ....schemas.outside import read_outside
from ....schemas.result.certificate import Status

MAX_POLICY = 2**20
"""Bytes."""
OTHERS = "*"
"""The key under `[assumptions]` for those without a key of their own."""
ONE_OR_MORE = BeforeValidator(lambda given: [given] if isinstance(given, str) else given)
"""Of a list: a text alone is short for a list of it."""


class Policy(Model):
    """The rules of a gate; a key that is left out asks nothing, but for the first two."""

    verdict: Literal["SHOWN", "not VIOLATED", "any"] = Field(
        default="SHOWN", description="the verdict of the campaign; `any` asks nothing"
    )
    verified: bool = Field(
        default=True,
        description="`perfbound verify` passes; without it, everyone with write access to the run directory decides",
    )
    resimulated: int = Field(
        default=0,
        ge=0,
        le=1_000_000,
        description="number of rollouts or batches that are simulated again, and are the same",
    )
    margin: float | None = Field(default=None, description="least bound of a first claim that is a bound from below")
    at_most: float | None = Field(
        default=None, description="largest bound of a first claim that is one from above, as a failure probability"
    )
    probability: float | None = Field(default=None, gt=0, lt=1, description="least probability of the first claim")
    constants: Literal["doubled", "none"] | None = Field(
        default=None,
        description="`doubled`: SHOWN also with twice the norm bound or half the length scales; `none`: the first "
        "claim rests on no constant of a kernel",
    )
    assumptions: dict[str, Annotated[tuple[Status, ...], ONE_OR_MORE, Field(strict=False, min_length=1)]] = Field(
        default_factory=dict,
        description='by id, the allowed statuses of an assumption of the first claim; "*" is for all others',
    )
    spot_check: bool = Field(default=False, description="fresh starts have tested the bounds, and refuted none")
    recheck: bool = Field(default=False, description="recorded rollouts were simulated again, and all were the same")
    requirements: Annotated[tuple[str, ...], ONE_OR_MORE] = Field(
        default=(),
        strict=False,
        max_length=1000,
        description="ids or names of requirements, each of which one of the campaigns shows",
    )
    signed_by: Annotated[tuple[Annotated[str, StringConstraints(min_length=1)], ...], ONE_OR_MORE] = Field(
        default=(), strict=False, max_length=100, description="public keys, each of which has signed; FILE.pub"
    )
    max_age: float | None = Field(
        default=None, gt=0, description='largest time since the last rollout: "36h", "30d" or "2w"'
    )
    software: dict[str, str] = Field(
        default_factory=dict, description='versions of the campaign, { perfbound = ">=0.2,<0.4", numpy = "==2.*" }'
    )

    @property
    def verifies(self) -> bool:
        """Whether certificates are verified."""
        return self.verified or self.resimulated > 0

    @field_validator("max_age", mode="before")
    @classmethod
    def _seconds(cls, given: Any) -> Any:
        if given is None:
            return given
        return seconds_of(given if isinstance(given, str) else "")

    @field_validator("software")
    @classmethod
    def _specifiers(cls, given: dict[str, str]) -> dict[str, str]:
        for name, versions in given.items():
            try:
                SpecifierSet(versions)
            except InvalidSpecifier:
                raise ValueError(f'{name}: {versions!r} is no version specifier, as ">=0.2,<0.4"') from None
        return given


ALLOWED = {name: field.description for name, field in Policy.model_fields.items()}
"""The keys of a policy, and what each asks."""


def load_policy(path: Path) -> Policy:
    """Read a policy file; the paths of its keys become relative to it.

    Raises:
        PerfboundError: it cannot be read, or is no policy; a line for the first fault.

    """
    try:
        table = tomllib.loads(read_outside(path, MAX_POLICY).decode("utf-8-sig"))
        found = Policy.model_validate_json(json.dumps(table, default=str))
    except OSError as error:
        raise PerfboundError(f"{path}: {error.strerror}; give a policy file with --policy") from None
    except ValidationError as error:
        raise PerfboundError(f"{path}: {_fault(error)}") from None
    except (ValueError, TypeError, RecursionError) as error:
        reason = shortened(str(error).partition("\n")[0], 200)
        raise PerfboundError(f"{path}: not TOML: {reason}; fix this line of the policy") from None
    keys = tuple(str(path.parent / each) for each in found.signed_by)
    return found.model_copy(update={"signed_by": keys})


def _fault(error: ValidationError) -> str:
    fault = error.errors(include_url=False)[0]
    key = ".".join(each for each in fault["loc"] if isinstance(each, str))
    if fault["type"] == "extra_forbidden":
        return f"{key}: there is no such key; {meant(key, ALLOWED)}allowed are {', '.join(ALLOWED)}"
    reason = str(fault["ctx"]["error"]) if fault["type"] == "value_error" else str(fault["msg"])
    return f"{key}: {shortened(repr(fault['input']), 80)} is not allowed; {ALLOWED[str(fault['loc'][0])]} ({reason})"
