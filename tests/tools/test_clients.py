"""The installation of other programs by ``tools/clients.py``."""

from __future__ import annotations

import shutil
import subprocess
from collections import namedtuple

import pytest

from tools import clients

Usage = namedtuple("Usage", "total used free")


@pytest.mark.parametrize("name", list(clients.CLIENTS))
def test_nothing_is_installed_on_a_full_disk(name, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(shutil, "disk_usage", lambda path: Usage(10**12, 10**12 - 10**7, 10**7))
    monkeypatch.setattr(subprocess, "run", lambda *args, **options: asked.append(args))
    with pytest.raises(clients.NotInstalled) as raised:
        clients.set_up(name, tmp_path / "none" / "yet", [])
    needed = clients.SPACE * clients.CLIENTS[name].megabytes
    assert f"{tmp_path}: 10 MB" in str(raised.value)
    assert f"{needed:,.0f} MB are needed\nhint: " in str(raised.value)
    assert not asked
    assert not (tmp_path / "none").exists()
