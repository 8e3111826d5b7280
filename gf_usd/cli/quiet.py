"""The option -q of commands."""

from typing import Annotated

import typer

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print only errors.")]
QuietExceptJson = Annotated[bool, typer.Option("--quiet", "-q", help="Print only errors and JSON.")]
