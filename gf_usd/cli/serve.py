"""gf-usd serve: runs the bakes of other programs in warm processes; also ``bake --serve``."""

from __future__ import annotations

import json
import os
import signal
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from gf_usd.cli.events import STDOUT, event_stream
from gf_usd.cli.quiet import Quiet
from gf_usd.core import __version__
from gf_usd.core.errors import GfUsdError, UsageError
from gf_usd.system.atomic_files import is_utf8
from gf_usd.system.processes import KILLED, signal_name

if TYPE_CHECKING:
    from gf_usd.system.warm.server import Server

Socket = Annotated[
    Path | None,
    typer.Option("--socket", help="Listen at this socket.", show_default="GF_USD_SOCKET, else the"
                 " user's runtime folder"),
]  # fmt: skip
ARGUMENTS = ("arguments", "folder", "timeout", "version")  # keys of a request
JOB = ("asset", "root", "options", "name", "folder", "timeout", "version")
STOPPED = (signal.SIGINT, signal.SIGTERM)
READY = (sys.executable, "-m", "gf_usd", "worker", "--ready")


def serve(
    *,
    socket: Socket = None,
    at_once: Annotated[
        int,
        typer.Option(
            "--jobs", "-j", min=1, help="Number of bakes to run in parallel; others wait."
        ),
    ] = 1,
    timeout: Annotated[
        float | None,
        typer.Option(
            min=0.1, help="Time limit for bakes without one of their own [s].", show_default="none"
        ),
    ] = None,
    idle: Annotated[
        float | None,
        typer.Option(
            min=0.1, help="Stop after this time without a bake [s].", show_default="never"
        ),
    ] = None,
    status: Annotated[
        bool, typer.Option("--status", help="Print the status of the running server as JSON.")
    ] = False,
    stop: Annotated[bool, typer.Option("--stop", help="Stop the running server.")] = False,
    quiet: Quiet = False,
) -> None:
    """Run bakes for other programs in warm processes, over a local socket.

    From the second bake on, imports, kernels and caches are already loaded. Programs send jobs as
    JSON (docs/farm.md); in a shell, use gf-usd bake --serve.
    """
    from gf_usd.system.warm.local_socket import listening_socket, require_available, socket_path

    require_available()
    path = (socket or socket_path()).absolute()
    if status or stop:
        _ask(path, stop=stop)
        return
    from gf_usd.system.processes import Children
    from gf_usd.system.warm.server import Server
    from gf_usd.system.warm.workers import Workers

    children = Children()
    workers = Workers(children, READY)
    server = Server(arguments_of, workers, children, at_once=at_once, timeout=timeout, idle=idle)
    with listening_socket(path) as end:
        for number in STOPPED:
            signal.signal(number, lambda number, frame: _stop(server))
        workers.start_one()
        try:
            if not quiet:
                typer.echo(f"gf-usd {__version__} is listening at {path} (process {os.getpid()})",
                           err=True)  # fmt: skip
            server.run(end)
        finally:
            workers.close()
    if not quiet:
        typer.echo("ended", err=True)


def _stop(server: Server) -> None:
    """End the server; a second signal ends the process at once."""
    for number in STOPPED:
        signal.signal(number, signal.SIG_DFL)
    server.stop()


def _ask(path: Path, *, stop: bool) -> None:
    from gf_usd.system.warm.client import status

    reply = status(path, stop=stop)
    if reply is None:
        raise UsageError(f"no gf-usd serve is listening at {path}", "start one with gf-usd serve")
    typer.echo(json.dumps({k: v for k, v in reply.items() if k not in ("event", "time")}))


def arguments_of(request: Mapping[str, Any]) -> list[str]:
    """The arguments of ``gf-usd`` for a request: a job of a batch, or the arguments themselves.

    Raises UsageError for anything but a bake, for options that a manifest may not give, and for a
    client of another version.
    """
    known = ARGUMENTS if "arguments" in request else JOB
    if unknown := [key for key in request if key not in known]:
        raise UsageError(
            f"a request has {unknown[0]!r} next to {known[0]!r}",
            f"its keys are {', '.join(known)}",
        )
    if (version := request.get("version", __version__)) != __version__:
        raise UsageError(
            f"the server is gf-usd {__version__}, but its client is {version}",
            "stop it with gf-usd serve --stop, and start it again",
        )
    if "arguments" in request:
        arguments = request["arguments"]
        if not isinstance(arguments, list) or not all(isinstance(word, str) for word in arguments):
            raise UsageError(f'"arguments" is {arguments!r}', "give a list of strings")
        if unfit := [word for word in arguments if not _is_word(word)]:
            raise UsageError(f'"arguments" has {unfit[0]!r}', "give UTF-8 without null characters")
        if arguments[:1] != ["bake"] or "--serve" in arguments:
            raise UsageError(
                f"{' '.join(arguments[:2])!r} is not a bake",
                'the first of "arguments" must be "bake"',
            )
        return arguments
    from gf_usd.batch.job import Job
    from gf_usd.batch.manifest import checked
    from gf_usd.prepare.options.table import OPTIONS

    named = {"asset", "root"} - request.keys()
    if named or not isinstance(request.get("options", {}), dict):
        raise UsageError(
            f"a job has no {', '.join(sorted(named)) or 'object of options'}",
            'give {"asset": PATH, "root": PATH, "options": {...}}, with absolute paths',
        )
    for key in ("asset", "root"):
        path = request[key]
        if not isinstance(path, str) or not os.path.isabs(path):
            raise UsageError(f"{key!r} is {path!r}", "give an absolute path")
        if not _is_word(path):
            raise UsageError(f"{key!r} is {path!r}", "give UTF-8 without null characters")
    if request["root"].endswith("/") or os.path.isdir(request["root"]):
        raise UsageError(
            f"'root' is {request['root']!r}, a folder",
            "give the root layer: the path of a file that ends in .usda",
        )
    # null leaves an option out, as None does in Python
    requested = {
        key: value for key, value in request.get("options", {}).items() if value is not None
    }
    given = {name: row for name, row in OPTIONS.items() if name != "output"}  # that is the root
    options = checked(requested, "the request", given)
    job = Job(name="", asset=Path(request["asset"]), root=Path(request["root"]), options=options)
    return job.arguments()


