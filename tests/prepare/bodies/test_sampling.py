"""How the bodies of a bake are filled."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hostile_files import STAGE

from gf_usd.core.errors import InputError
from gf_usd.geometry.connected import bodies
from gf_usd.pipeline.prepared import prepare


@pytest.mark.parametrize("size", [{"particles": 10**12}, {"spacing": 1e-6}])
def test_too_many_particles_are_refused_before_surfaces_are_sampled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, size: dict[str, Any]
) -> None:
    """Which surfaces meet is looked up at samples one spacing apart: it took 8 CPU seconds."""
    asset = tmp_path / "a.usda"
    asset.write_text(STAGE, encoding="utf-8")
    monkeypatch.setattr(bodies, "_skins", None)  # which samples them
    with pytest.raises(InputError, match=r"would take .* particles \(at most 50000000\)"):
        prepare(asset, **size)
