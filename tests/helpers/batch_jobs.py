"""What the tests of batches share: jobs, and outcomes of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gf_usd.batch.job import Job, Outcome

# a triangle says enough where nothing is baked
TRIANGLE = """#usda 1.0
(
    defaultPrim = "A"
)
def Mesh "A"
{
    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
}
"""


def job(folder: Path, name: str = "a.rubber", **options: Any) -> Job:
    """A job of a small asset, which is written."""
    asset = folder / "a.usda"
    asset.write_text(TRIANGLE, encoding="utf-8")
    return Job(name=name, asset=asset, root=folder / "out" / f"{name}.usda", options=options)


def outcome(name: str, state: str, **more: Any) -> Outcome:
    return Outcome(job=name, state=state, **more)