def _is_word(text: str) -> bool:
    """Whether a command line could have it."""
    return "\0" not in text and is_utf8(Path(text))


def bake_by_server(
    asset: Path, options: Mapping[str, Any], *, as_json: bool, quiet: bool, events: str | None
) -> None:
    """``gf-usd bake --serve``: bake in a warm process of the running server.

    Raises UsageError where none runs, or one of another version; SystemExit where the bake fails.
    """
    from gf_usd.prepare.options.table import OPTIONS, arguments
    from gf_usd.system.warm.client import events as events_of
    from gf_usd.system.warm.local_socket import socket_path
    from gf_usd.system.warm.server import ENDED

    requested = {
        k: v for k, v in options.items()
        if v != (list(OPTIONS[k].default) if OPTIONS[k].repeated else OPTIONS[k].default)
    }  # fmt: skip
    request = {
        "arguments": ["bake", str(asset), *arguments(requested)],
        "folder": os.getcwd(),
        "version": __version__,
    }
    last: dict[str, dict[str, Any]] = {}
    warnings: list[dict[str, Any]] = []
    with event_stream(events) as emit:
        for event in events_of(socket_path(), request):
            kind = event["event"]
            last[kind] = event
            if kind == "warning":
                warnings.append(event)
            if kind == ENDED:
                break
            emit(kind, **{k: v for k, v in event.items() if k not in ("event", "time")})
            if not quiet:
                _tell(event)
    ended, result = last[ENDED], last.get("finished")
    if result is not None:
        if as_json:
            shown = {k: v for k, v in result.items() if k not in ("event", "time")}
            typer.echo(json.dumps(shown, indent=1))
        elif not quiet and events != STDOUT:
            typer.echo(_summary(result, warnings))
    if ended["status"]:
        typer.echo(failure(ended, last), err=True)
        # as in shells for a process that a signal ended
        raise SystemExit(ended["status"] if ended["status"] > 0 else 128 - ended["status"])


def _tell(event: Mapping[str, Any]) -> None:
    """Notes, and the progress after each tenth of the frames, on stderr."""
    if event["event"] == "note":
        typer.echo(f"note: {event['message']}", err=True)
    elif event["event"] == "frame":
        done, total = event["done"], event["total"]
        if done % max(1, total // 10) == 0 or done == total:
            typer.echo(f"frame {done}/{total}, {event['particles']} particles", err=True)


def _summary(result: Mapping[str, Any], warnings: Sequence[Mapping[str, Any]]) -> str:
    """The written files, and warnings."""
    reply = [
        f"warning: {w['variant']}: {w['message']} [{w['about']}]\n  hint: {w['hint']}"
        for w in warnings
    ]
    particles, seconds = result["particles"], result["seconds"]
    return "\n".join([*result["outputs"], f"{particles} particles, {seconds:.1f} s", *reply])


def failure(ended: Mapping[str, Any], last: Mapping[str, Mapping[str, Any]]) -> str:
    """Text on why a bake failed."""
    if ended["timed_out"]:
        return "error: it exceeded the timeout of the server"
    if "sliced" in last:
        return f"{last['sliced']['done']} of {last['sliced']['frames']} frames are done"
    if "error" in last:
        return f"error: {GfUsdError(last['error']['message'], last['error']['hint'])}"
    status = ended["status"]
    if status < 0:
        hint = (
            f"\n\nhint: {KILLED}: bake with fewer --particles" if status == -signal.SIGKILL else ""
        )
        return f"error: the process of the bake was ended by {signal_name(status)}{hint}"
    # Python's message of an unexpected exception is the last line
    told = (ended["log"].strip().splitlines() or ["no output"])[-1]
    return f"error: the process of the bake ended with status {status}: {told}"
