"""A campaign over the in-memory network, as a process of its own: it changes the clocks of the code it runs."""

from pathlib import Path

import click
import pytest

from perfbound.schemas.platforms import one_blas_thread

one_blas_thread()  # as in every process of perfbound, before numpy is loaded

from perfbound.schemas.errors import Stopped  # noqa: E402
from perfbound.schemas.file.reader import parse_campaign  # noqa: E402  (numpy reads the setting once)
from tests.fakes.inmemory import Faults, Log, Network, begin, hurry, run_of, serve, working  # noqa: E402


class Counting(Network):
    """The scripted network; it counts what it does to messages."""

    disturbed = 0

    def put(self, key: str, payload: bytes, attachment: bytes | None = None) -> None:
        """Send bytes; lost and repeated messages are counted by what reaches the agenda."""
        before = len(self._agenda)
        super().put(key, payload, attachment)
        self.disturbed += len(self._agenda) != before + 1


@click.command()
@click.argument("campaign", type=click.Path(path_type=Path))
@click.argument("directory", type=click.Path(path_type=Path))
@click.option("--loss", type=float)
@click.option("--duplication", type=float)
@click.option("--delay", type=float)
@click.option("--seed", type=int)
@click.option("--stop-at", type=int, help="Rollouts after which the orchestrator stops, to be resumed.")
def main(*, campaign: Path, directory: Path, stop_at: int, **faults: float) -> None:
    """Run CAMPAIGN into DIRECTORY with one restart; print how many messages were lost or repeated."""
    begin(directory, parse_campaign(campaign.read_bytes(), str(campaign)))
    wraps = [lambda uplink: uplink] * 3
    with pytest.MonkeyPatch.context() as patch:
        hurry(patch, tick=0.05)
        network = Counting(Faults(**faults))  # type: ignore[arg-type]
        with network, working(network, run_of(directory), wraps):
            try:
                serve(directory, network, Log(), stop=lambda seen: seen.recorded >= stop_at)
            except Stopped:
                serve(directory, network, Log(), resumed=True)
            click.echo(network.disturbed)


if __name__ == "__main__":
    main()
