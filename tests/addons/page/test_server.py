"""The listener of the page: a port, a token, and who is told it."""

from __future__ import annotations

import os
import re
import resource
import socket
import stat
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from signal import SIGINT, Signals
from urllib.parse import urlsplit
from urllib.request import Request, urlopen

import psutil
import pytest
from marks import slow
from repository import ROOT
from traffic import Command
from traffic import log as log
from waiting import wait_for

from fleet.addons.page import server
from fleet.addons.page.server import Browser, PageListener, is_loopback, open_listener
from fleet.errors import FleetError
from fleet.processes.limits import allow_most_open_files


def test_each_door_has_a_free_port_that_listens_and_a_token_of_its_own() -> None:
    one, other = open_listener(), open_listener()
    with closing(one.listening), closing(other.listening):
        assert one.port != other.port and one.token != other.token
        assert len(one.token) >= 32  # 192 bits
        assert urlsplit(one.address).netloc == f"127.0.0.1:{one.port}"
        with socket.create_connection(("127.0.0.1", one.port), 5):
            pass


@pytest.mark.parametrize("host", ["192.0.2.1", "a..b", "a" * 64])
def test_an_address_that_is_not_ours_is_said(host: str) -> None:
    with pytest.raises(FleetError, match=re.escape(host)):
        open_listener(host)


@pytest.mark.parametrize(
    ("host", "names"),
    [
        ("127.0.0.1", {"127.0.0.1", "localhost"}),
        ("::1", {"[::1]", "localhost"}),
        ("192.0.2.7", {"192.0.2.7"}),
        ("0.0.0.0", set()),
        ("::", set()),
    ],
)
def test_the_names_by_which_a_page_is_reached(host: str, names: set[str]) -> None:
    with socket.socket() as nowhere:
        assert PageListener(host, 80, nowhere, "token").names == names
    assert is_loopback(host) == ("localhost" in names)


def test_a_browser_is_led_by_a_file_of_this_user_and_not_by_its_arguments(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(server.webbrowser, "open", lambda url: asked.append(url) or True)
    with closing(Browser("http://127.0.0.1:1/?token=secret")) as browser:
        assert browser.open()
        file = Path(urlsplit(asked[0]).path)
        assert asked[0].startswith("file:") and "secret" not in asked[0]
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
        assert "http://127.0.0.1:1/?token=secret" in file.read_text()
    assert not file.exists()


@pytest.mark.parametrize("folder", ["there", *slow("gone")])
def test_the_file_of_a_page_that_was_killed_is_removed_by_the_next_one(
    folder: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "there").mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / folder))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    begin = (
        "import os, signal; from fleet.addons.page.server import Browser; b = Browser('x'); print(b.file, flush=True)"
    )
    command = [sys.executable, "-c", f"{begin}; os.kill(os.getpid(), signal.SIGKILL)"]
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    left = Path(subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True).stdout.strip())
    assert left.is_file()
    with closing(Browser("x")) as browser:
        assert browser.file.is_file() and not left.exists()


def test_without_a_screen_no_browser_is_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(server.webbrowser, "open", lambda url: pytest.fail(f"opened {url}"))
    with closing(Browser("http://127.0.0.1:1/?token=secret")) as browser:
        assert not browser.open()


@pytest.fixture(scope="module")
def viewer(log: Path) -> Iterator[Command]:
    """A page that is served, by a process that may open no more files than most systems allow. The test of malformed
    messages ends it."""
    pytest.importorskip("nicegui", reason="the extra [view] is not installed")
    allow_most_open_files()  # for our ends of the connections
    with Command("view", log, "--no-open") as found:
        resource.prlimit(found.pid, resource.RLIMIT_NOFILE, (1024, resource.getrlimit(resource.RLIMIT_NOFILE)[1]))
        urlopen(address_of(found), timeout=60).close()
        yield found


def address_of(viewer: Command) -> str:
    """The address of the page, with its token."""
    return viewer.until("/?token=").printed.split()[-1]


def test_requests_without_a_token_do_not_fill_the_memory(viewer: Command) -> None:
    """Whoever sends headers without an end is cut off. Before, a hundred such connections took 250 MB in a second."""
    address, process = address_of(viewer), psutil.Process(viewer.pid)
    where = ("127.0.0.1", urlsplit(address).port)
    before = process.memory_info().rss
    with ExitStack() as held:
        for _ in range(100):
            sender = held.enter_context(socket.create_connection(where, 60))
            sender.sendall(b"GET / HTTP/1.1\r\n")
            with suppress(ConnectionError):
                for _ in range(10_000):  # 10 MB
                    sender.sendall(b"a: " + b"x" * 1000 + b"\r\n")
                pytest.fail("nobody cut it off")
        assert process.memory_info().rss < before + 50e6
        urlopen(address, timeout=60).close()


def test_half_open_connections_do_not_shut_out_who_has_the_token(viewer: Command) -> None:
    address = address_of(viewer)
    where = ("127.0.0.1", urlsplit(address).port)
    with ExitStack() as held:
        silent = [held.enter_context(socket.create_connection(where, 60)) for _ in range(1100)]
        urlopen(address, timeout=60).close()
        assert silent[0].recv(1) == b""  # each is closed after some seconds


def test_malformed_messages_are_one_line_and_a_count(viewer: Command) -> None:
    """Before, each printed a traceback, so a browser could fill the terminal, or the disk behind it."""
    connect = pytest.importorskip("websockets.sync.client").connect
    address = urlsplit(address_of(viewer))
    with urlopen(address.geturl(), timeout=60) as answer:
        cookie = answer.headers["set-cookie"].partition(";")[0]
    page = f"http://{address.netloc}"
    with urlopen(Request(page, headers={"cookie": cookie}), timeout=60) as answer:
        client = re.search(rb"[0-9a-f]{8}-[0-9a-f-]{27}", answer.read())
    assert client is not None
    asked = f"client_id={client[0].decode()}&next_message_id=0&tab_id=t&implicit_handshake=false&document_id=d"
    ws = f"ws://{address.netloc}/_nicegui_ws/socket.io/?EIO=4&transport=websocket&old_tab_id=&{asked}"
    with connect(ws, additional_headers={"cookie": cookie}, origin=page) as browser:
        browser.send("40")
        for malformed in ['42["handshake"]', "42[", "42{}", '42["event", 1]'] * 5:
            browser.send(malformed)
        browser.send('42["no_such_event", 1]')
    viewer.send(SIGINT)
    assert viewer.status() == 130
    assert "Traceback" not in viewer.printed
    assert viewer.printed.count("an error of the page") == 1
    assert re.search(r"the page had \d+ errors in all", viewer.printed)


def test_a_second_ctrl_c_prints_no_traceback(log: Path) -> None:
    pytest.importorskip("nicegui", reason="the extra [view] is not installed")
    with Command("view", log, "--no-open") as viewer:
        urlopen(address_of(viewer), timeout=60).close()  # it serves, so the signals are the server's
        viewer.send(SIGINT)
        wait_for(lambda: viewer.over or not pending(viewer.pid, SIGINT), 60.0, "the first Ctrl-C")  # or both are one
        viewer.send(SIGINT)
        assert viewer.status() == 130
        assert "Traceback" not in viewer.printed


def pending(pid: int, number: Signals) -> bool:
    """Whether a signal to a process waits until the process takes it."""
    (waiting,) = re.findall(r"^ShdPnd:\s*([0-9a-f]+)", Path(f"/proc/{pid}/status").read_text(), re.MULTILINE)
    return bool(int(waiting, 16) & 1 << number - 1)
