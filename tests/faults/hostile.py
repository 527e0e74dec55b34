"""A hostile peer: raw Zenoh on the endpoint of an orchestrator until SIGTERM, without the secret of the campaign.

With the password of the link, as an eavesdropper could have it, it overhears all messages. Either way it knows every
name and number, from the database, and it sends, at a bounded rate, messages in the names of all others and of a worker
of its own, with seals that it has overheard. What is its own has the mark `forged`.
"""

import contextlib
import hashlib
import itertools
import json
import os
import random
import signal
import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
import zenoh

from perfbound.schemas import __version__
from perfbound.schemas.batch import BatchRequest, read_request
from perfbound.schemas.link import key_expressions
from perfbound.schemas.link.messages import PROTOCOL
from perfbound.schemas.trajectory.batch import Batch, encode_batch
from perfbound.schemas.trajectory.trajectory import Trajectory, encode
from tests.end_to_end.processes import query, under_way

RATE = 200
"""Messages a second."""
LOOK = 0.1
"""Seconds between two looks at the database, which tells what a peer with a better ear would know."""
HEARD = 400
NAME = "forged-0badc0de"
ROOM = 256 * 1024
"""Bytes of the largest garbage."""
REASON = "forged: this worker is not needed"


class Peer:
    """What the peer knows and sends; one thread sends, Zenoh's threads listen."""

    def __init__(self, directory: Path, other: Path, seed: int) -> None:
        self.directory, self.chance = directory, random.Random(seed)
        self.run = str(query(directory, "SELECT run FROM campaign")[0][0])
        self.system = json.loads(str(query(directory, "SELECT system FROM campaign")[0][0]))
        self.seals: deque[bytes] = deque(maxlen=HEARD)
        self.heard: deque[tuple[str, bytes, bytes | None]] = deque(maxlen=HEARD)
        self.requests: deque[dict[str, Any]] = deque(maxlen=20)
        self.state: dict[str, Any] = {}
        self.busy: list[tuple[str, int, str, int]] = []
        self.looked = 0.0
        rows = query(other, "SELECT path, sha256 FROM rollouts")
        self.foreign = [(Path(str(path)).stem, str(sha256), other / str(path)) for path, sha256 in rows]
        self.session: zenoh.Session | None = None
        self.declared: list[Any] = []

    def join(self, endpoint: str, link: dict[str, str] | None) -> None:
        """Connect, listen to everything, and show the tokens of a worker and of older orchestrators."""
        config = {
            "mode": "client",
            "connect": {"endpoints": [endpoint], "timeout_ms": 500, "exit_on_failure": True},
            "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
            "transport": {"shared_memory": {"enabled": False}, **({"auth": {"usrpwd": link}} if link else {})},
        }
        self.session = session = zenoh.open(zenoh.Config.from_json5(json.dumps(config)))
        self.declared = [session.declare_subscriber(f"{key_expressions.ROOT}/**", self._hear)]
        tokens = [key_expressions.live_worker(self.run, NAME)]
        tokens += [key_expressions.live_orchestrator(run, "0000000000000-forged") for run in (self.run, "forged")]
        self.declared += [session.liveliness().declare_token(token) for token in tokens]

    def leave(self) -> None:
        """Close the session."""
        if self.session is not None:
            self.session.close()  # type: ignore[no-untyped-call]
            self.session = None

    def _hear(self, sample: zenoh.Sample) -> None:
        key, payload = str(sample.key_expr), sample.payload.to_bytes()
        attachment = sample.attachment.to_bytes() if sample.attachment is not None else None
        if b"forged" in payload or NAME in key:
            return
        self.heard.append((key, payload, attachment))
        if seal := (attachment or b"").partition(b"{")[0]:
            self.seals.append(seal)
        with contextlib.suppress(ValueError, KeyError, TypeError):
            found = json.loads(payload)
            if "/request/" in key:
                self.requests.append({**found["request"], "attempt": found["attempt"]})
            elif key.endswith("/state"):
                self.state = dict(found)

    def act(self, endpoint: str, link: dict[str, str] | None) -> None:
        """Send one message, of a random kind for which there is something to send."""
        if self.session is None:
            self.join(endpoint, link)
        if time.monotonic() - self.looked > LOOK:
            self.busy = [(str(r), int(str(a)), str(w), int(str(p))) for r, a, w, p in under_way(self.directory)]
            self.looked = time.monotonic()
        kinds: tuple[Callable[[], bool], ...] = (
            *(self._failure, self._result, self._foreign, self._request, self._heartbeat),
            *(self._replay, self._garbage, self._deletion),
        )
        while not self.chance.choice(kinds)():
            pass

    def _put(self, key: str, payload: bytes, attachment: bytes | None = None) -> bool:
        assert self.session is not None
        if self.seals and self.chance.random() < 0.5:
            attachment = self.chance.choice(list(self.seals)) + (attachment or b"")
        # DROP: who floods does not wait for the reader.
        self.session.put(key, payload, attachment=attachment, congestion_control=zenoh.CongestionControl.DROP)
        return True

    def _end(self, rollout: str, attempt: int, worker: str, payload: bytes = b"", **header: Any) -> bool:
        """Send the end of an attempt in the name of `worker`."""
        digest = hashlib.sha256(payload).hexdigest() if payload else ""
        told = {"rollout": rollout, "attempt": attempt, "worker": worker, "sha256": digest, **header}
        return self._put(
            key_expressions.result_key(self.run, worker, rollout, attempt), payload, json.dumps(told).encode()
        )

    def _failure(self) -> bool:
        for rollout, attempt, worker, _ in self.busy:
            kind = self.chance.choice(("system", "infrastructure"))
            number = attempt + self.chance.choice((0, 0, 0, 1, -1))
            self._end(rollout, number, worker, outcome="failed", kind=kind, error="forged: the system has failed")
        return bool(self.busy)

    def _result(self) -> bool:
        """A trajectory that answers the request, and is false."""
        if not self.requests:
            return False
        request = dict(self.chance.choice(list(self.requests)))
        attempt = request.pop("attempt")
        columns = tuple(column["name"] for column in self.system["columns"])
        units = {column["name"]: column["unit"] for column in self.system["columns"]}
        asked = read_request(json.dumps(request))
        plain = asked.model_dump(mode="json")
        if isinstance(asked, BatchRequest):
            batch = Batch(columns, np.zeros(1), np.zeros((len(columns) - 1, len(asked), 1)))
            payload = encode_batch(batch, request=plain, metadata=asked.metadata)
        else:
            samples = np.zeros((1, len(columns)))
            payload = encode(Trajectory(columns, samples), request=plain, metadata=asked.metadata, units=units)
        owners = [worker for found, _, worker, _ in self.busy if found == asked.rollout]
        return self._end(asked.rollout, attempt, self.chance.choice([*owners, NAME]), payload, outcome="done")

    def _foreign(self) -> bool:
        """A result of another campaign on the same file."""
        rollout, sha256, path = self.chance.choice(self.foreign)
        for open_rollout, attempt, worker, _ in [*self.busy, (rollout, 1, NAME, 0)]:
            self._end(open_rollout, attempt, worker, path.read_bytes(), outcome="done", sha256=sha256)
        return True

    def _request(self) -> bool:
        """A message in the name of the orchestrator."""
        for rollout, attempt, worker, _ in self.busy:
            named = {"rollout": rollout, "attempt": attempt}
            message: dict[str, Any] = self.chance.choice(
                ({"type": "refuse", "reason": REASON}, {"type": "cancel", **named}, {"type": "ack", **named})
            )
            if self.requests and self.chance.random() < 0.25:
                request = dict(self.chance.choice(list(self.requests)))
                kind = "assign_batch" if "seeds" in request else "assign"
                message = {"type": kind, "attempt": request.pop("attempt") + 1, "request": request}
            self._put(key_expressions.request_key(self.run, worker), json.dumps(message).encode())
        return bool(self.busy)

    def _heartbeat(self) -> bool:
        """A heartbeat of its own worker with the process id of another one, or of another worker, or of no sense."""
        pids = [pid for *_, pid in self.busy] or [os.getpid()]
        state = {
            "protocol": PROTOCOL,
            "version": __version__,
            "worker": NAME,
            "host": os.uname().nodename,
            "pid": self.chance.choice(pids),
            "systems": self.state.get("systems", {}),
            "state": "idle",
        }
        name, odd = NAME, self.chance.random()
        if odd < 0.2:
            state |= {"pid": 2**70}
        elif odd < 0.5 and self.busy:
            rollout, attempt, name, _ = self.chance.choice(self.busy)
            state |= {
                "worker": name,
                "rollout": rollout,
                "attempt": attempt,
                "progress": 10 ** self.chance.randrange(30),
            }
        return self._put(key_expressions.state_key(self.run, name), json.dumps(state).encode())

    def _replay(self) -> bool:
        if not self.heard:
            return False
        assert self.session is not None
        key, payload, attachment = self.chance.choice(list(self.heard))
        self.session.put(key, payload, attachment=attachment)
        return True

    def _garbage(self) -> bool:
        worker = self.chance.choice([NAME, *(worker for _, _, worker, _ in self.busy)])
        size = self.chance.choice((0, 1, 100, 70_000, ROOM))
        payload = self.chance.choice((self.chance.randbytes(size), b"[" * size, b'{"pid": ' + b"9" * size))
        key = self.chance.choice(
            (
                key_expressions.state_key(self.run, worker),
                key_expressions.request_key(self.run, worker),
                key_expressions.result_key(self.run, worker, f"maximum.{10**12}.true.0", 10**12),
                key_expressions.result_key(self.run, worker, "maximum.0.true.0", 1),
            )
        )
        return self._put(key, payload, self.chance.choice((None, payload[:100_000], b"{}")))

    def _deletion(self) -> bool:
        assert self.session is not None
        names = [worker for _, _, worker, _ in self.busy] or [NAME]
        worker = self.chance.choice(names)
        self.session.delete(
            self.chance.choice(
                (key_expressions.live_worker(self.run, worker), key_expressions.state_key(self.run, worker))
            )
        )
        return True


@click.command()
@click.argument("endpoint")
@click.argument("directory", type=click.Path(path_type=Path))
@click.option("--other", type=click.Path(path_type=Path), help="The run directory of another campaign.")
@click.option("--seed", type=int)
@click.option("--link", type=json.loads, default=None, help="User and password of the link, as JSON.")
@click.option("--rate", type=float, default=RATE, help="Messages a second; 0 is as many as it can.")
def main(*, endpoint: str, directory: Path, other: Path, seed: int, link: dict[str, str] | None, rate: float) -> None:
    """Disturb the campaign in DIRECTORY, whose orchestrator listens at ENDPOINT; print how many messages it took."""
    over = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: over.set())
    peer, sent = Peer(directory, other, seed), itertools.count()
    try:
        while not over.wait(1 / rate if rate else 0):
            next(sent)
            try:
                peer.act(endpoint, link)
            except zenoh.ZError:  # refused, or the orchestrator is away: this counts, and is tried again
                peer.leave()
    finally:
        peer.leave()  # a session that is open would keep the process alive
    click.echo(next(sent))


if __name__ == "__main__":
    main()
