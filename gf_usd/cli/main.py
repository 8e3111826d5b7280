"""The program ``gf-usd``: its commands, and the exit status of each.

Exit status: 0 done, 1 failed while baking, 2 wrong usage, 3 the input was refused, 4
the result is wrong, or has warnings under --strict, 5 a slice is complete, 130 and 143 interrupted
(docs/guide/warnings-and-errors.md).
"""

from __future__ import annotations

import gc
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import FrameType
from typing import Annotated, Any, NoReturn

import typer

from gf_usd.cli import exit, folder_options
from gf_usd.cli.bake import bake
from gf_usd.cli.batch.command import batch
from gf_usd.cli.check import check
from gf_usd.cli.compare import compare
from gf_usd.cli.deliver import deliver
from gf_usd.cli.exit import leave, prepare_to_leave
from gf_usd.cli.fit import fit
from gf_usd.cli.help import HelpfulCommand
from gf_usd.cli.info import inputs, materials, schema_path
from gf_usd.cli.inspect import inspect
from gf_usd.cli.misuse import WrongUsage, usage_message
from gf_usd.cli.options import signed
from gf_usd.cli.preview import preview, thumbnails
from gf_usd.cli.refused_files import refusal
from gf_usd.cli.report import report, view
from gf_usd.cli.retime import retime
from gf_usd.cli.serve import serve
from gf_usd.cli.streams import guarded, open_closed
from gf_usd.cli.topics import TOPICS, topic
from gf_usd.cli.verify import verify
from gf_usd.cli.worker import follow, forked_readers, make_ready
from gf_usd.core import __version__
from gf_usd.core.errors import BakeError, GfUsdError, Unfinished, UsageError
from gf_usd.system.atomic_files import require_working_folder
from gf_usd.system.fast_start.imports import install
from gf_usd.system.processes import end_with_parent

STOPPED: dict[int, str] = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}

COMMANDS: dict[str, tuple[Callable[..., None], dict[str, Any]]] = {
    "bake": (bake, {"short_help": "Turn an asset into a soft body and write its motion."}),
    "batch": (batch, {"short_help": "Bake many assets and materials, in parallel."}),
    "serve": (serve, {"short_help": "Keep warm processes for bakes from other programs."}),
    "inspect": (inspect, {"short_help": "Report on an asset before a bake, with the cost."}),
    "inputs": (inputs, {"short_help": "List every file of an asset."}),
    "preview": (preview, {"short_help": "Draw a picture, a contact sheet or a film."}),
    "report": (report, {"short_help": "Write an HTML page with the motion and its curves."}),
    "deliver": (deliver, {"short_help": "Write a bake as joints or blend shapes (usdz, glTF)."}),
    "retime": (retime, {"short_help": "Write a bake at another speed, without simulating."}),
    "view": (view, {"short_help": "Play the motion in a window."}),
    "check": (check, {"short_help": "Check a USD file; every finding says how to fix it."}),
    "compare": (compare, {"short_help": "Measure the distance between two motions."}),
    "fit": (fit, {"short_help": "Find the material values that reproduce a motion."}),
    "verify": (verify, {"short_help": "Compare the solver with closed forms and references."}),
    "materials": (materials, {"short_help": "List the material presets."}),
    "schema-path": (schema_path, {"short_help": "Print the folder of the USD schema."}),
    "help": (topic, {"short_help": "Explain a topic or a command."}),
    "thumbnails": (thumbnails, {"hidden": True}),
}


def _show_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"gf-usd {__version__}")
        raise typer.Exit


