"""The server of warm processes: one user's commands, each with its own end."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from warm_commands import SCRIPT

from gf_usd.core.errors import UsageError
from gf_usd.system.processes import Children
from gf_usd.system.warm import local_socket
from gf_usd.system.warm.client import events, status
from gf_usd.system.warm.local_socket import connect, listening_socket, socket_path
from gf_usd.system.warm.server import Server
from gf_usd.system.warm.workers import Workers

pytestmark = pytest.mark.skipif(not local_socket.AVAILABLE, reason="no Unix sockets here")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Of a socket; a temporary folder of pytest may be too long for one."""
    tmp_path.chmod(0o700)
    os.chdir(tmp_path)
    return Path("s")


@contextlib.contextmanager
def serving(path: Path, **how: Any) -> Iterator[Server]:
    children = Children()
    workers = Workers(children, [sys.executable, "-c", SCRIPT])
    server = Server(lambda request: list(request["arguments"]), workers, children, **how)
    with listening_socket(path) as end:
        thread = threading.Thread(target=server.run, args=(end,))
        thread.start()
        try:
            yield server
        finally:
            server.stop()
            thread.join()
            workers.close()


@pytest.fixture(autouse=True)
def _back() -> Iterator[None]:
    folder = Path.cwd()
    yield
    os.chdir(folder)


def ask(path: Path, *arguments: str, **more: Any) -> tuple[int, dict[str, Any]]:
    """The process that ran a command, and the end of it."""
    *answers, ended = events(path, {"arguments": arguments, **more})
    assert ended["event"] == "ended"
    return (answers[0].get("process", 0) if answers else 0), ended


def _is_gone(process: int) -> bool:
    """Whether a process ends within half a minute."""
    until = time.monotonic() + 30.0
    with contextlib.suppress(ProcessLookupError):
        while time.monotonic() < until:
            os.kill(process, 0)
            time.sleep(0.02)
        return False
    return True


def test_commands_follow_each_other_and_a_crash_harms_none(path: Path, tmp_path: Path) -> None:
    with serving(path):
        one, first = ask(path, "well")
        two, where = ask(path, "where", folder=str(tmp_path))
        three, killed = ask(path, "kill")
        four, late = ask(path, "sleep", timeout=0.3)
        five, last = ask(path, "well")
        assert one == two
        assert len({two, three, four, five}) == 4
        assert first["status"] == last["status"] == 0
        assert str(tmp_path) in where["log"]
        assert killed["status"] == -signal.SIGSEGV
        assert late["timed_out"]
        assert not last["timed_out"]
    assert not path.exists()
    assert not list(tmp_path.iterdir())


def test_a_command_ends_with_its_connection(path: Path) -> None:
    with serving(path):
        client = connect(path)
        assert client is not None
        with client, client.makefile() as lines:
            client.sendall(json.dumps({"arguments": ["sleep"]}).encode() + b"\n")
            process = json.loads(lines.readline())["process"]
        assert _is_gone(process)


def test_what_is_no_request_is_refused_in_words(path: Path) -> None:
    with serving(path):
        for line in (b"bake\n", b"[1]\n", b"\xff\n", b"{}", b"[" * 100_000 + b"\n"):
            client = connect(path)
            assert client is not None
            with client, client.makefile() as lines:
                client.sendall(line)
                client.shutdown(socket.SHUT_WR)
                answers = [json.loads(one) for one in lines]
            assert [one["event"] for one in answers] == ["error", "ended"]
            assert "one line with a JSON object" in answers[0]["message"]
            assert answers[1]["status"] == 2
        _, ended = ask(path, "well", folder="nowhere")
        assert ended["status"] == 2
        for folder in (3, ["x"], "/nowhere"):
            error, ended = events(path, {"arguments": ["well"], "folder": folder})
            assert "is not the absolute path of a folder" in error["message"]
            assert ended["status"] == 2
        for question in ({"ask": "time"}, {"ask": ""}, {"ask": "stop", "arguments": ["well"]}):
            error, ended = events(path, question)
            assert "a request asks" in error["message"]
            assert ended["status"] == 2
        for seconds in ("soon", 0, -1.0, True, float("nan")):
            error, ended = events(path, {"arguments": ["well"], "timeout": seconds})
            assert '"timeout" is' in error["message"]
            assert ended["status"] == 2


def test_status_and_stop(path: Path) -> None:
    assert status(path) is None
    with serving(path):
        ask(path, "well")
        state = status(path)
        assert state is not None
        assert (state["pid"], state["running"], state["done"]) == (os.getpid(), 0, 1)
        running = events(path, {"arguments": ["sleep"]})
        assert next(running)["event"] == "sleep"
        state = status(path, stop=True)
        assert state is not None
        assert state["running"] == 1
        assert next(running)["status"] == -signal.SIGTERM, "the server ends what runs"
        assert next(running, None) is None
    assert status(path) is None


def test_a_server_without_commands_ends(path: Path) -> None:
    children = Children()
    workers = Workers(children, [sys.executable, "-c", SCRIPT])
    server = Server(lambda request: list(request["arguments"]), workers, children, idle=0.1)
    with listening_socket(path) as end:
        server.run(end)
    workers.close()


def test_one_server_at_a_path_and_a_dead_ones_socket_is_replaced(path: Path) -> None:
    with (
        serving(path),
        pytest.raises(UsageError, match="another gf-usd serve is already listening"),
        listening_socket(path),
    ):
        pass
    code = (
        "import os, sys; from pathlib import Path;"
        " from gf_usd.system.warm.local_socket import listening_socket\n"
        f"with listening_socket(Path({str(path)!r})): os.kill(os.getpid(), 9)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == -9
    assert path.is_socket()
    with serving(path):
        assert ask(path, "well")[1]["status"] == 0


def test_only_this_user_may_connect(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with serving(path):
        assert path.stat().st_mode & 0o077 == 0
        monkeypatch.setattr(local_socket.os, "getuid", lambda: 12345)
        with pytest.raises(UsageError, match="belongs to another user"):
            connect(path)
    monkeypatch.undo()
    Path().resolve().chmod(0o755)
    with pytest.raises(UsageError, match="has mode 755"), listening_socket(path.absolute()):
        pass


def test_the_path_is_named_or_the_users(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("GF_USD_SOCKET", "/a/b")
    assert socket_path() == Path("/a/b")
    monkeypatch.delenv("GF_USD_SOCKET")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert socket_path() == tmp_path / "gf-usd" / "serve.sock"
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    assert str(os.getuid()) in str(socket_path())
    with pytest.raises(UsageError, match="at most 100 bytes"), listening_socket(Path("a" * 101)):
        pass


@pytest.mark.parametrize(("mode", "mended"), [(0o755, True), (0o1777, False)])
def test_a_folder_for_everybody_is_not_to_be_made_private(
    tmp_path: Path, mode: int, mended: bool
) -> None:
    """`chmod 700 /tmp` would break the machine; a folder of the user's own may have it."""
    folder = tmp_path / "shared"
    folder.mkdir()
    folder.chmod(mode)
    with pytest.raises(UsageError) as refused, listening_socket(folder / "s"):
        pass
    assert f"has mode {mode:o}: other users" in refused.value.message
    assert (f"chmod 700 {folder}" in refused.value.hint) == mended
    assert "give another --socket" in refused.value.hint
