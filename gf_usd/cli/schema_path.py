"""gf-usd schema-path: where the schema library lies."""

from __future__ import annotations

import typer


def schema_path() -> None:
    """Print the folder of the gaussianFlesh schema, for PXR_PLUGINPATH_NAME of other programs."""
    from gf_usd.usd.schema import schema_path as locate

    typer.echo(str(locate()))
