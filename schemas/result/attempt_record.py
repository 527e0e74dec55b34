"""The record of the attempts behind a certificate, `attempts.json`: an in-toto statement about its bytes."""

from typing import Literal

from pydantic import Field

from ..base import Model, canonical_json
from .certificate import STATEMENT_TYPE, Subject

MAX_RECORD = 2**16
"""Bytes; there are four tables."""
TABLES = ("attempts", "outcomes", "opinions", "set_aside")
"""Of the database: who simulated what, and how it ended. Other workers and other times fill them otherwise."""


class TableDigest(Model):
    """The first rows of a table, in the order in which they were written."""

    rows: int = Field(ge=0)
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")


class AttemptRecord(Model):
    """in-toto Statement v1."""

    type_: Literal["https://in-toto.io/Statement/v1"] = Field(default=STATEMENT_TYPE, alias="_type")
    subject: tuple[Subject, ...] = Field(min_length=1, max_length=1, description="the certificate")
    predicateType: Literal["urn:perfbound:attempts:v1"] = "urn:perfbound:attempts:v1"  # noqa: N815  (in-toto's name)
    predicate: dict[str, TableDigest] = Field(description="by the name of the table")

    def to_json(self) -> str:
        """Return the one text of this record, ending with a newline."""
        return canonical_json(self.model_dump(mode="json", by_alias=True)) + "\n"
