"""`python -m perfbound.schemas`: the generator of the JSON Schemas of the borders and of the reference page."""

import json
from pathlib import Path

from pydantic import BaseModel, TypeAdapter

from .file.config import CampaignConfig
from .file.defaults import file_schema
from .file.reference import page
from .link.messages import (
    Ack,
    Assign,
    Cancel,
    HeartbeatInterval,
    Refuse,
    Release,
    ResultHeader,
    RunFinished,
    WorkerState,
)
from .result.certificate import Certificate
from .result.comparison import Comparison
from .result.known import KnownCampaign
from .rollout import RolloutRequest
from .system import SystemSpec

FOLDER = Path(__file__).resolve().parent / "json" / "v1"
REFERENCE = Path(__file__).resolve().parents[1] / "docs" / "reference.md"
MODELS: dict[str, type[BaseModel]] = {
    "campaign": CampaignConfig,
    "certificate": Certificate,
    "comparison": Comparison,
    "status": KnownCampaign,
    "system": SystemSpec,
    "rollout-request": RolloutRequest,
    "assign": Assign,
    "cancel": Cancel,
    "ack": Ack,
    "refuse": Refuse,
    "release": Release,
    "finished": RunFinished,
    "heartbeat-interval": HeartbeatInterval,
    "worker-state": WorkerState,
    "result-header": ResultHeader,
}


def texts() -> dict[str, str]:
    """Return file name and content of every schema."""
    schemas = {name: TypeAdapter(model).json_schema(by_alias=True) for name, model in MODELS.items()}
    schemas["campaign"] = file_schema()
    return {f"{name}.json": json.dumps(each, indent=2, sort_keys=True) + "\n" for name, each in schemas.items()}


if __name__ == "__main__":
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name, text in texts().items():
        (FOLDER / name).write_text(text)
    REFERENCE.write_text(page())
