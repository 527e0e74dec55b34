"""The deployment files as data: the stages of the Dockerfile, and what every one of the others starts."""

import re
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import click
import yaml

import perfbound.orchestrator.cli  # all commands register
from perfbound.orchestrator.cli.group import cli
from perfbound.workers.cli import serve

ROOT = Path(__file__).parents[3]
DEPLOY = ROOT / "deploy"
KUBERNETES = DEPLOY / "kubernetes"
UNITS = DEPLOY / "systemd"
SCRIPT = "run-or-resume"


@dataclass(frozen=True)
class Instruction:
    """An instruction of a Dockerfile, with its line breaks joined."""

    keyword: str
    text: str


@dataclass
class Stage:
    """A stage of the Dockerfile."""

    name: str
    base: str
    instructions: list[Instruction] = field(default_factory=list)

    def of(self, keyword: str) -> list[str]:
        """Return the texts of its instructions with this keyword."""
        return [each.text for each in self.instructions if each.keyword == keyword]


def dockerfile() -> tuple[dict[str, str], dict[str, Stage]]:
    """Return the arguments before the first stage, and the stages."""
    lines = [line for line in (DEPLOY / "Dockerfile").read_text().splitlines() if not line.startswith("#")]
    arguments: dict[str, str] = {}
    stages: dict[str, Stage] = {}
    for line in re.sub(r"\\\n", " ", "\n".join(lines)).splitlines():
        if not line.strip():
            continue
        keyword, _, text = line.partition(" ")
        if keyword == "FROM":
            found = re.fullmatch(r"(\S+) AS (\S+)", text)
            assert found, f"a stage without a name: {line}"
            stage = stages[found[2]] = Stage(found[2], found[1])
        elif keyword == "ARG" and not stages:
            name, _, value = text.partition("=")
            arguments[name] = value
        else:
            stage.instructions.append(Instruction(keyword, " ".join(text.split())))
    return arguments, stages


@dataclass(frozen=True)
class Started:
    """A process that a deployment file starts."""

    place: str
    arguments: tuple[str, ...]
    grace: float
    """Seconds between SIGTERM and SIGKILL."""

    def commands(self) -> list[tuple[str, ...]]:
        """Return the commands of ours that this comes to: two, where it begins a campaign or continues it."""
        program, *rest = self.arguments
        if program != SCRIPT:
            return [self.arguments]
        campaign, directory, *options = rest
        return [
            ("perfbound", "orchestrate", campaign, "--out", directory, *options),
            ("perfbound", "resume", directory, "--workers", "0", *options),
        ]

    def options(self) -> dict[str, Any]:
        """Return the values of the options, by the names that the command has for them."""
        return {name: value for command in self.commands() for name, value in parsed(command).items()}

    def files(self) -> list[Path]:
        """Return the files and folders that the command line names."""
        words = [word.partition("=")[2] if word.startswith("--") else word for word in self.arguments]
        return [Path(word) for word in words if word.startswith(("/", "%"))]


def parsed(line: tuple[str, ...]) -> dict[str, Any]:
    """Return the options and arguments of a command line, converted as the real command does; nothing is run.

    Raises:
        click.UsageError: an option does not exist, has no such value, or is missing.

    """
    program, *rest = line
    command: click.Command = serve
    if program == "perfbound":
        assert rest[0] in cli.commands, f"no command {rest[0]} of {perfbound.__name__}"
        command = cli.commands[rest.pop(0)]
    else:
        assert program == "perfbound-worker", program
    # click keeps the help option that a command had first, and other tests read it.
    context = click.Context(command, info_name=program, help_option_names=["-h", "--help"])
    given, beyond, _ = command.make_parser(context).parse_args(list(rest))
    assert not beyond, f"too many words: {beyond}"
    found = {}
    for each in command.params:
        assert each.name is not None
        value = given.get(each.name)
        if isinstance(value, str | bool | list | tuple):
            # By the name of the option: that of the function's parameter may be another.
            flag = max(each.opts, key=len).lstrip("-").replace("-", "_")
            found[flag] = each.type_cast_value(context, value)
        elif each.required:
            raise click.MissingParameter(ctx=context, param=each)
    return found


def entrypoint(target: str) -> list[str]:
    """Return the words of the entrypoint of an image."""
    _, stages = dockerfile()
    (found,) = stages[target].of("ENTRYPOINT")
    return list(yaml.safe_load(found))


def compose() -> dict[str, Any]:
    """Return compose.yaml."""
    return dict(yaml.safe_load((DEPLOY / "compose.yaml").read_text()))


def compose_started() -> dict[str, Started]:
    """Return what each service of compose.yaml starts."""
    found = {}
    for name, service in compose()["services"].items():
        first = service.get("entrypoint") or entrypoint(service["build"]["target"])
        grace = float(service["stop_grace_period"].removesuffix("s"))
        found[name] = Started(f"compose.yaml: {name}", (*first, *service["command"]), grace)
    return found


def resources() -> list[dict[str, Any]]:
    """Return what the kustomization consists of."""
    listed = kustomization()["resources"]
    return [each for name in listed for each in yaml.safe_load_all((KUBERNETES / name).read_text())]


def kustomization() -> dict[str, Any]:
    """Return kustomization.yaml."""
    return dict(yaml.safe_load((KUBERNETES / "kustomization.yaml").read_text()))


def pods() -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Yield each resource that makes pods, and their template."""
    for each in resources():
        if "template" in each.get("spec", {}):
            yield each, each["spec"]["template"]


IMAGES = {"perfbound": "orchestrator", "perfbound-worker": "worker"}
"""Of an image its target in the Dockerfile."""


def kubernetes_started() -> dict[str, Started]:
    """Return what each container of Kubernetes starts."""
    found = {}
    for each, template in pods():
        (container,) = template["spec"]["containers"]
        first = container.get("command") or entrypoint(IMAGES[container["image"]])
        words = (*first, *container["args"])
        name = each["metadata"]["name"]
        found[name] = Started(f"kubernetes: {name}", words, template["spec"]["terminationGracePeriodSeconds"])
    return found


def unit(path: Path) -> Mapping[str, list[str]]:
    """Return the settings of the section Service of a unit."""
    found: dict[str, list[str]] = {}
    text = re.sub(r"\\\n\s*", "", path.read_text()).partition("[Service]")[2].partition("[Install]")[0]
    for line in text.splitlines():
        if line and not line.startswith("#"):
            name, _, value = line.partition("=")
            found.setdefault(name, []).append(value)
    return found


def systemd_started() -> dict[str, Started]:
    """Return what each unit starts."""
    found = {}
    for path in sorted(UNITS.glob("*.service")):
        settings = unit(path)
        (line,) = settings["ExecStart"]
        words = shlex.split(line)
        program = (Path(words[0]).name, *words[1:])
        found[path.name] = Started(path.name, program, float(settings["TimeoutStopSec"][0]))
    return found


def everything() -> list[Started]:
    """Return all that the deployment files start."""
    return [*compose_started().values(), *kubernetes_started().values(), *systemd_started().values()]
