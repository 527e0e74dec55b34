"""compose.yaml: the schema of the specification, and names that belong together."""

import json
import re
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from tests.unit.deploy.files import DEPLOY, IMAGES, compose, compose_started, dockerfile

SCHEMA = Path(__file__).parents[2] / "fixtures" / "compose-spec" / "compose-spec.json"
FILE = compose()
SERVICES: dict[str, Any] = FILE["services"]


def validator() -> jsonschema.Draft7Validator:
    return jsonschema.Draft7Validator(json.loads(SCHEMA.read_text()))


def test_the_file_is_of_the_specification() -> None:
    validator().validate(FILE)


def test_the_schema_finds_a_wrong_key() -> None:
    with pytest.raises(jsonschema.ValidationError):
        validator().validate({**FILE, "services": {"router": {"image": "a", "readonly": True}}})


@pytest.mark.parametrize("name", SERVICES)
def test_a_service_has_no_rights_beyond_its_work(name: str) -> None:
    service = SERVICES[name]
    assert service["read_only"] is True
    assert service["cap_drop"] == ["ALL"]
    assert service["security_opt"] == ["no-new-privileges:true"]
    assert service["init"] is True
    assert "privileged" not in service
    assert "environment" not in service


@pytest.mark.parametrize("name", SERVICES)
def test_the_files_of_a_command_are_mounted(name: str) -> None:
    service = SERVICES[name]
    secrets = {f"/run/secrets/{each}" for each in service["secrets"]}
    configs = {each["target"] for each in service.get("configs", ())}
    folders = {each.partition(":")[2] for each in service.get("volumes", ())}
    files = {str(path) for path in compose_started()[name].files()}
    assert {each for each in files if not any(each.startswith(f"{folder}/") for folder in folders)} == secrets | configs
    assert set(service["secrets"]) <= set(FILE["secrets"])
    assert {each["source"] for each in service.get("configs", ())} <= set(FILE["configs"])
    assert {each.partition(":")[0] for each in service.get("volumes", ())} <= set(FILE["volumes"])
    assert set(service["networks"]) <= set(FILE["networks"])


def test_nothing_is_declared_in_vain() -> None:
    assert {each for service in SERVICES.values() for each in service["secrets"]} == set(FILE["secrets"])
    used = {each.partition(":")[0] for service in SERVICES.values() for each in service.get("volumes", ())}
    assert used == set(FILE["volumes"])


@pytest.mark.parametrize("name", SERVICES)
def test_services_are_reached_by_their_names(name: str) -> None:
    for each in compose_started()[name].options().get("connect", ()):
        assert re.fullmatch(r"tls/(\w+):\d+", each)
        assert each.partition("/")[2].partition(":")[0] in SERVICES
    assert set(SERVICES[name].get("depends_on", {})) <= set(SERVICES)
    assert all("healthcheck" in SERVICES[other] for other in SERVICES[name].get("depends_on", {}))


def test_images_are_the_targets_of_the_dockerfile() -> None:
    _, stages = dockerfile()
    for service in SERVICES.values():
        build, image = service["build"], service["image"].partition(":")[0]
        assert build["target"] == IMAGES[image]
        assert build["target"] in stages
        assert (DEPLOY / build["context"] / build["dockerfile"]).is_file()


def test_ports_agree() -> None:
    options = {name: started.options() for name, started in compose_started().items()}
    (listen,) = options["router"]["listen"]
    port = listen.rpartition(":")[2]
    assert SERVICES["router"]["ports"] == [f"{port}:{port}"]
    assert f"('127.0.0.1', {port})" in SERVICES["router"]["healthcheck"]["test"][-1]
    web = next(word for word in SERVICES["orchestrator"]["command"] if word.startswith("--web="))
    assert f"http://{web.partition('=')[2]}/healthz" in SERVICES["orchestrator"]["healthcheck"]["test"][-1]


def test_checks_are_python_that_compiles() -> None:
    for service in SERVICES.values():
        if "healthcheck" in service:
            _, program, flag, code = service["healthcheck"]["test"]
            assert (program, flag) == ("python3", "-c")
            compile(code, "healthcheck", "exec")


def test_files_outside_are_those_of_the_authority() -> None:
    """A campaign of this folder, and for each role the three files that `perfbound pki issue` writes."""
    campaign = FILE["configs"]["campaign"]["file"]
    assert (DEPLOY / re.fullmatch(r"\$\{CAMPAIGN:-(.*)\}", campaign)[1]).is_file()  # type: ignore[index]
    for name, secret in FILE["secrets"].items():
        folder, file = re.fullmatch(r"\$\{PKI_HOSTS(?::\?[^}]*)?\}/(\w+)/([\w.-]+)", secret["file"]).groups()  # type: ignore[union-attr]
        role, _, kind = name.partition("-")
        expected = {"": "ca.pem", "certificate": f"{role}.pem", "key": f"{role}-key.pem"}[kind]
        assert (folder, file) == ("router" if name == "ca" else role, expected)
