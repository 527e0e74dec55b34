"""A Zenoh router of its own process, between the orchestrator (CONNECT) and its workers (LISTEN)."""

import json
import signal
import sys

import zenoh


def main(connect: str, listen: str) -> None:
    """Route until killed."""
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
        "transport": {"shared_memory": {"enabled": False}, "link": {"tx": {"lease": 2000, "keep_alive": 4}}},
    }
    with zenoh.open(zenoh.Config.from_json5(json.dumps(config))):
        signal.pause()


if __name__ == "__main__":
    main(*sys.argv[1:])
