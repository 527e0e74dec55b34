"""The files for Kubernetes: the schemas of several versions, and names that belong together."""

import copy
import re
from typing import Any

import kubernetes_validate
import pytest

from tests.unit.deploy.files import (
    IMAGES,
    KUBERNETES,
    ROOT,
    kubernetes_started,
    kustomization,
    pods,
    resources,
)

RESOURCES = {f"{each['kind']} {each['metadata']['name']}": each for each in resources()}
PODS = {each["metadata"]["name"]: template for each, template in pods()}
LABELS = {name: template["metadata"]["labels"] for name, template in PODS.items()}
PAGE = ROOT / "docs" / "clusters.md"
VERSIONS = ("1.31", "1.34", "1.37")


def selected(selector: dict[str, Any]) -> set[str]:
    """Return the pods that a selector means."""
    wanted = selector.get("matchLabels", {}).items()
    found = {name for name, labels in LABELS.items() if wanted <= labels.items()}
    for each in selector.get("matchExpressions", ()):
        assert each["operator"] == "In"
        found = {name for name in found if LABELS[name].get(each["key"]) in each["values"]}
    return found


def of_kind(kind: str) -> dict[str, Any]:
    return {each["metadata"]["name"]: each for each in RESOURCES.values() if each["kind"] == kind}


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("name", RESOURCES)
def test_a_resource_is_of_its_schema(name: str, version: str) -> None:
    kubernetes_validate.validate(RESOURCES[name], version, strict=True)


def test_the_schema_finds_a_wrong_key() -> None:
    wrong = copy.deepcopy(RESOURCES["Job workers"])
    wrong["spec"]["template"]["spec"]["containers"][0]["enviroment"] = []
    with pytest.raises(kubernetes_validate.ValidationError):
        kubernetes_validate.validate(wrong, VERSIONS[-1], strict=True)


def test_the_kustomization_has_every_file_and_image() -> None:
    files = {path.name for path in KUBERNETES.glob("*.yaml")} - {"kustomization.yaml"}
    assert set(kustomization()["resources"]) == files
    used = {container["image"] for template in PODS.values() for container in template["spec"]["containers"]}
    assert used == {each["name"] for each in kustomization()["images"]} == set(IMAGES)
    assert kustomization()["namespace"] in of_kind("Namespace")


def test_selectors_mean_one_kind_of_pod() -> None:
    for name, each in of_kind("Deployment").items():
        assert selected(each["spec"]["selector"]) == {name}
    for name, each in of_kind("Service").items():
        assert selected({"matchLabels": each["spec"]["selector"]}) == {name}
    for name, each in of_kind("PodDisruptionBudget").items():
        assert selected(each["spec"]["selector"]) == {name}


