"""Zenoh's access control for a link with certificates: what each common name may send and read; all else is denied.

The names are those of `--allow`. Zenoh takes no rules while it runs, so a new name takes effect at the next start. The
keys of a worker have its name and a random suffix: `NAME-$*` in Zenoh's key expressions.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from ..errors import LinkError
from . import key_expressions

LOCAL = "local"
"""The name of local workers, which show the certificate of their orchestrator."""


def access_rules(allowed: Sequence[str], own: str) -> dict[str, Any]:
    """Return Zenoh's configuration: each of `allowed` speaks in its own name alone, `own` in that of local workers.

    Raises:
        LinkError: a name cannot be one of a worker, or its keys would be among those of another one.

    """
    names = tuple(dict.fromkeys(allowed))
    for name in names:
        _check_name(name, (*names, LOCAL), own)
    prefixes = ({own: LOCAL} if own else {}) | {name: name for name in names}
    return _denied_but({name: _rules_of(name, prefix) for name, prefix in prefixes.items()})


def router_rules(workers: Sequence[str], orchestrators: Sequence[str], routers: Sequence[str]) -> dict[str, Any] | None:
    """Return the rules of a router, for the common names of what connects to it; None where there are no names.

    An orchestrator speaks to all workers, hears them, and may have local ones; another router passes on everything.

    Raises:
        LinkError: a name cannot be one of a worker, or its keys would be among those of another one.

    """
    if not (workers or orchestrators or routers):
        return None
    names = tuple(dict.fromkeys(workers))
    for name in names:
        _check_name(name, (*names, LOCAL), "")
    if twice := (set(names) & {*orchestrators, *routers}) | (set(orchestrators) & set(routers)):
        raise LinkError(f"{min(twice)}: named twice, as one of two kinds; each kind needs certificates of its own")
    rules = {name: _rules_of(name, name) for name in names}
    rules |= {name: [*_rules_of(name, LOCAL), *_rules_of_orchestrator(name)] for name in orchestrators}
    rules |= {name: _rules_of_router(name) for name in routers}
    return _denied_but(rules)


def _denied_but(rules: Mapping[str, Sequence[Mapping[str, Any]]]) -> dict[str, Any]:
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule for each in rules.values() for rule in each],
        "subjects": [{"id": name, "cert_common_names": [name]} for name in rules],
        "policies": [{"subjects": [name], "rules": [rule["id"] for rule in each]} for name, each in rules.items()],
    }


def _check_name(name: str, names: Sequence[str], own: str) -> None:
    if not key_expressions.NAME.fullmatch(name):
        raise LinkError(
            f"--allow {name[:80]!r}: no name of a worker, which has 1 to 64 letters, digits, '-' or '_'; issue a "
            "certificate with such a common name"
        )
    if name in (own, LOCAL):
        raise LinkError(f"--allow {name}: the name of the orchestrator or of its local workers; choose another name")
    for other in names:
        if other.startswith(f"{name}-") or name.startswith(f"{other}-"):
            raise LinkError(f"--allow {name}: its keys are not apart from those of {other!r}; choose another name")


def _rules_of(name: str, prefix: str) -> list[dict[str, Any]]:
    """Return what a worker may do, as its orchestrator's node sees it: in comes what it sends, out what it reads."""
    # By the prefix: a worker's name has a fresh suffix at each start.
    run, worker = "*", f"{prefix}-$*"
    orchestrators = [key_expressions.live_orchestrator(run, "*"), key_expressions.live_router("*")]
    allowed = [
        (
            "ingress",
            ["put"],
            [key_expressions.state_key(run, worker), key_expressions.result_key(run, worker, "*", "*")],
        ),
        ("ingress", ["liveliness_token"], [key_expressions.live_worker(run, worker)]),
        ("ingress", ["declare_subscriber"], [key_expressions.request_key(run, worker)]),
        ("ingress", ["declare_liveliness_subscriber", "liveliness_query"], orchestrators),
        ("egress", ["put"], [key_expressions.request_key(run, worker)]),
        ("egress", ["liveliness_token"], orchestrators),
        (
            "egress",
            ["declare_subscriber"],
            [key_expressions.state_key(run, "*"), key_expressions.result_key(run, "*", "*", "*")],
        ),
        ("egress", ["declare_liveliness_subscriber"], [key_expressions.live_worker(run, "*")]),
    ]
    return _as_rules(name, allowed)


def _rules_of_orchestrator(name: str) -> list[dict[str, Any]]:
    """Return what an orchestrator may do, as a router sees it."""
    run, worker = "*", "*"
    up = [key_expressions.state_key(run, worker), key_expressions.result_key(run, worker, "*", "*")]
    tokens = [key_expressions.live_worker(run, worker), key_expressions.live_router("*")]
    allowed = [
        ("ingress", ["put"], [key_expressions.request_key(run, worker)]),
        ("ingress", ["liveliness_token"], [key_expressions.live_orchestrator(run, "*")]),
        ("ingress", ["declare_subscriber"], up),
        ("ingress", ["declare_liveliness_subscriber", "liveliness_query"], tokens),
        ("egress", ["put"], up),
        ("egress", ["liveliness_token"], tokens),
        ("egress", ["declare_subscriber"], [key_expressions.request_key(run, worker)]),
        ("egress", ["declare_liveliness_subscriber"], [key_expressions.live_orchestrator(run, "*")]),
    ]
    return _as_rules(f"{name} as orchestrator", allowed)


def _rules_of_router(name: str) -> list[dict[str, Any]]:
    """Return what another router may do: it has its own rules for what connects to it."""
    messages = ["put", "declare_subscriber", "liveliness_token", "declare_liveliness_subscriber", "liveliness_query"]
    return _as_rules(name, [(flow, messages, [f"{key_expressions.ROOT}/**"]) for flow in ("ingress", "egress")])


def _as_rules(name: str, allowed: Sequence[tuple[str, Sequence[str], Sequence[str]]]) -> list[dict[str, Any]]:
    return [
        {"id": f"{name} {number}", "permission": "allow", "flows": [flow], "messages": messages, "key_exprs": exprs}
        for number, (flow, messages, exprs) in enumerate(allowed)
    ]
