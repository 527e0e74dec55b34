"""Zenoh sessions: of an orchestrator that listens, of one behind a router, and of a router."""

import math
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any

import zenoh

from ....schemas.errors import LinkError, PerfboundError
from ....schemas.link.configuration import Tls, connect_configs, listen_config, password_line, router_config, with_port
from ....schemas.link.reminder import StateLines
from ....schemas.link.unanswered import UNLINKED, first_opened, no_link

TRIES = 5
"""Free ports that are tried where the endpoint names none."""
IN_USE = "Address already in use"


def listening(
    endpoint: str, tls: Tls | None, *, insecure: bool, secret: bytes | None, access: Mapping[str, Any] | None
) -> tuple[zenoh.Session, str]:
    """Return a session that workers connect to, and its endpoint; port 0 becomes a free one.

    Raises:
        PerfboundError: the endpoint is in use, malformed, or open to others without TLS.

    """
    with _passwords(secret) as passwords:
        configured = partial(listen_config, tls=tls, insecure=insecure, passwords=passwords, access=access)
        session, (chosen,) = _listening_at([endpoint], lambda endpoints: configured(endpoints[0]))
        return session, chosen


def routing(
    endpoints: Sequence[str],
    routers: Sequence[str],
    tls: Tls | None,
    *,
    insecure: bool,
    secret: bytes | None,
    access: Mapping[str, Any] | None,
) -> tuple[zenoh.Session, Sequence[str]]:
    """Return the session of a router, and the endpoints at which it listens; port 0 becomes a free one.

    Raises:
        PerfboundError: an endpoint is in use, malformed, or open to others without TLS.

    """
    with _passwords(secret) as passwords:
        configured = partial(
            router_config,
            routers=routers,
            tls=tls,
            insecure=insecure,
            secret=secret,
            passwords=passwords,
            access=access,
        )
        return _listening_at(endpoints, configured)


def connected(
    endpoints: Sequence[str],
    tls: Tls | None,
    secret: bytes | None,
    print_line: Callable[[str], None],
    patience: float = math.inf,
) -> zenoh.Session:
    """Return a session with the first router that answers, and wait `patience` s for it.

    Raises:
        PerfboundError: an endpoint is malformed, a TLS file is missing, or no router answers for so long.

    """
    try:
        configs = connect_configs(endpoints, tls, secret)
    except LinkError as error:
        raise PerfboundError(str(error)) from None
    reason, end = partial(no_link, endpoints, "orchestrator", tls), time.monotonic() + patience
    lines = StateLines(reason, f"connected to {' or '.join(endpoints)}", print_line, first=UNLINKED)

    def waiting() -> None:
        if time.monotonic() > end:
            raise PerfboundError(reason())
        lines.see(lasts=True)

    session = first_opened(configs, _open, zenoh.ZError, waiting)
    lines.see(lasts=False)
    return session


def _open(config: str) -> zenoh.Session:
    return zenoh.open(zenoh.Config.from_json5(config))


def _listening_at(
    endpoints: Sequence[str], configured: Callable[[Sequence[str]], str]
) -> tuple[zenoh.Session, Sequence[str]]:
    """Return a session that listens at `endpoints`, and those with the ports that it took."""
    tries = TRIES
    while True:
        tries -= 1
        try:
            configured(endpoints)  # its faults first: to choose a port needs a well-formed endpoint
            # Chosen here: Zenoh names the port that it took in its admin space alone, which is closed to us as well.
            chosen = [with_port(endpoint) for endpoint in endpoints]
            return _open(configured(chosen)), chosen
        except LinkError as error:
            raise PerfboundError(str(error)) from None
        except zenoh.ZError as error:
            # Between the choice of a free port and its use, another process may have taken it.
            if not (tries and chosen != list(endpoints) and IN_USE in str(error)):
                raise PerfboundError(_explain(" and ".join(endpoints), str(error))) from None


@contextmanager
def _passwords(secret: bytes | None) -> Iterator[str | None]:
    """Make the file that Zenoh reads passwords from when it opens; it has no name, so no disk keeps it."""
    if secret is None:
        yield None
        return
    with os.fdopen(os.memfd_create("perfbound"), "wb") as file:
        file.write(password_line(secret).encode())
        file.flush()
        yield f"/proc/self/fd/{file.fileno()}"


def _explain(endpoint: str, error: str) -> str:
    if IN_USE in error:
        return f"--listen {endpoint}: this endpoint is in use; choose another port, or 0 for a free one"
    reason = error.split(" at /", maxsplit=1)[0][:300]
    return f"--listen {endpoint}: cannot listen there ({reason}); check the address and the TLS files"
