"""The link of an orchestrator to its workers: an endpoint of its own, or routers in between."""

import math
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import chain
from typing import Any

from ...schemas.errors import LinkError
from ...schemas.link.access import access_rules
from ...schemas.link.configuration import LOCAL, Tls, asks_for_secret, check_own, checked_endpoint
from ...schemas.link.secret import shared_secret
from ...schemas.link.tls_files import common_name
from ..fleet.link.transport import ROUTER_GRACE, Transport, connect_to_router, listen
from .page.page_access import PagePlace
from .tls_end import end_announced


@dataclass(frozen=True, slots=True)
class Link:
    """The endpoint for workers, or the routers in between, with their protection, and the address of the live page."""

    endpoint: str
    tls: Tls | None = None
    insecure: bool = False
    web: PagePlace | None = None
    allow: tuple[str, ...] = ()
    """Common names of the certificates of workers; empty: every one of the authority."""
    routers: tuple[str, ...] = ()
    """Endpoints of routers, of which one is used at a time; then nothing listens here."""
    grace: float = ROUTER_GRACE
    """Seconds for workers to return after a router has come or gone."""

    @property
    def options(self) -> list[str]:
        """The options of a command that waits for the same workers; none where no other machine can be meant."""
        if not self.routers and self.endpoint == LOCAL:
            return []
        pairs = [("--connect", each) for each in self.routers] or [("--listen", self.endpoint)]
        pairs += [("--allow", each) for each in self.allow]
        if (tls := self.tls) is not None:
            pairs += [("--tls-ca", tls.ca), ("--tls-certificate", tls.certificate), ("--tls-key", tls.key)]
        if self.grace != ROUTER_GRACE:
            pairs.append(("--grace", f"{self.grace:g}"))
        return [*chain.from_iterable(pairs), *(["--insecure"] if self.insecure else [])]

    def elsewhere(self) -> "Link":
        """Return the link as another process names it, wherever that is started.

        Raises:
            LinkError: an endpoint is malformed, or does not fit the TLS options.

        """
        option = "--connect" if self.routers else "--listen"
        for each in self.routers or (self.endpoint,):
            checked_endpoint(option, each, self.tls)  # what is no endpoint may contain anything, also a password
        if self.tls is None:
            return self
        return replace(self, tls=Tls(**{name: os.path.abspath(path) for name, path in self.tls.model_dump().items()}))

    def secret(self) -> bytes | None:
        """Return the secret that workers must know.

        Raises:
            SecretError: it cannot be used, or there is no place for one.

        """
        return shared_secret(loopback=all(map(asks_for_secret, self.routers or (self.endpoint,))))

    def access(self, *, local_workers: bool) -> dict[str, Any] | None:
        """Return the access rules for the link.

        Raises:
            LinkError: there are no certificates, or a name cannot be allowed.

        """
        if not self.allow:
            return None
        if self.routers:
            raise LinkError("--allow: the router alone sees the certificates of workers; give it these names")
        if self.tls is None:
            raise LinkError("--allow: needs a tls/ endpoint, --tls-ca, --tls-certificate and --tls-key")
        own = common_name(self.tls.certificate)
        if local_workers and not own:
            raise LinkError(
                f"{self.tls.certificate}: has no common name, by which local workers could be told apart; with --allow "
                "choose a certificate with one, or no local workers"
            )
        return access_rules(self.allow, own)

    @contextmanager
    def opened(
        self, *, local_workers: bool, print_line: Callable[[str], None], patience: float = math.inf
    ) -> Iterator[Transport]:
        """Open the way to the workers; a router that does not answer is waited for, at most `patience` s.

        Raises:
            PerfboundError: an endpoint cannot be used, or no router answers for so long.

        """
        access = self.access(local_workers=local_workers)
        if self.tls is not None:
            option = "--connect" if self.routers else "--listen"
            check_own(option, self.routers or (self.endpoint,), self.tls, "orchestrator")
        if self.routers:
            link = connect_to_router(
                self.routers, self.tls, self.secret(), print_line, grace=self.grace, patience=patience
            )
        else:
            link = listen(self.endpoint, self.tls, insecure=self.insecure, secret=self.secret(), access=access)
        with link as transport, end_announced(None if self.tls is None else self.tls.certificate, print_line):
            yield transport

    def ways(self, listening: str) -> tuple[str, ...]:
        """Return the endpoints that workers connect to; `listening` is the one of this process, where it has one."""
        return self.routers or (listening,)

    def options_elsewhere(self) -> list[str]:
        """Return what a worker on another machine needs beside the endpoint, its files in capitals."""
        if self.tls is None:
            return []
        return ["--tls-ca", "CA", "--tls-certificate", "CERTIFICATE", "--tls-key", "KEY"]

    def worker_options(self) -> list[str]:
        """Return the options with which local workers connect."""
        if self.tls is None:
            return ["--insecure"] if self.secret() is None else []
        return ["--tls-ca", self.tls.ca, "--tls-certificate", self.tls.certificate, "--tls-key", self.tls.key]
