"""The uplink of a worker that alters its results and proves what it sends: it has the secrets of its assignments."""

from perfbound.schemas.link.messages import Assign, AssignBatch, Request, ResultHeader, WorkerState
from perfbound.schemas.link.seal import result_proof
from perfbound.workers.transport import Receiver
from tests.fakes.inmemory import InMemoryUplink


class AlteringUplink:
    """Passes everything on; a subclass alters what it reports and delivers."""

    def __init__(self, inner: InMemoryUplink) -> None:
        self._inner = inner
        self._secrets: dict[tuple[str, int], str] = {}
        self.orchestrators = inner.orchestrators
        self.leave = inner.leave

    def join(self, run: str, worker: str, receive: Receiver) -> None:
        """Pass on, and remember the secrets."""

        def take(message: Request) -> None:
            if isinstance(message, Assign | AssignBatch):
                self._secrets[message.request.rollout, message.attempt] = message.secret
            receive(message)

        self._inner.join(run, worker, take)

    def report(self, state: WorkerState) -> None:
        """Pass on."""
        self._inner.report(state)

    def deliver(self, header: ResultHeader, payload: bytes) -> None:
        """Send a header with its proof."""
        header = ResultHeader.model_validate(header.model_dump())  # as a worker makes it: its texts are one line
        proof = result_proof(self._secrets[header.rollout, header.attempt], header)
        self._inner.deliver(header.model_copy(update={"proof": proof}), payload)
