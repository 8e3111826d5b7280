"""The root of the tests: every folder of them can import the helpers that lie here."""

from __future__ import annotations

# USD reads its schemas once: whichever test comes first, ours must be known before a stage opens.
import gf_usd.usd.schema  # noqa: F401
