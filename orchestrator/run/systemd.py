"""Notifications to systemd: ready, status, watchdog, stopping; nothing without systemd."""

import os
import socket
import time

READY, STOPPING, ALIVE = "READY=1", "STOPPING=1", "WATCHDOG=1"


class Systemd:
    """The notification socket of the service manager that started this process, if one did (`man sd_notify`)."""

    def __init__(self) -> None:
        self._address = os.environ.get("NOTIFY_SOCKET", "")
        # Half of what systemd allows between two notifications of the watchdog, as the manual advises.
        self._period = int(os.environ.get("WATCHDOG_USEC", "0")) / 2e6 if self._is_addressee() else 0.0
        self._next = 0.0
        self._status = ""

    def ready(self, status: str) -> None:
        """Notify that workers can be served."""
        self._send(f"{READY}\nSTATUS={status}")

    def alive(self, status: str) -> None:
        """Send the status if it has changed, and notify the watchdog in time; called by the one loop."""
        now = time.monotonic()
        if self._period and now >= self._next:
            self._next = now + self._period
            self._send(ALIVE)
        if status != self._status:
            self._status = status
            self._send(f"STATUS={status}")

    def stopping(self) -> None:
        """Notify that the process is ending."""
        self._send(STOPPING)

    def _is_addressee(self) -> bool:
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
            return  # an unreachable service manager is no reason to stop a campaign
