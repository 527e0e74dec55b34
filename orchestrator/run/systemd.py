"""What systemd is told: that we serve, what we do, that we live. Without systemd, nothing."""

import os
import socket
import time

READY, STOPPING, ALIVE = "READY=1", "STOPPING=1", "WATCHDOG=1"


class Systemd:
    """The notification socket of the service manager that started us, if one did (`man sd_notify`)."""

    def __init__(self) -> None:
        self._address = os.environ.get("NOTIFY_SOCKET", "")
        # Half of what systemd allows between two signs of life; as the manual advises.
        self._period = int(os.environ.get("WATCHDOG_USEC", "0")) / 2e6 if self._is_ours() else 0.0
        self._next = 0.0
        self._status = ""

    def ready(self, status: str) -> None:
        """Say that workers can be served."""
        self._send(f"{READY}\nSTATUS={status}")

    def alive(self, status: str) -> None:
        """Say what we do, if that has changed, and in time that we live; called by the one loop."""
        now = time.monotonic()
        if self._period and now >= self._next:
            self._next = now + self._period
            self._send(ALIVE)
        if status != self._status:
            self._status = status
            self._send(f"STATUS={status}")

    def stopping(self) -> None:
        """Say that we are going down."""
        self._send(STOPPING)

    def _is_ours(self) -> bool:
        return os.environ.get("WATCHDOG_PID", str(os.getpid())) == str(os.getpid())

    def _send(self, text: str) -> None:
        if not self._address:
            return
        # An address that begins with @ is in the abstract namespace.
        address = "\0" + self._address[1:] if self._address.startswith("@") else self._address
        try:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
                sock.sendto(text.encode(), address)
        except OSError:
            return  # a manager that does not listen is no reason to stop a campaign
