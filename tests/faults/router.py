"""A Zenoh router of its own process, between the orchestrator (CONNECT) and its workers (LISTEN), with their secret."""

import json
import os
import signal
import sys

import zenoh

from perfbound.schemas.link import USER, password_line
from perfbound.schemas.seal import link_password
from perfbound.schemas.secret import shared_secret


def main(connect: str, listen: str) -> None:
    """Route until killed."""
    secret = shared_secret(loopback=True)
    assert secret is not None, "both ends are on loopback"
    passwords = os.memfd_create("passwords")
    os.write(passwords, password_line(secret).encode())
    link = {"user": USER, "password": link_password(secret), "dictionary_file": f"/proc/self/fd/{passwords}"}
    config = {
        "mode": "router",
        "connect": {
            "endpoints": [connect],
            "timeout_ms": -1,
            "exit_on_failure": False,
            "retry": {"period_max_ms": 500},
        },
        "listen": {"endpoints": [listen]},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "transport": {
            "shared_memory": {"enabled": False},
            "link": {"tx": {"lease": 2000, "keep_alive": 4}},
            "auth": {"usrpwd": link},
        },
    }
    with zenoh.open(zenoh.Config.from_json5(json.dumps(config))):
        signal.pause()


if __name__ == "__main__":
    main(*sys.argv[1:])