def _main(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_show_version, is_eager=True, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    pass


def program(
    names: Iterable[str] = COMMANDS, defaults: Mapping[str, Any] | None = None
) -> typer.Typer:
    """The command line with these commands; defaults : of the options of each, by its name."""
    made = typer.Typer(
        name="gf-usd",
        help="Turn USD and mesh assets into soft bodies, without changing the files.",
        no_args_is_help=True,
        rich_markup_mode=None,  # units are in square brackets, which the markup would remove
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"], "default_map": defaults or {}},
    )
    made.callback()(_main)
    for name in names:
        function, settings = COMMANDS[name]
        made.command(name=name, cls=HelpfulCommand, **settings)(signed(name, function))
    return made


def _of_folder(arguments: Sequence[str]) -> dict[str, Any]:
    """Defaults that a gf-usd.toml gives the command, and a note on them."""
    found = folder_options.find(Path.cwd()) if folder_options.wanted(arguments) else None
    if found is None:
        return {}
    if not {"-q", "--quiet"} & {*arguments}:
        typer.echo(f"note: {found.note}", err=True)
    return {arguments[0]: found.of(arguments[0])}


def run() -> NoReturn:
    """Run the command line of this process, and end it with the exit status."""
    # The products here are too small for threads of BLAS, which spin for 25 ms after each, and
    # sums that threads share depend on their number.
    for library in ("OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    open_closed()
    prepare_to_leave()
    for number in STOPPED:
        signal.signal(number, _stop)
    end_with_parent()
    # Nearly all objects exist until the command ends: cycles are collected less often.
    gc.set_threshold(300_000, 20, 20)
    install()
    leave(execute(sys.argv[1:]))


def execute(arguments: Sequence[str]) -> int:
    """Run the command line with these arguments; returns the exit status.

    An expected error is printed to stderr, without a traceback.
    """
    exit.watch([])  # of a bake that ran before in this process
    with guarded() as broken:
        try:
            return _execute(arguments)
        except OSError as error:
            if found := refusal(error):
                fault, hint = found
                left = exit.message()  # of a bake that had begun
                fault = "; ".join(filter(None, (fault, left)))
                typer.echo(f"error: {fault}\n\nhint: {hint}", err=True)
                return (BakeError if left else UsageError).exit_status
            if error not in broken:
                raise
            typer.echo(f"error: the output cannot be written: {error.strerror}", err=True)
            return 1


def _execute(arguments: Sequence[str]) -> int:
    if len(arguments) == 2 and arguments[0] == "help" and arguments[1] in {*COMMANDS} - {*TOPICS}:
        arguments = (arguments[1], "--help")
    first = arguments[:1]
    # Typer goes through the options of all registered commands before it runs one.
    chosen = first if first and first[0] in COMMANDS else COMMANDS
    try:
        require_working_folder()
        ended = program(chosen, _of_folder(arguments))(
            args=list(arguments), prog_name="gf-usd", standalone_mode=False
        )
        return ended if isinstance(ended, int) else 0
    except WrongUsage as error:
        if not arguments:  # without any the help is the answer
            error.show()
            return error.exit_code
        called = f"gf-usd {first[0]}" if first and first[0] in COMMANDS else "gf-usd"
        typer.echo(f"error: {usage_message(error, called)}", err=True)
        return error.exit_code
    except GfUsdError as error:
        text = str(error) if isinstance(error, Unfinished) else f"error: {error}"
        typer.echo(text, err=True)
        return error.exit_status
    except SystemExit as end:
        if isinstance(end.code, int):
            return end.code
        raise
    return 0


def worker(
    descriptor: Annotated[int, typer.Argument(help="Its socket.")],
    ready: Annotated[bool, typer.Option("--ready", help="Import all before the first.")] = False,
) -> None:
    """Run the bakes of a batch or of a server one after the other."""
    forks = forked_readers()
    if ready:
        make_ready()
    sys.exit(follow(descriptor, execute, forks))


COMMANDS["worker"] = (worker, {"hidden": True})


LATER = 0.05  # [s]
BOOTSTRAP = "<frozen importlib._bootstrap>"  # the file of the code that imports modules


def _stop(number: int, frame: FrameType | None) -> None:
    if _in_usd(frame) or _is_callback(frame):
        # The import of USD, and what called a callback, continue after an exception within it.
        again = threading.Timer(LATER, _signal_main_thread, (number,))
        again.daemon = True
        again.start()
        return
    # a second one ends it at once, also where the first waits for a disk that does not answer
    for again in STOPPED:
        signal.signal(again, signal.SIG_DFL)
    # typer ends a KeyboardInterrupt without a message
    typer.echo("; ".join(filter(None, (STOPPED[number], exit.message()))), err=True)
    sys.exit(128 + number)


def _signal_main_thread(number: int) -> None:
    """Send a signal to the main thread, which runs the handlers, also where it waits for something.

    `signal.raise_signal` sends it to the calling thread: a main thread that waits is not woken.
    """
    if sys.platform == "win32":
        signal.raise_signal(number)
    else:
        signal.pthread_kill(threading.main_thread().ident or 0, number)


def _is_callback(frame: FrameType | None) -> bool:
    """Whether a frame is the callback of a weak reference to the lock of an import."""
    code = frame.f_code if frame else None
    return code is not None and (code.co_filename, code.co_name) == (BOOTSTRAP, "cb")


def _in_usd(frame: FrameType | None) -> bool:
    """Whether a frame, or one that called it, is Python code of USD, which C++ may have called."""
    while frame is not None:
        if str(frame.f_globals.get("__name__")).partition(".")[0] == "pxr":
            return True
        frame = frame.f_back
    return False
