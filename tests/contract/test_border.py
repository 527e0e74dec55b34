"""The border on a real link: what a raw peer can read, and what it can hold up."""

import pytest
import zenoh

from perfbound.orchestrator.fleet.link.transport import listen
from perfbound.schemas.errors import LinkError
from perfbound.schemas.link.configuration import LOCAL, connect_config, reachable, with_port

pytestmark = pytest.mark.smoke


def test_a_peer_reads_nothing_of_the_admin_space() -> None:
    with (
        listen(LOCAL) as transport,
        zenoh.open(zenoh.Config.from_json5(connect_config([transport.endpoint], None))) as peer,
    ):
        found = [str(reply.ok.key_expr) for reply in peer.get("@/**") if reply.ok is not None]
    own = f"@/{peer.zid()}/"
    assert [key for key in found if not key.startswith(own)] == []


def test_port_0_becomes_one_that_peers_can_reach() -> None:
    with listen(LOCAL) as one, listen(LOCAL) as other:
        assert one.endpoint != other.endpoint
        for transport in (one, other):
            assert not transport.endpoint.endswith(":0")
            zenoh.open(zenoh.Config.from_json5(connect_config([transport.endpoint], None))).close()  # type: ignore[no-untyped-call]


@pytest.mark.parametrize("protocol", ["tcp", "quic", "tls"])
def test_a_port_that_is_given_is_kept(protocol: str) -> None:
    assert with_port(f"{protocol}/[::1]:7447") == f"{protocol}/[::1]:7447"
    assert with_port(f"{protocol}/127.0.0.1:0").startswith(f"{protocol}/127.0.0.1:")


def test_an_address_of_another_machine_is_refused() -> None:
    with pytest.raises(LinkError, match="choose an address of this machine"):
        with_port("tcp/203.0.113.9:0")


def test_the_endpoint_of_all_interfaces_has_an_address_that_is_one() -> None:
    assert reachable("tcp/127.0.0.1:1") == "tcp/127.0.0.1:1"
    assert reachable("tcp/localhost:1") == "tcp/localhost:1"
    assert "0.0.0.0" not in reachable("tcp/0.0.0.0:1")
    assert reachable("tcp/[::]:1").startswith("tcp/[")
    assert "[::]" not in reachable("tcp/[::]:1")
