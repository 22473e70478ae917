"""The page against a hostile client: other sites, other names, no secret, and messages that ask for memory."""

import asyncio
import struct
import subprocess
import sys

import pytest
from later import later

from modalshell.viewer.guard import is_own, limited

aiohttp = later("aiohttp", "aiohttp is not installed (pip install 'modalshell[web]')")
msgpack = later("msgpack", "msgpack is not installed (pip install 'modalshell[web]')")
later("trame", "trame is not installed (pip install 'modalshell[web]')")

SERVER = """
from trame.app import get_server
from trame.ui.vuetify3 import SinglePageLayout
from modalshell.viewer.guard import guard
server = get_server("guarded", client_type="vue3")
secret = guard(server, "127.0.0.1")
server.state.answer = 1
with SinglePageLayout(server):
    pass
server.controller.on_server_ready.add(lambda **_: print(server.port, secret, flush=True))
server.start(host="127.0.0.1", port=0, open_browser=False, show_connection_info=False, disable_logging=True, timeout=0)
"""


@pytest.fixture(scope="module")
def page():
    """Port and secret of a page in a process of its own, and its process."""
    process = subprocess.Popen(
        [sys.executable, "-c", SERVER], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    port, secret = process.stdout.readline().split()
    yield int(port), secret, process
    process.terminate()
    process.communicate()


def message(method, *arguments, name="system:1", size=None):
    """A message as wslink's client sends it, or the beginning of one that says it has ``size`` bytes."""
    body = msgpack.packb({"wslink": "1.0", "id": name, "method": method, "args": list(arguments), "kwargs": {}})
    return struct.pack("<III", hash(name) & 0xFFFF, 0, len(body) if size is None else size) + body


def resident(process):
    """Memory of the process [bytes]."""
    with open(f"/proc/{process.pid}/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * 4096


async def answer(socket):
    chunk = (await asyncio.wait_for(socket.receive(), 20)).data
    return msgpack.unpackb(chunk[12:])


def talk(port, conversation, **headers):
    """Hold a conversation over a web socket to the page."""

    async def connected():
        address = f"http://127.0.0.1:{port}/ws"
        async with aiohttp.ClientSession() as session, session.ws_connect(address, headers=headers) as socket:
            return await conversation(socket)

    return asyncio.run(connected())


def status(port, path="/index.html", **headers):
    async def asked():
        async with (
            aiohttp.ClientSession() as session,
            session.get(f"http://127.0.0.1:{port}{path}", headers=headers) as found,
        ):
            return found.status

    return asyncio.run(asked())


def test_other_sites_and_names_are_refused(page):
    port, _, _ = page
    assert status(port) == 200
    assert status(port, Origin=f"http://localhost:{port}", Host=f"localhost:{port}") == 200
    for path in ("/index.html", "/ws"):
        assert status(port, path, Origin="https://evil.example") == 403
        assert status(port, path, Origin="null") == 403
        assert status(port, path, Host=f"evil.example:{port}") == 403
        assert status(port, path, Host="127.0.0.1:80") == 403

    async def nothing(socket):
        await socket.receive()

    with pytest.raises(aiohttp.WSServerHandshakeError) as caught:
        talk(port, nothing, Origin="https://evil.example")
    assert caught.value.status == 403


def test_the_secret_is_needed_and_no_default(page):
    port, secret, _ = page
    assert len(secret) >= 32

    def tried(word):
        async def hello(socket):
            await socket.send_bytes(message("wslink.hello", {"secret": word}))
            return await answer(socket)

        return talk(port, hello, Origin=f"http://127.0.0.1:{port}")

    assert "error" not in tried(secret)
    for word in ("wslink-secret", "vtkweb-secret", "", secret[:-1], None, 5, [secret]):
        assert "Authentication failed" in str(tried(word)["error"])


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="memory is read from /proc")
def test_messages_that_ask_for_memory_get_none(page):
    port, secret, process = page
    before = resident(process)

    async def attack(socket):
        await socket.send_bytes(message("wslink.hello", {"secret": secret}))
        assert "error" not in await answer(socket)
        for number in range(200):
            await socket.send_bytes(struct.pack("<III", number, 0, 1 << 30) + b"0123456789")
            await socket.send_bytes(struct.pack("<III", 1000 + number, 0, 1 << 20) + b"0123456789")
        for junk in (b"", b"x", struct.pack("<III", 1, 0, 1) + b"\xc1", struct.pack("<III", 1, 0, 1) + b"\x05"):
            await socket.send_bytes(junk)
        await socket.send_bytes(struct.pack("<III", 5, 0, 6) + msgpack.packb({"id": 5})[:6].ljust(6, b"\0"))
        await socket.send_bytes(message("trame.state.get", name="rpc:1"))  # whoever sent junk may go on
        return await answer(socket)

    assert "error" not in talk(port, attack)
    assert resident(process) - before < 100e6

    async def unknown(socket):
        for number in range(20_000):
            await socket.send_bytes(struct.pack("<III", number, 0, 512) + b"0123456789")
        await socket.send_bytes(message("trame.state.get", name="rpc:1"))
        return await answer(socket)

    assert "Unauthorized" in str(talk(port, unknown))
    assert resident(process) - before < 100e6


def test_browsers_are_counted_once_they_gave_the_secret(page):
    port, secret, _ = page
    address = f"http://127.0.0.1:{port}/ws"

    async def greeted(session):
        socket = await session.ws_connect(address)
        await socket.send_bytes(message("wslink.hello", {"secret": secret}))
        assert "error" not in await answer(socket)
        return socket

    async def crowd():
        async with aiohttp.ClientSession(connector=aiohttp.TCPConnector(limit=0)) as session:
            silent = [await session.ws_connect(address) for _ in range(150)]
            await silent[0].receive()  # the oldest ones make room
            sockets = [await greeted(session) for _ in range(32)]
            with pytest.raises(aiohttp.WSServerHandshakeError) as caught:
                await session.ws_connect(address)
            assert caught.value.status == 503
            await silent[-1].send_bytes(message("wslink.hello", {"secret": secret}))  # of a crowd that came together
            for socket in silent:  # and silent ones are heard for some seconds
                found = await asyncio.wait_for(socket.receive(), 20)
                assert found.type in (aiohttp.WSMsgType.CLOSED, aiohttp.WSMsgType.CLOSE, aiohttp.WSMsgType.BINARY)
            assert not any(socket.closed for socket in sockets)
            await sockets[0].close()
            await sockets[1].send_bytes(message("trame.state.get", name="rpc:1"))
            assert "error" not in await answer(sockets[1])
            return await greeted(session)

    assert asyncio.run(crowd()) is not None


def deep(levels):
    value = 1
    for _ in range(levels):
        value = [value]
    return value


def test_messages_of_a_wrong_form_are_dropped(page):
    port, secret, _ = page
    head = {"wslink": "1.0", "id": "system:1", "method": "wslink.hello"}

    async def talked(socket):
        for wrong in ({"args": 5}, {"args": None}, {"args": {}}, {"args": deep(400)}):
            body = msgpack.packb(head | wrong)
            await socket.send_bytes(struct.pack("<III", 1, 0, len(body)) + body)
        await socket.send_bytes(message("wslink.hello", {"secret": secret}))
        return await answer(socket)

    assert "error" not in talk(port, talked)


def test_requests_for_other_protocols_are_refused(page):
    port, _, _ = page
    assert status(port, "/ws") == 400
    assert status(port, "/ws", Upgrade="WebSocket, h2c", Connection="Upgrade") == 400
    assert status(port, Upgrade="h2c", Connection="Upgrade") == 400


@pytest.mark.parametrize("path", ["/index.html", "/", "/none", "/ws"])
def test_no_page_may_be_framed(page, path):
    async def asked():
        address = f"http://127.0.0.1:{page[0]}{path}"
        async with aiohttp.ClientSession() as session, session.get(address, allow_redirects=False) as found:
            return found.headers["Content-Security-Policy"]

    assert asyncio.run(asked()) == "frame-ancestors 'none'"


def test_own_addresses_are_told_from_others():
    assert is_own("127.0.0.1", 80, {"Host": "127.0.0.1:80"})
    assert is_own("127.0.0.1", 80, {"Host": "localhost:80", "Origin": "http://127.0.0.1:80"})
    for headers in ({}, {"Host": "127.0.0.1"}, {"Host": "127.0.0.1:80", "Origin": "https://127.0.0.1:80"}):
        assert not is_own("127.0.0.1", 80, headers)


@pytest.mark.slow
def test_a_kind_is_limited_once():
    found = limited(type("Kind", (), {}))
    assert limited(found) is found
