"""Zenoh key expressions, all built here.

    perfbound/<run>/live/worker/<worker>                      liveliness token of a worker
    perfbound/<run>/live/orchestrator/<orchestrator>          liveliness token of the orchestrator
    perfbound/router/<router>                                 liveliness token of a router
    perfbound/<run>/request/<worker>                          assign, cancel, ack, refuse, release, finished, interval
    perfbound/<run>/up/<worker>/state                         heartbeat
    perfbound/<run>/up/<worker>/result/<rollout>/<attempt>    evidence

`<run>` names a campaign database, `<worker>`, `<orchestrator>` and `<router>` name one process each.
"""

import re
import secrets

from ..errors import MessageError, shortened

ROOT = "perfbound"
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
PROCESS = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,99}")
"""A name with its random suffix."""
ANY_ORCHESTRATOR = f"{ROOT}/*/live/orchestrator/*"


def fresh_id(name: str) -> str:
    """Return `name` with a random suffix, unique to one process start.

    Raises:
        ValueError: `name` could not be part of a key.

    """
    if not NAME.fullmatch(name):
        raise ValueError(f"the name {name[:80]!r} is not allowed: 1 to 64 letters, digits, '-' or '_'")
    return f"{name}-{secrets.token_hex(4)}"


def live_worker(run: str, worker: str) -> str:
    """Token of one worker; `*` for all."""
    return f"{ROOT}/{run}/live/worker/{worker}"


def live_orchestrator(run: str, orchestrator: str) -> str:
    """Token of one orchestrator; `*` for all."""
    return f"{ROOT}/{run}/live/orchestrator/{orchestrator}"


def live_router(router: str) -> str:
    """Token of one router; `*` for all."""
    return f"{ROOT}/router/{router}"


def request_key(run: str, worker: str) -> str:
    """Return the key of the requests to one worker."""
    return f"{ROOT}/{run}/request/{worker}"


def state_key(run: str, worker: str) -> str:
    """Heartbeat of one worker; `*` for all."""
    return f"{ROOT}/{run}/up/{worker}/state"


def result_key(run: str, worker: str, rollout: str, attempt: int | str) -> str:
    """Evidence of one attempt; `*` for all."""
    return f"{ROOT}/{run}/up/{worker}/result/{rollout}/{attempt}"


def run_of(key: str) -> str:
    """Return the run of a key."""
    return key.split("/")[1]


def last(key: str) -> str:
    """Return the last chunk of a key: the process of a token."""
    return key.rsplit("/", 1)[1]


def kind_of(key: str) -> str:
    """Return what a token is of: `router`, `orchestrator` or `worker`; of any other key some text."""
    return key.split("/")[-2]


def worker_of(key: str) -> str:
    """Return the worker of an `up` key, or of a worker's token.

    Raises:
        MessageError: it is no name of a worker.

    """
    name = _sender(key)
    if not PROCESS.fullmatch(name):
        raise MessageError("this is no name of a worker")
    return name


def sender_of(key: str) -> str:
    """Return what stands where the worker of a key should, of any text an excerpt."""
    return shortened(_sender(key), 100)


def _sender(key: str) -> str:
    parts = key.split("/")
    return parts[4] if parts[2] == "live" else parts[3]
