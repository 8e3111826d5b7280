"""Commands that warm processes run in tests."""

from __future__ import annotations

# Commands of a worker instead of those of gf-usd, which take a second to load.
SCRIPT = """
import json, os, signal, sys, time
from gf_usd.cli.worker import follow
from gf_usd.system.file_locks import inherited
from pathlib import Path

def command(arguments):
    name, *rest = arguments[: arguments.index("--events")]
    if name == "early":
        return 2
    events = os.fdopen(int(arguments[-1]), "w")
    events.write(json.dumps({"event": name, "process": os.getpid()}) + "\\n")
    events.close()
    print("says", name, file=sys.stderr)
    if name == "where":
        print(os.getcwd(), file=sys.stderr)
        return 1
    if name == "raise":
        raise KeyError("unforeseen")
    if name == "kill":
        os.kill(os.getpid(), signal.SIGSEGV)
    if name == "sleep":
        time.sleep(60)
    if name == "spin":
        end = time.process_time() + 0.2
        while time.process_time() < end:
            pass
    if name == "locked":
        return 0 if inherited(Path(rest[0])) else 1
    return int(rest[0]) if rest else 0

sys.exit(follow(int(sys.argv[1]), command))
"""
