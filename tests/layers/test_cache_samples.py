"""How the samples of a frame reach a cache: at once, and on the disk with their time range."""

from __future__ import annotations

from pathlib import Path

from pxr import Sdf, Tf, Usd
from small_sources import PLAIN

from gf_usd.layers.cache import CacheWriter
from gf_usd.system.atomic_files import partial_path


def writer_of(tmp_path: Path, frames: int, **options: object) -> tuple[CacheWriter, list]:
    asset, particles, info, made = PLAIN.scene(tmp_path, frames=frames)
    return CacheWriter(tmp_path / "a.cache.usdc", asset, particles, info, **options), made


def test_a_stage_is_notified_of_a_frame_once(tmp_path: Path) -> None:
    writer, frames = writer_of(tmp_path, 3, save_every=10)
    changes: list[int] = []
    listener = Tf.Notice.RegisterGlobally(
        Usd.Notice.ObjectsChanged,
        lambda notice, _: changes.append(len(notice.GetChangedInfoOnlyPaths())),
    )
    with writer:
        writer.write(frames[0])
        changes.clear()
        writer.write(frames[1])
        assert len(changes) == 1
        assert changes[0] > 20, "positions and points, velocities, extents, two dozen of health"
        writer.write(frames[2])
        assert len(changes) == 2
    listener.Revoke()


def test_each_file_on_the_disk_says_how_far_it_goes(tmp_path: Path) -> None:
    writer, frames = writer_of(tmp_path, 4, save_every=2)
    start = frames[0].time_code
    with writer:
        for count, frame in enumerate(frames, 1):
            writer.write(frame)
            writer._settle()
            copy = tmp_path / f"{count}.usdc"
            copy.write_bytes(partial_path(tmp_path / "a.cache.usdc").read_bytes())
            layer = Sdf.Layer.FindOrOpen(str(copy))
            saved = count // 2 * 2
            assert layer.endTimeCode == start + max(saved - 1, 0)
            times = layer.ListAllTimeSamples()
            assert len(times) == saved
