"""Access control of the web viewer: own address, a secret per start, and bounded message sizes."""

from __future__ import annotations

import asyncio
import importlib
import secrets
from collections.abc import Awaitable, Callable
from contextvars import ContextVar
from typing import Any

_LONGEST = 1 << 20
"""Bytes of a message from a browser; trame's own are some hundreds, and it would allow 4 GB."""
_PENDING = 16
"""Largest number of partial messages of one browser."""
_DEPTH = 50
"""Largest depth of lists in a message; wslink copies them by recursion."""
_CONNECTIONS = 32
"""Browsers that have given the secret."""
_WAITING = 128
"""Web sockets that have not; of more, the oldest is closed."""
_SECONDS = 5
"""Time for the secret."""


def guard(server: Any, host: str) -> str:
    """Configure a trame server before it starts; return the secret that browsers must present."""
    secret = secrets.token_urlsafe(24)
    server.cli.set_defaults(authKey=secret)
    protocol: Any = importlib.import_module("wslink.protocol")
    protocol.UnChunker = limited(protocol.UnChunker)
    server.controller.on_server_bind.add(lambda web: web.app.middlewares.append(_own_pages_only(host)))
    server.controller.on_server_bind.add(lambda web: web.app.on_response_prepare.append(_unframed))
    server.controller.on_server_ready.add(lambda **_: asyncio.get_running_loop().set_exception_handler(_quiet))
    return secret


def is_own(host: str, port: int, headers: Any) -> bool:
    """Whether a request is addressed to this page, and sent by it if by any: other web sites name themselves.

    A site whose name leads to this machine (DNS rebinding) has another ``Host``.
    """
    own = {f"{name}:{port}" for name in (host, "localhost")}
    origin = headers.get("Origin")
    return headers.get("Host") in own and (origin is None or origin in {f"http://{name}" for name in own})


class _Places:
    """Web sockets that have given the secret, and those that have yet to."""

    def __init__(self) -> None:
        self.taken: set[_Visit] = set()
        self.waiting: dict[_Visit, None] = {}

    @property
    def full(self) -> bool:
        """Whether no further browser is taken."""
        return len(self.taken) >= _CONNECTIONS


class _Visit:
    """One web socket, closed unless it gives the secret in time."""

    def __init__(self, places: _Places, transport: asyncio.BaseTransport) -> None:
        self._places, self._transport = places, transport
        if len(places.waiting) >= _WAITING:
            next(iter(places.waiting)).close()
        places.waiting[self] = None
        self._wait(_SECONDS)

    def _wait(self, seconds: int) -> None:
        """Second by second: a server busy with a slow frame has heard nothing meanwhile."""
        if seconds == 0:
            self.close()
        elif self in self._places.waiting:
            self._timer = asyncio.get_running_loop().call_later(1.0, self._wait, seconds - 1)

    def admit(self) -> None:
        """Take a place, as the secret is right; close the socket if there is none."""
        self.leave()
        if self._places.full:
            self._transport.close()
        else:
            self._places.taken.add(self)

    def leave(self) -> None:
        """Give up the place."""
        self._timer.cancel()
        self._places.waiting.pop(self, None)
        self._places.taken.discard(self)

    def close(self) -> None:
        """End the connection."""
        self.leave()
        self._transport.close()


_VISIT: ContextVar[_Visit | None] = ContextVar("_VISIT", default=None)
"""The web socket that the present task serves."""


def _own_pages_only(host: str) -> Any:
    from aiohttp import web

    places = _Places()

    @web.middleware
    async def check(request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]) -> Any:
        transport = request.transport
        name = transport.get_extra_info("sockname") if transport else None
        if transport is None or not name or not is_own(host, name[1], request.headers):
            return web.Response(status=403, text="This page serves its own address alone.\n")
        if "Upgrade" not in request.headers and request.path != "/ws":
            return await handler(request)
        if not web.WebSocketResponse().can_prepare(request):
            return web.Response(status=400, text="This is no request for a web socket: send Upgrade: websocket.\n")
        if places.full:
            return web.Response(status=503, text=f"The page has {_CONNECTIONS} browsers already: close one.\n")
        visit = _Visit(places, transport)
        _VISIT.set(visit)
        try:
            return await handler(request)
        finally:
            visit.leave()

    return check


async def _unframed(_request: Any, response: Any) -> None:
    """No other page may hold this one in a frame."""
    response.headers["Content-Security-Policy"] = "frame-ancestors 'none'"


def _is_sound(message: Any) -> bool:
    """Whether wslink can read a message."""
    if not isinstance(message, dict) or not all(isinstance(message.get(key), str) for key in ("id", "method")):
        return False
    return isinstance(message.get("args", []), list) and not _is_deeper(message, _DEPTH)


def _is_deeper(value: Any, depth: int) -> bool:
    if not isinstance(value, dict | list):
        return False
    return depth == 0 or any(
        _is_deeper(one, depth - 1) for one in (value.values() if isinstance(value, dict) else value)
    )


def limited(kind: type[Any]) -> type[Any]:
    """A subclass of wslink's UnChunker that joins messages of bounded size, and drops all others."""
    if hasattr(kind, "drop"):
        return kind

    class Limited(kind):  # type: ignore[misc]
        def __init__(self) -> None:
            super().__init__()
            self._visit = _VISIT.get()

        def set_max_message_size(self, size: int) -> None:
            """Called by wslink once the secret was given."""
            if self._visit is not None:
                self._visit.admit()
            super().set_max_message_size(min(size, _LONGEST))

        def drop(self) -> None:
            self.release_pending_messages()

        def process_chunk(self, chunk: bytes) -> Any:
            try:
                message = super().process_chunk(chunk)
            except Exception:  # whatever msgpack finds wrong with bytes that no page has sent
                self.drop()
                return None
            if len(self.pending_messages) > _PENDING:
                self.drop()
            return message if _is_sound(message) else None

    return Limited


def _quiet(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """A browser whose tab is closed in the middle of a message is no error."""
    if not isinstance(context.get("exception"), ConnectionError):
        loop.default_exception_handler(context)
