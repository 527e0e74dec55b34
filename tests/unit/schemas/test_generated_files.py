"""The files generated from the models: all are current."""

import json
import tomllib
from pathlib import Path

import jsonschema
import pytest

from perfbound.schemas.__main__ import FOLDER, REFERENCE, texts
from perfbound.schemas.file.reader import parse_campaign
from perfbound.schemas.file.reference import page

CAMPAIGNS = sorted((Path(__file__).parents[3] / "deploy" / "campaigns").glob("*.toml"))


@pytest.mark.rest
def test_json_schemas_are_current() -> None:
    assert {path.name: path.read_text() for path in FOLDER.glob("*.json")} == texts(), "run `make schemas`"


def test_reference_page_is_current() -> None:
    assert REFERENCE.read_text() == page(), "run `make schemas`"


@pytest.mark.parametrize("path", CAMPAIGNS, ids=lambda path: path.stem)
def test_every_campaign_file_is_valid(path: Path) -> None:
    assert parse_campaign(path.read_bytes(), path.name).name == path.stem
    schema = json.loads((FOLDER / "campaign.json").read_text())
    jsonschema.validate(tomllib.loads(path.read_text()), schema)


@pytest.mark.parametrize("path", CAMPAIGNS, ids=lambda path: path.stem)
def test_every_campaign_file_has_one_key_a_line_and_ascii_only(path: Path) -> None:
    text = path.read_text()
    assert text.isascii()
    assert all(len(line) <= 120 for line in text.splitlines())


def test_json_schema_refuses_what_the_model_refuses() -> None:
    schema = json.loads((FOLDER / "campaign.json").read_text())
    table = tomllib.loads(CAMPAIGNS[0].read_text())
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**table, "seeed": 1}, schema)
