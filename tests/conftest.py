"""Set-up of every test process."""

from __future__ import annotations

# USD reads its schemas once: whichever test comes first, ours must be known before a stage opens.
import gf_usd.system.usd_schema  # noqa: F401
