"""Small pictures of results, drawn in processes of their own and kept beside them."""

from __future__ import annotations

import base64
import io
import json
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from PIL import Image

from gf_usd.batch.child import Children

AT_ONCE = 50  # pictures of one process: starting it takes as long as drawing ten
PATIENCE = 60.0  # [s] for one picture
QUALITY = 80  # of a JPEG on the page: a few kilobytes a job


def picture_of(root: Path) -> Path:
    """``duck.rubber.usda`` -> ``duck.rubber.png``."""
    return root.with_suffix(".png")


def draw(roots: Sequence[Path], *, at_once: int) -> dict[Path, str]:
    """Draw what has no picture that is newer; why not, for those that could not be drawn."""
    todo = [root for root in roots if not _is_new(root)]
    share = max(1, min(AT_ONCE, -(-len(todo) // at_once)))
    groups = [todo[i : i + share] for i in range(0, len(todo), share)]
    failed: dict[Path, str] = {}
    children = Children()
    with ThreadPoolExecutor(max_workers=at_once) as pool:
        try:
            for found in pool.map(lambda group: _draw_some(children, group), groups):
                failed.update(found)
        finally:
            # an interrupt is not to wait for the rest
            children.stop()
    return failed


def _is_new(root: Path) -> bool:
    try:
        return picture_of(root).stat().st_mtime_ns >= root.stat().st_mtime_ns
    except OSError:
        return False


def _draw_some(children: Children, roots: Sequence[Path]) -> dict[Path, str]:
    failed, left = dict[Path, str](), list(roots)
    while left:
        command = [sys.executable, "-m", "gf_usd", "thumbnails", *map(str, left)]
        ended = children.run(command, lambda line: None, timeout=PATIENCE + len(left))
        if ended is None or ended.stopped:
            break
        for line in ended.out[: ended.out.rfind("\n") + 1].splitlines():
            row = json.loads(line)
            root = Path(row["root"])
            left.remove(root)
            if "error" in row:
                failed[root] = row["error"]
        if left:
            # what it was at when it died; the others get another process
            failed[left.pop(0)] = f"drawing it ended with status {ended.status}"
    return failed


def data_uri(picture: Path) -> str:
    """A picture as part of a page, as JPEG; "" where there is none that can be read."""
    out = io.BytesIO()
    try:
        with Image.open(picture) as image:
            image.convert("RGB").save(out, "JPEG", quality=QUALITY)
    except (OSError, ValueError, SyntaxError):
        return ""
    return "data:image/jpeg;base64," + base64.b64encode(out.getvalue()).decode("ascii")
