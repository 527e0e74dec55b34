"""Notifications to systemd: ready, status, watchdog, stopping; nothing without systemd."""

import atexit
import os
import socket
import threading
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
        self._looping = threading.Event()
        self._looping.set()

    def ready(self, status: str) -> None:
        """Notify that the start is over."""
        self._send(f"{READY}\nSTATUS={status}")

    def alive(self, status: str) -> None:
        """Send the status if it has changed, and notify the watchdog in time; called by the one loop."""
        self._looping.set()
        now = time.monotonic()
        if self._period and now >= self._next:
            self._next = now + self._period
            self._send(ALIVE)
        if status != self._status:
            self._status = status
            self._send(f"STATUS={status}")

    def outside_loop(self) -> None:
        """Notify the watchdog from a thread, until the loop turns again or the process ends.

        Before and after its loop a campaign reads every file and makes its certificate and its report, for as long as
        that takes, without a place where all of it passes.
        """
        if self._period and self._looping.is_set():
            self._looping.clear()
            threading.Thread(target=self._notify, name="watchdog", daemon=True).start()

    def stopping(self) -> None:
        """Notify that the process is ending."""
        self._send(STOPPING)

    def _notify(self) -> None:
        self._send(ALIVE)
        while not self._looping.wait(self._period):
            self._send(ALIVE)

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


def with_a_loop() -> Systemd:
    """Return the notifications of a process whose loop is to begin, and notify when that process ends."""
    systemd = Systemd()
    atexit.register(systemd.stopping)
    systemd.outside_loop()
    return systemd
