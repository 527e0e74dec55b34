"""The checks that every request passes, and the headers of every response.

Every web site that a user opens can send requests to a server on the user's machine. A site whose name is changed to
resolve to this machine (DNS rebinding) could also read the responses of a server that accepts any Host header. This
one accepts its own names only. A page with a token accepts no request without it, under any name.

One path is open to all: a probe knows neither name nor token, and learns no more than whether the page lives.
"""

from starlette.datastructures import MutableHeaders
from starlette.middleware.trustedhost import TrustedHostMiddleware
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from ....schemas.host import host_name
from ...run.page.address import Address
from ...run.page.page_access import OPEN, PageAccess
from .page_token import CookieCheck, TokenCheck

HEALTH = "/healthz"
LONGEST = 1000
"""Bytes of a path with its query."""
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
}
"""Of every response that does not set its own."""


def restricted(application: ASGIApp, address: Address, access: PageAccess = OPEN) -> ASGIApp:
    """Return the application behind the checks; it accepts `localhost`, loopback numbers and the host of `address`."""
    host = host_name() if address.everywhere else address.host
    hosts = ["localhost", "127.0.0.1", "[::1]", f"[{host}]" if ":" in host else host]
    if access.token is None:
        guarded: ASGIApp = TrustedHostMiddleware(application, hosts, www_redirect=False)
    else:
        logged_in = CookieCheck(application, access.token, address.port, secure=access.tls is not None)
        browsers = TrustedHostMiddleware(logged_in, hosts, www_redirect=False)
        guarded = TokenCheck(application, browsers, access.token)

    async def probed(scope: Scope, receive: Receive, send: Send) -> None:
        await (application if scope["path"] == HEALTH else guarded)(scope, receive, send)

    # Outermost: also a refusal must not be framed, cached or read by another site.
    return _Headers(probed)


class _Headers:
    """An application whose responses carry `HEADERS`, also those that refuse a request."""

    def __init__(self, inner: ASGIApp) -> None:
        self._inner = inner

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        too_long = len(scope["raw_path"]) + len(scope["query_string"]) > LONGEST
        refusal = PlainTextResponse(f"an address here has at most {LONGEST} bytes\n", 414)
        await (refusal if too_long else self._inner)(scope, receive, with_headers)
