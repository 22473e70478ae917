"""Access control of the web viewer: own address, a secret per start, and bounded message sizes."""

from __future__ import annotations

import asyncio
import importlib
import secrets
from collections.abc import Awaitable, Callable
from typing import Any

_LONGEST = 1 << 20
"""Bytes of a message from a browser; trame's own are some hundreds, and it would allow 4 GB."""
_PENDING = 16
"""Largest number of partial messages of one browser."""
_CONNECTIONS = 32


def guard(server: Any, host: str) -> str:
    """Configure a trame server before it starts; return the secret that browsers must present."""
    secret = secrets.token_urlsafe(24)
    server.cli.set_defaults(authKey=secret)
    protocol: Any = importlib.import_module("wslink.protocol")
    protocol.UnChunker = limited(protocol.UnChunker)
    server.controller.on_server_bind.add(lambda web: web.app.middlewares.append(_own_pages_only(host)))
    server.controller.on_server_ready.add(lambda **_: asyncio.get_running_loop().set_exception_handler(_quiet))
    return secret


def is_own(host: str, port: int, headers: Any) -> bool:
    """Whether a request is addressed to this page, and sent by it if by any: other web sites name themselves.

    A site whose name leads to this machine (DNS rebinding) has another ``Host``.
    """
    own = {f"{name}:{port}" for name in (host, "localhost")}
    origin = headers.get("Origin")
    return headers.get("Host") in own and (origin is None or origin in {f"http://{name}" for name in own})


def _own_pages_only(host: str) -> Any:
    from aiohttp import web

    open_sockets = 0

    @web.middleware
    async def check(request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]) -> Any:
        nonlocal open_sockets
        name = request.transport.get_extra_info("sockname") if request.transport else None
        if not name or not is_own(host, name[1], request.headers):
            return web.Response(status=403, text="This page serves its own address alone.\n")
        if request.headers.get("Upgrade", "").lower() != "websocket":
            return await handler(request)
        if open_sockets >= _CONNECTIONS:
            return web.Response(status=503, text=f"The page has {_CONNECTIONS} browsers already.\n")
        open_sockets += 1
        try:
            return await handler(request)
        finally:
            open_sockets -= 1

    return check


def limited(kind: type[Any]) -> type[Any]:
    """A subclass of wslink's UnChunker that joins messages of bounded size, and drops all others."""
    if hasattr(kind, "drop"):
        return kind

    class Limited(kind):  # type: ignore[misc]
        def set_max_message_size(self, size: int) -> None:
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
            sound = isinstance(message, dict) and all(isinstance(message.get(key), str) for key in ("id", "method"))
            return message if sound else None

    return Limited


def _quiet(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """A browser whose tab is closed in the middle of a message is no error."""
    if not isinstance(context.get("exception"), ConnectionError):
        loop.default_exception_handler(context)
