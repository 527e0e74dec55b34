"""The Dockerfile beside the project: its sources, its versions, and what the image of a worker leaves out."""

import importlib.metadata
import re
import shlex
import tomllib
from fnmatch import fnmatch
from typing import Any

import grimp
import pytest
import yaml

from tests.unit.deploy.files import DEPLOY, IMAGES, ROOT, SCRIPT, dockerfile, entrypoint

ARGUMENTS, STAGES = dockerfile()
TARGETS = sorted(IMAGES.values())
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text())
LOCK = (ROOT / "locks" / "3.11.txt").read_text()


def lineage(target: str) -> list[str]:
    """Return the stages that an image is made of, by FROM alone, the first one first."""
    base = STAGES[target].base
    return [*(lineage(base) if base in STAGES else []), target]


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def test_the_base_is_pinned_by_its_digest() -> None:
    assert re.fullmatch(r"python:3\.11-slim-bookworm@sha256:[0-9a-f]{64}", ARGUMENTS["BASE"])
    assert all(stage.base in STAGES or stage.base == "${BASE}" for stage in STAGES.values())


def test_sources_are_in_the_context() -> None:
    ignored = [line for line in (ROOT / ".dockerignore").read_text().splitlines() if line and line[0] != "#"]
    kept = [line.removeprefix("!") for line in ignored if line.startswith("!")]
    assert ignored[0] == "*"
    used = set()
    for stage in STAGES.values():
        for text in stage.of("COPY"):
            words = [word for word in text.split() if not word.startswith("--")]
            if "--from=" in text:
                assert re.findall(r"--from=(\S+)", text)[0] in STAGES
                continue
            for source in words[:-1]:
                assert (ROOT / source).exists(), source
                assert any(fnmatch(source, each) for each in kept), f"{source} is not in the context"
                used.add(source)
    assert used == set(kept)


@pytest.mark.parametrize("target", TARGETS)
def test_an_image_runs_its_command_as_a_user_without_rights(target: str) -> None:
    stages = [STAGES[name] for name in lineage(target)]
    users = [text for stage in stages for text in stage.of("USER")]
    assert users
    assert all(re.fullmatch(r"[1-9]\d*:[1-9]\d*", each) for each in users)
    (program,) = entrypoint(target)
    assert program in PROJECT["project"]["scripts"]
    for name in ("ENTRYPOINT", "CMD"):
        assert isinstance(yaml.safe_load(STAGES[target].of(name)[0]), list), f"{name} is not in exec form"
    assert any(text == "SIGTERM" for stage in stages for text in stage.of("STOPSIGNAL"))


@pytest.mark.parametrize("target", TARGETS)
def test_an_image_gets_nothing_but_the_environment_of_the_builder(target: str) -> None:
    """No tools to build with: what its own stages run installs nothing."""
    runs = [text for name in lineage(target) for text in STAGES[name].of("RUN")]
    copies = [text for name in lineage(target) for text in STAGES[name].of("COPY")]
    assert not re.search(r"\b(apt-get|pip|curl|wget)\b", " ".join(runs))
    assert [text.split()[-1] for text in copies] == ["/opt/perfbound"]


def test_every_package_is_checked_by_its_hash() -> None:
    installs = [
        part
        for stage in STAGES.values()
        for run in stage.of("RUN")
        for part in re.split(r"&&", run)
        if " install " in part and "pip" in part
    ]
    assert len(installs) == 3
    for each in installs:
        assert "--no-cache-dir" in each
        assert "--require-hashes" in each or each.strip().endswith("--no-deps dist/*.whl")
    assert "trusted-host" not in (DEPLOY / "Dockerfile").read_text()


def test_versions_are_those_of_the_project() -> None:
    version = PROJECT["project"]["version"]
    texts = " ".join(text for stage in STAGES.values() for text in stage.of("LABEL"))
    assert f'org.opencontainers.image.version="{version}"' in texts
    files = [DEPLOY / "Dockerfile", DEPLOY / "compose.yaml", DEPLOY / "kubernetes" / "kustomization.yaml"]
    for path in files:
        tags = re.findall(r"perfbound(?:-worker)?:(\d[\w.]*)|newTag: (\S+)", path.read_text())
        assert tags
        assert {first or second.rstrip(" }") for first, second in tags} == {version}
    (requirement,) = PROJECT["build-system"]["requires"]
    assert (DEPLOY / "build.txt").read_text().splitlines()[1].split()[0] == requirement


def test_paths_of_the_image_are_made_in_it() -> None:
    environment = dict(pair.split("=", 1) for text in STAGES["runtime"].of("ENV") for pair in shlex.split(text))
    assert environment["PATH"].split(":")[0] == "/opt/perfbound/bin"
    assert {"HOME", "XDG_STATE_HOME", "MPLCONFIGDIR"} <= set(environment)
    assert all(environment[name].startswith("/tmp") for name in ("HOME", "XDG_STATE_HOME", "MPLCONFIGDIR"))
    (folder,) = STAGES["runtime"].of("WORKDIR")
    assert any(run.endswith(folder) for run in STAGES["runtime"].of("RUN"))
    (script,) = [text for text in STAGES["builder"].of("COPY") if SCRIPT in text]
    assert script.split()[-1] == f"/opt/perfbound/bin/{SCRIPT}"


def without() -> set[str]:
    """Return the packages that the image of a worker leaves out."""
    (run,) = STAGES["worker-packages"].of("RUN")
    return {normal(name) for name in run.partition("--yes")[2].partition("&&")[0].split()}


def test_a_worker_imports_nothing_that_its_image_leaves_out() -> None:
    locked = {normal(name) for name in re.findall(r"^([\w.-]+)==", LOCK, re.MULTILINE)}
    assert without() <= locked
    graph = grimp.build_graph("perfbound", include_external_packages=True)
    modules = {name for name in graph.find_upstream_modules("perfbound.workers", as_package=True) if "." not in name}
    providers = importlib.metadata.packages_distributions()
    needed = {normal(each) for name in modules for each in providers.get(name, ())}
    assert "click" in needed
    assert not closure(needed | {"pybullet"} & locked) & without()


def closure(names: set[str]) -> set[str]:
    """Return packages with all that they require here."""
    found: set[str] = set()
    waiting = list(names)
    while waiting:
        name = waiting.pop()
        if name in found:
            continue
        found.add(name)
        try:
            required = importlib.metadata.requires(name) or []
        except importlib.metadata.PackageNotFoundError:
            continue
        waiting += [normal(re.split(r"[^\w.-]", each)[0]) for each in required if "extra ==" not in each]
    return found - {"perfbound"}
