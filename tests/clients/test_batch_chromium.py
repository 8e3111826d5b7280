"""The page of a batch in a browser: it sorts, filters and searches, and fetches nothing."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from gf_usd.batch.job import Job, Outcome
from gf_usd.batch.page import build_page
from gf_usd.batch.plan import BatchPlan

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser"))), None)
pytestmark = pytest.mark.skipif(
    CHROMIUM is None, reason="no Chromium is installed: apt-get install chromium"
)
NASTY = "<img src=x onerror=document.title='owned'>"


def outcomes() -> list[Outcome]:
    ends = [("duck", "done", 12.0), ("ball", "kept", 2.5), ("cow", "crashed", 100.0)]
    rows = [Outcome(job=n, state=s, seconds=t, command=f"gf-usd bake {n}") for n, s, t in ends]
    warned = Outcome(job="ape", state="done", seconds=7.0, health={"rollbacks": 3},
                     warnings=({"look": "rubber", "message": NASTY},))  # fmt: skip
    refused = Outcome(job="bad", state="refused", message=NASTY, hint="mend it")
    return [*rows, warned, refused]


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Any]:
    """The page, open; whatever a test did, nothing was fetched or logged."""
    from playwright.sync_api import sync_playwright

    jobs = tuple(
        Job(name=o.job, asset=tmp_path / f"{o.job}.usda", root=tmp_path / f"out/{o.job}.usda")
        for o in outcomes()
    )
    plan = BatchPlan(jobs=jobs, out=tmp_path / "out", title="toys", timeout=None, retries=1)
    file = tmp_path / "toys.batch.html"
    file.write_text(build_page(plan, outcomes(), {"seconds": 3.0}, {}), encoding="utf-8")
    flags = ["--no-sandbox"] if os.name == "posix" and os.geteuid() == 0 else []
    requests, messages = [], []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
        opened = browser.new_page(viewport={"width": 1500, "height": 800})
        opened.on("request", lambda request: requests.append(request.url))
        opened.on("console", lambda message: messages.append(message.text))
        opened.on("pageerror", lambda error: messages.append(str(error)))
        opened.goto(file.as_uri())
        yield opened
        assert opened.title() == "toys: 5 jobs"
        browser.close()
    assert requests == [file.as_uri()]
    assert messages == []


def shown(page: Any) -> list[str]:
    """Assets of the rows that can be seen, from the top."""
    names = page.locator("tbody tr:not([hidden]) .name small").all_inner_texts()
    return [name.removesuffix(".usda") for name in names]


def test_it_sorts_filters_and_searches(page: Any) -> None:
    assert shown(page) == ["cow", "bad", "ball", "ape", "duck"]
    assert page.locator("img").count() == 0
    head = page.locator("thead button", has_text="time [s]")
    head.click()
    # what has no number comes last, up and down
    assert shown(page) == ["ball", "ape", "duck", "cow", "bad"]
    head.click()
    assert shown(page) == ["cow", "duck", "ape", "ball", "bad"]
    page.locator("thead button", has_text="job").click()
    assert shown(page) == ["ape", "bad", "ball", "cow", "duck"]
    page.locator("thead button", has_text="state").click()
    assert shown(page)[:2] == ["cow", "bad"]
    page.click("[data-filter=bad]")
    assert sorted(shown(page)) == ["bad", "cow"]
    assert page.inner_text("#shown") == "2 of 5 shown"
    page.click("[data-filter=warned]")
    assert shown(page) == ["ape"]
    page.click("[data-filter=all]")
    page.fill("input[type=search]", "REFUSED bad")
    assert shown(page) == ["bad"]


def test_no_column_is_cut_off_and_details_open(page: Any) -> None:
    width = page.evaluate("document.querySelector('.card').clientWidth")
    assert page.evaluate("document.querySelector('.card').scrollWidth") <= width
    row = page.locator("tbody tr").first
    assert not row.locator(".command").is_visible()
    row.locator("summary").click()
    assert row.locator(".command").is_visible()
