"""The page on the report explains every key that a report has."""

from __future__ import annotations

import re

from small_bakes import FRAME, HEALTH, REPORT

from gf_usd.core.frames.frame import Health
from tools.documents import ROOT


def test_every_key_of_a_report_is_explained() -> None:
    page = (ROOT / "docs/guide/report.md").read_text("utf-8")
    explained = set(re.findall(r"`(\w+)`", page))
    assert len(explained) > 100
    assert sorted({*REPORT, *HEALTH, *FRAME, *Health.__dataclass_fields__} - explained) == []
