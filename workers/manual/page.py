"""The page of a desk, on this machine alone: anyone who has its address may hand in logs."""

import asyncio
import base64
import hashlib
import json
import re
import secrets
import socket
import threading
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import HTMLResponse, JSONResponse, Response
from starlette.routing import Route

from ...schemas.errors import EvidenceError, LinkError, PerfboundError, one_line
from ..logs.tables import MAX_LOG
from .desk import Desk

PORT = 8790
SAFE = re.compile(r"[^A-Za-z0-9._-]+")
PAGE = Path(__file__).with_name("page.html")
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; script-src '{script}'; "
    "connect-src 'self'; frame-ancestors 'none'; form-action 'none'; base-uri 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


class DeskPage:
    """The server of the page, in a thread of its own until the process ends."""

    def __init__(self, desk: Desk, port: int) -> None:
        self._desk, self._token = desk, secrets.token_urlsafe(16)
        self._socket = _listening(port)
        self.address = f"http://127.0.0.1:{self._socket.getsockname()[1]}/{self._token}/"

    def start(self) -> None:
        """Begin to serve."""
        threading.Thread(target=self._serve, daemon=True, name="page").start()

    def _serve(self) -> None:
        config = uvicorn.Config(
            self.application, log_config=None, access_log=False, server_header=False, lifespan="off", ws="none"
        )
        asyncio.run(uvicorn.Server(config).serve(sockets=[self._socket]))

    @property
    def application(self) -> Starlette:
        """The pages below the secret part of the address."""
        here = f"/{self._token}"
        return Starlette(
            routes=[
                Route(f"{here}/", self._page),
                Route(f"{here}/state", self._state),
                Route(f"{here}/log", self._log, methods=["POST"]),
                Route(f"{here}/failed", self._failed, methods=["POST"]),
            ],
            exception_handlers={PerfboundError: _refused, OSError: _refused, ValueError: _refused},
        )

    async def _page(self, _: Request) -> Response:
        page = PAGE.read_bytes()
        script = page.partition(b"<script>")[2].partition(b"</script>")[0]
        digest = base64.b64encode(hashlib.sha256(script).digest()).decode()
        policy = HEADERS["Content-Security-Policy"].replace("{script}", f"sha256-{digest}")
        return HTMLResponse(page, headers={**HEADERS, "Content-Security-Policy": policy})

    async def _state(self, _: Request) -> Response:
        return JSONResponse(self._desk.described, headers=HEADERS)

    async def _log(self, request: Request) -> Response:
        """Take a log: as the body of the request, or the path of a file or a folder on this machine."""
        given = _given(request)
        key, path = str(given.get("key", "")), str(given.get("path", "")).strip()
        if path:
            log = Path(path).expanduser()
        else:
            log = await self._uploaded(request, key, str(given.get("name", "")))
        values = [_numbers(given.get(name)) for name in ("start", "disturbances")]
        try:
            await run_in_threadpool(self._desk.hand_in, key, log, *values)
        except PerfboundError:
            if not path:
                log.unlink(missing_ok=True)  # a copy, and none of a test
            raise
        return JSONResponse({"log": log.name}, headers=HEADERS)

    async def _uploaded(self, request: Request, key: str, name: str) -> Path:
        """Return the file of a body in the folder of the logs; the name is that of the person, made safe."""
        if not re.fullmatch("[0-9a-f]{14}", key):
            raise EvidenceError("this request was withdrawn; load the page again")
        self._desk.folder.mkdir(parents=True, exist_ok=True)
        safe = SAFE.sub("_", Path(name).name)[-80:] or "log.csv"
        # A name of its own for each: what was handed in before stays what it was.
        log = self._desk.folder / f"{key}-{secrets.token_hex(3)}-{safe}"
        size, part = 0, log.with_name(f"{log.name}.partial")
        try:
            with part.open("wb") as file:
                async for piece in request.stream():
                    if (size := size + len(piece)) > MAX_LOG:
                        raise EvidenceError(f"the file has more than {MAX_LOG} bytes; give its path on this machine")
                    file.write(piece)
            if not size:
                raise EvidenceError("choose the log of the test, or give its path")
            part.replace(log)
        finally:
            part.unlink(missing_ok=True)
        return log

    async def _failed(self, request: Request) -> Response:
        given = _given(request)
        self._desk.fail(str(given.get("key", "")), str(given.get("reason", "")))
        return JSONResponse({}, headers=HEADERS)


def _given(request: Request) -> dict[str, Any]:
    found = json.loads(request.query_params.get("given", "{}"))
    if not isinstance(found, dict):
        raise EvidenceError("given: a table is wanted, as the page sends it")
    return found


def _numbers(given: Any) -> dict[str, object]:
    """Return numbers by name; those that were left empty are not given."""
    found = given.items() if isinstance(given, dict) else ()
    return {str(name): value for name, value in found if value is not None}


async def _refused(_: Request, fault: Exception) -> Response:
    text = fault.strerror or str(fault) if isinstance(fault, OSError) else str(fault)
    return JSONResponse({"fault": one_line(text)}, status_code=400, headers=HEADERS)


def _listening(port: int) -> socket.socket:
    listening = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listening.bind(("127.0.0.1", port))
        listening.listen()  # now: its address is printed before the server runs
    except OSError as error:
        listening.close()
        raise LinkError(f"--manual-port {port}: {error.strerror}; choose another one, or 0 for any") from None
    return listening
