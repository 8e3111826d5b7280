"""A child that crashes, hangs, eats memory or fails is reported in words; its files go with it."""

from __future__ import annotations

import os
import signal
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from gf_usd.core.errors import InputError, UsageError
from gf_usd.pipeline.inspect import inspect
from gf_usd.pipeline.run import prepare
from gf_usd.readers.trial import read_untrusted, try_asset
from gf_usd.system.sandbox import Limits, attempt, parse_limits

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="nothing is isolated here")


def crash() -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def hang() -> None:
    time.sleep(60.0)


def eat() -> None:
    bytearray(10**13)


def fail() -> None:
    raise KeyError("points")


def vanish() -> None:
    os._exit(7)


@pytest.mark.parametrize(
    ("work", "words"),
    [
        (crash, "made its reader crash (signal 11, SIGSEGV)"),
        (hang, "took longer than 0.2 s"),
        (eat, "asked for more than 16 GB"),
        (fail, "made its reader fail: KeyError: 'points'"),
        (vanish, "made its reader crash (without a word)"),
    ],
)
def test_what_goes_wrong_is_said(tmp_path: Path, work: Callable[[], None], words: str) -> None:
    file = tmp_path / "a.usda"
    file.write_text("#usda 1.0\n")
    seconds = 0.2 if work is hang else 60.0
    with pytest.raises(InputError) as caught:
        attempt(file, work, Limits(time=seconds))
    assert words in caught.value.message
    assert str(file) in caught.value.message
    assert caught.value.hint


def test_a_refusal_is_left_to_the_parent_and_temporary_files_go(tmp_path: Path) -> None:
    file, seen = tmp_path / "a.usda", tmp_path / "seen"
    file.write_text("#usda 1.0\n")

    def refuse() -> None:
        with tempfile.NamedTemporaryFile(delete=False) as left:
            seen.write_text(left.name)
        raise InputError("no", "none")

    attempt(file, refuse, Limits())
    assert seen.read_text()
    assert not Path(seen.read_text()).exists()


def test_a_refusal_for_want_of_memory_is_not_tried_again_without_a_limit(tmp_path: Path) -> None:
    file = tmp_path / "a.usdc"
    file.write_bytes(b"PXR-USDC")

    def refuse() -> None:
        raise InputError("a.usdc is damaged: Encountered: std::bad_alloc", "none")

    with pytest.raises(InputError, match="asked for more than 16 GB"):
        attempt(file, refuse, Limits())


def test_output_is_limited(tmp_path: Path) -> None:
    file, large = tmp_path / "a.usda", tmp_path / "large"
    file.write_text("#usda 1.0\n")
    with pytest.raises(InputError, match="OSError"):
        attempt(file, lambda: large.write_bytes(bytes(5000)), Limits(output=1000))
    assert large.stat().st_size <= 1000


def test_limits_are_parsed() -> None:
    assert parse_limits(None) == Limits()
    assert parse_limits("none") is None
    asked = parse_limits("time=2.5, memory=8G,output=10M")
    assert asked == Limits(time=2.5, memory=8e9, output=1e7)


@pytest.mark.parametrize(
    "text", ["", "time", "time=0", "time=-1", "size=3", "memory=8X", "time=nan"]
)
def test_wrong_limits_are_refused(text: str) -> None:
    with pytest.raises(UsageError, match="is no limit"):
        parse_limits(text)


def words_that_fail() -> None:
    b"\xff".decode()


def quoting() -> None:
    class Quoting(RuntimeError):
        def __str__(self) -> str:
            return b"\xff".decode()

    raise Quoting


@pytest.mark.parametrize(
    ("work", "words"),
    [(words_that_fail, "UnicodeDecodeError: "), (quoting, "Quoting: its words are not UTF-8")],
)
def test_errors_of_others_are_named(tmp_path: Path, work: Callable[[], None], words: str) -> None:
    file = tmp_path / "a.usda"
    file.write_text("#usda 1.0\n")
    with pytest.raises(InputError, match=words) as caught:
        attempt(file, work, Limits())
    assert "worth a report" in caught.value.hint


def crash_in_child(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gf_usd.readers.trial.read_untrusted", lambda path, **options: crash())


@pytest.mark.parametrize("look", [prepare, inspect])
def test_options_are_judged_before_a_file_is_tried(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, look: Callable[..., object]
) -> None:
    crash_in_child(monkeypatch)
    file = tmp_path / "a.usda"
    file.write_text("#usda 1.0\n")
    with pytest.raises(UsageError, match="--fps is 0"):
        look(file, fps=0.0, limits=Limits())
    with pytest.raises(UsageError, match="there is no material"):
        look(file, material="ruber", limits=Limits())
    with pytest.raises(InputError, match="made its reader crash"):
        look(file, limits=Limits())


def test_what_a_child_reads_with_is_imported_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else child and parent import it one after the other."""
    seen = tmp_path / "seen"

    def note(path: Path, **options: object) -> None:
        before = set(sys.modules)
        read_untrusted(path)
        seen.write_text("\n".join(m for m in set(sys.modules) - before if m.startswith("gf_usd")))

    file = tmp_path / "a.usda"
    file.write_text('#usda 1.0\ndef Sphere "Ball" {}\n')
    monkeypatch.setattr("gf_usd.readers.trial.read_untrusted", note)
    try_asset(file, Limits())
    assert seen.read_text() == ""


def starts(folder: Path, seconds: float, work: Callable[[int], None]) -> tuple[int, str]:
    """How many children there were that did `work` with their number, and what came of it."""
    folder.mkdir()
    file, count = folder / "a.usda", folder / "starts"
    file.write_text("#usda 1.0\n")

    def counted() -> None:
        with count.open("a") as out:
            out.write("x")
        work(len(count.read_text()))

    try:
        attempt(file, counted, Limits(time=seconds))
        said = ""
    except InputError as error:
        said = error.message
    return len(count.read_text()), said


def test_a_child_that_stands_still_is_tried_again(tmp_path: Path) -> None:
    def once(number: int) -> None:
        if number == 1:
            hang()

    assert starts(tmp_path / "once", 0.5, once) == (2, "")
    tried, said = starts(tmp_path / "ever", 0.5, lambda _: hang())
    assert tried == 2
    assert "took longer than 0.5 s" in said


def test_a_child_that_works_all_its_time_is_not(tmp_path: Path) -> None:
    def busy(_: int) -> None:
        while True:
            pass

    tried, said = starts(tmp_path / "busy", 1.0, busy)
    assert tried == 1
    assert "took longer than 1 s" in said