@pytest.mark.parametrize("name", PODS)
def test_a_pod_has_no_rights_beyond_its_work(name: str) -> None:
    """What the namespace enforces (restricted), and more."""
    spec = PODS[name]["spec"]
    assert spec["automountServiceAccountToken"] is False
    assert spec["securityContext"]["runAsNonRoot"] is True
    assert spec["securityContext"]["runAsUser"] > 0
    assert spec["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}
    for container in spec["containers"]:
        context = container["securityContext"]
        assert context["readOnlyRootFilesystem"] is True
        assert context["allowPrivilegeEscalation"] is False
        assert context["capabilities"] == {"drop": ["ALL"]}
        assert {"cpu", "memory"} <= set(container["resources"]["requests"])
        assert "memory" in container["resources"]["limits"]


def tls_secrets() -> dict[str, set[str]]:
    """Return the Secrets that the page makes, with their keys; and the ConfigMap."""
    text = PAGE.read_text().replace("\\\n", " ")
    lines = re.findall(r"kubectl create (?:secret generic|configmap) (\S+)(.*)", text)
    return {name: set(re.findall(r"--from-file=([\w.-]+)=", rest)) for name, rest in lines}


@pytest.mark.parametrize("name", PODS)
def test_the_files_of_a_command_are_mounted(name: str) -> None:
    """Out of the Secrets and the ConfigMap that the page on clusters makes."""
    spec = PODS[name]["spec"]
    (container,) = spec["containers"]
    volumes = {each["name"]: each for each in spec["volumes"]}
    mounts = {each["mountPath"]: volumes[each["name"]] for each in container["volumeMounts"]}
    assert len(mounts) == len(volumes)
    assert "/tmp" in mounts
    for path in kubernetes_started()[name].files():
        volume = mounts[str(path.parent)]
        if "persistentVolumeClaim" in volume:
            assert volume["persistentVolumeClaim"]["claimName"] in of_kind("PersistentVolumeClaim")
        else:
            source = volume.get("secret", {}).get("secretName") or volume["configMap"]["name"]
            assert path.name in tls_secrets()[source]


def test_a_key_is_readable_for_the_pod_alone() -> None:
    for template in PODS.values():
        for volume in template["spec"]["volumes"]:
            if "secret" in volume:
                assert volume["secret"]["defaultMode"] == 0o440
        assert template["spec"]["securityContext"]["fsGroup"] == template["spec"]["securityContext"]["runAsUser"]


def test_ports_agree() -> None:
    (listen,) = kubernetes_started()["router"].options()["listen"]
    number = int(listen.rpartition(":")[2])
    (service,) = of_kind("Service").values()
    (port,) = service["spec"]["ports"]
    (container,) = PODS["router"]["spec"]["containers"]
    assert {each["name"]: each["containerPort"] for each in container["ports"]} == {port["targetPort"]: number}
    assert port["port"] == number
    for kind in ("startupProbe", "readinessProbe", "livenessProbe"):
        assert container[kind]["tcpSocket"]["port"] == port["targetPort"]
    for name in ("orchestrator", "workers"):
        assert kubernetes_started()[name].options()["connect"] == (f"tls/{service['metadata']['name']}:{number}",)


def targets_of(peer: dict[str, Any]) -> set[str]:
    """Return the pods that a policy lets others reach; `names` for those that resolve names."""
    return selected(peer["podSelector"]) if "podSelector" in peer else {"names"}


def test_the_network_has_the_port_of_the_router_and_names_alone() -> None:
    (listen,) = kubernetes_started()["router"].options()["listen"]
    router = (("TCP", int(listen.rpartition(":")[2])),)
    policies = {name: each["spec"] for name, each in of_kind("NetworkPolicy").items()}
    denied = policies.pop("deny-all")
    assert denied == {"podSelector": {}, "policyTypes": ["Ingress", "Egress"]}
    incoming, outgoing = set(), set()
    for policy in policies.values():
        for rule in policy.get("ingress", ()):
            ports = tuple((each["protocol"], each["port"]) for each in rule["ports"])
            sources = {pod for each in rule["from"] for pod in selected(each["podSelector"])}
            incoming |= {(pod, source, ports) for pod in selected(policy["podSelector"]) for source in sources}
        for rule in policy.get("egress", ()):
            ports = tuple((each["protocol"], each["port"]) for each in rule["ports"])
            targets = {target for each in rule["to"] for target in targets_of(each)}
            outgoing |= {(pod, target, ports) for pod in selected(policy["podSelector"]) for target in targets}
    names = (("UDP", 53), ("TCP", 53))
    assert incoming == {("router", "orchestrator", router), ("router", "workers", router)}
    assert outgoing == {
        (pod, target, ports)
        for pod in ("orchestrator", "workers")
        for target, ports in (("router", router), ("names", names))
    }


def test_probes_ask_for_paths_of_the_live_page() -> None:
    (container,) = PODS["orchestrator"]["spec"]["containers"]
    web = next(word.partition("=")[2] for word in container["args"] if word.startswith("--web="))
    served = "".join(path.read_text() for path in (ROOT / "orchestrator" / "report" / "web").glob("*.py"))
    for kind, path in (("startupProbe", "/healthz"), ("livenessProbe", "/healthz"), ("readinessProbe", "/readyz")):
        program, flag, code = container[kind]["exec"]["command"]
        assert (program, flag) == ("python3", "-c")
        compile(code, kind, "exec")
        assert f"http://{web}{path}'" in code
        assert f'"{path}"' in served


def test_workers_may_leave_half_at_a_time() -> None:
    workers = of_kind("Job")["workers"]["spec"]
    assert workers["completionMode"] == "Indexed"
    assert workers["completions"] == workers["parallelism"]
    assert of_kind("PodDisruptionBudget")["workers"]["spec"]["minAvailable"] == workers["parallelism"] // 2


def test_a_failure_rule_names_its_container() -> None:
    for name, job in of_kind("Job").items():
        containers = {each["name"] for each in PODS[name]["spec"]["containers"]}
        assert PODS[name]["spec"]["restartPolicy"] == "Never"  # podFailurePolicy needs it
        for rule in job["spec"]["podFailurePolicy"]["rules"]:
            assert rule.get("onExitCodes", {}).get("containerName") in {None, *containers}
