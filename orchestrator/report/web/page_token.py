"""The token of a live page: shown once in an address and kept in a cookie by browsers, sent as a header by programs.

The address with the token is exchanged at once for one without it, so that it stays in no history, and a page has no
address with it to show. The cookie has a value of its own, from which the token does not follow.
"""

import hashlib
import hmac
from urllib.parse import parse_qsl, urlencode

from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

PARAMETER = "token"
MISSING = "this page needs its token: open the address that perfbound printed, with ?token=... at its end\n"
WRONG = "this is not the token of this page: a new start of perfbound prints a new one\n"
_BEARER = "bearer "


class TokenCheck:
    """An application that answers programs with the token, and hands all others to `browsers`."""

    def __init__(self, application: ASGIApp, browsers: ASGIApp, token: str) -> None:
        self._application, self._browsers, self._token = application, browsers, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        given = Headers(scope=scope).get("authorization")
        answer = self._browsers
        if given is not None:
            # No web site knows the token, so the host by which a program reaches this page does not matter.
            right = given[: len(_BEARER)].lower() == _BEARER and equal(given[len(_BEARER) :], self._token)
            answer = self._application if right else _token_refused(WRONG, 403)
        await answer(scope, receive, send)


class CookieCheck:
    """An application for browsers that have exchanged the token for a cookie."""

    def __init__(self, application: ASGIApp, token: str, port: int, *, secure: bool) -> None:
        self._application, self._token, self._secure = application, token, secure
        # A browser sends a cookie to all ports of a host: two pages must not take it from each other.
        self._name = f"perfbound-{port}"
        self._value = hmac.digest(token.encode(), b"cookie of the live page", hashlib.sha256).hex()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        await self._answer(Request(scope))(scope, receive, send)

    def _answer(self, request: Request) -> ASGIApp:
        given = request.query_params.get(PARAMETER)
        if given is not None and equal(given, self._token):
            return self._exchange(request)
        if equal(request.cookies.get(self._name, ""), self._value):
            return self._application
        return _token_refused(MISSING, 401) if given is None else _token_refused(WRONG, 403)

    def _exchange(self, request: Request) -> Response:
        """Return a redirect to the same address without the token."""
        found = RedirectResponse(without_token(request.scope["raw_path"], request.scope["query_string"]), 303)
        found.set_cookie(self._name, self._value, httponly=True, samesite="strict", secure=self._secure)
        return found


def without_token(path: bytes, query: bytes) -> str:
    """Return the address on the same host, whatever the path: two slashes at its begin would name another one.

    >>> without_token(b"//evil.example/", b"token=a&problem=gap")
    '/evil.example/?problem=gap'
    """
    kept = [pair for pair in parse_qsl(query.decode("latin-1"), keep_blank_values=True) if pair[0] != PARAMETER]
    rest = path.decode("latin-1").lstrip("/\\")
    return f"/{rest}{'?' if kept else ''}{urlencode(kept)}"


def equal(given: str, right: str) -> bool:
    """Whether two texts are equal, in a time that does not depend on where they differ."""
    return hmac.compare_digest(given.encode("utf-8", "surrogatepass"), right.encode())


def _token_refused(text: str, status: int) -> Response:
    """Return one sentence, and nothing else."""
    return PlainTextResponse(text, status, headers={"WWW-Authenticate": "Bearer"} if status == 401 else None)
