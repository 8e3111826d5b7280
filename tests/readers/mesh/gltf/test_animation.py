"""Keys of a glTF animation: what is between them, and what is refused."""

from __future__ import annotations

from pathlib import Path

import gltf_arm
import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from gf_usd.core.errors import InputError
from gf_usd.readers.mesh.gltf.animation import CUBIC, STEP, Channel, frame_times, read_animation
from gf_usd.readers.mesh.gltf.container import open_gltf
from gf_usd.readers.mesh.gltf.scene import read_gltf
from gf_usd.readers.notes import FLESH_KEEPS, Notes

TIMES = np.array([0.5, 1.0, 2.0])
AT = np.array([0.0, 0.5, 0.75, 1.0, 1.25, 1.999, 2.0, 3.0])


def test_values_are_straight_between_keys_and_stay_beyond() -> None:
    values = np.array([[0.0, 1.0, 2.0], [4.0, 1.0, 0.0], [4.0, -1.0, 8.0]])
    found = Channel(times=TIMES, values=values).at(AT)
    wanted = np.stack([np.interp(AT, TIMES, column) for column in values.T], 1)
    np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_a_step_holds_until_the_next_key() -> None:
    found = Channel(times=TIMES, values=np.array([[1.0], [2.0], [3.0]]), mode=STEP).at(AT)
    assert found.ravel().tolist() == [1, 1, 1, 2, 2, 2, 3, 3]
    early = Channel(times=TIMES, values=np.array([[1.0], [2.0], [3.0]]), mode=STEP)
    assert early.at(np.array([1.0 - 1e-7]), tolerance=1e-6).item() == 2.0


def test_rotations_go_the_shorter_arc_at_a_constant_rate() -> None:
    turns = Rotation.from_euler("xyz", [[0, 0, 0], [80, 20, 0], [-40, 90, 170]], degrees=True)
    q = turns.as_quat() * np.array([[1.0], [-1.0], [1.0]])  # the same rotations
    found = Channel(times=TIMES, values=q, turns=True).at(AT)
    wanted = Slerp(TIMES, turns)(np.clip(AT, TIMES[0], TIMES[-1]))
    off = (Rotation.from_quat(found).inv() * wanted).magnitude()
    np.testing.assert_allclose(off, 0.0, atol=1e-7)  # of arccos near 1


def test_a_cubic_spline_is_the_cubic_that_its_tangents_come_of() -> None:
    def cubic(t):
        return np.stack([2 * t**3 - t + 1, 0.5 * t**2], 1)

    slope = np.stack([6 * TIMES**2 - 1, TIMES], 1)
    channel = Channel(
        times=TIMES, values=cubic(TIMES), tangents=np.stack([slope, slope], 1), mode=CUBIC
    )
    np.testing.assert_allclose(channel.at(AT), cubic(np.clip(AT, 0.5, 2.0)), atol=1e-12)


@pytest.mark.parametrize(
    ("keys", "given", "rate", "frames"),
    [
        (np.arange(13) / 24.0, None, 24.0, 13),
        (np.arange(13) / 30.0, None, 30.0, 13),
        (np.arange(13) / 30.0, 60.0, 60.0, 25),
        (np.array([0.1, 0.1 + np.pi]), None, 24.0, 77),  # 75.4 frames: the last one stays
        (np.array([0.3]), None, 24.0, 1),
    ],
)
def test_frames_are_those_of_the_keys_or_as_asked(
    tmp_path: Path, keys: np.ndarray, given: float | None, rate: float, frames: int
) -> None:
    made = gltf_arm.maker(animated=False)
    values = np.zeros((len(keys), 3), np.float32)
    made.tree["animations"] = [{
        "samplers": [{
            "input": made.accessor(keys.astype(np.float32)), "output": made.accessor(values)
        }],
        "channels": [{"sampler": 0, "target": {"node": 3, "path": "translation"}}],
    }]  # fmt: skip
    animation = read_animation(open_gltf(gltf_arm.write(tmp_path, made)), Notes(), {})
    found, times = frame_times(animation, given, "arm.glb")
    assert (found, len(times)) == (rate, frames)
    np.testing.assert_allclose(times[0], keys[0], rtol=1e-6)


def test_the_first_of_several_is_read(tmp_path: Path) -> None:
    made = gltf_arm.maker()
    made.tree["animations"].append({"name": "run", "samplers": [], "channels": []})
    notes = Notes()
    animation = read_animation(open_gltf(gltf_arm.write(tmp_path, made)), notes, {})
    assert animation.nodes == {3, 4}
    assert "only the first of 2 animations is read: wave" in notes.lines()


def test_the_note_on_animations_names_flesh_where_there_is_a_skin(tmp_path: Path) -> None:
    made = gltf_arm.maker()
    ignored = "its animations are ignored: the pose of its nodes is used"
    assert f"{ignored}; {FLESH_KEEPS}" in read_gltf(gltf_arm.write(tmp_path, made)).notes
    for node in made.tree["nodes"]:
        node.pop("skin", None)
    del made.tree["skins"]
    assert ignored in read_gltf(gltf_arm.write(tmp_path, made)).notes


BROKEN = {
    "do not increase": lambda made, rows: rows[0].update(
        input=made.accessor(np.array([0.5, 0.5], np.float32))
    ),
    "rotation has 3 rows of 4 values": lambda made, rows: rows[0].update(
        output=made.accessor(np.ones((3, 4), np.float32))
    ),
    "unknown interpolation SMOOTH": lambda made, rows: rows[0].update(interpolation="SMOOTH"),
    "quaternion of length 0": lambda made, rows: rows[0].update(
        output=made.accessor(np.zeros((2, 4), np.float32))
    ),
    "does not refer to any of the 1": lambda made, rows: rows.pop(),
    "which has a matrix": lambda made, rows: made.tree["nodes"][3].update(
        matrix=np.eye(4).ravel().tolist()
    ),
    "is not a text": lambda made, rows: rows[0].update(interpolation=3),
}


@pytest.mark.parametrize("message", BROKEN)
def test_a_damaged_animation_is_refused(tmp_path: Path, message: str) -> None:
    made = gltf_arm.maker()
    BROKEN[message](made, made.tree["animations"][0]["samplers"])
    path = gltf_arm.write(tmp_path, made)
    with pytest.raises(InputError) as caught:
        read_animation(open_gltf(path), Notes(), {})
    assert message in caught.value.message
    assert str(path) in caught.value.message
    assert caught.value.hint


def test_an_animation_of_a_year_is_refused(tmp_path: Path) -> None:
    made = gltf_arm.maker()
    times = made.accessor(np.array([0.0, 3e7], np.float32))
    for row in made.tree["animations"][0]["samplers"]:
        row["input"] = times
    animation = read_animation(open_gltf(gltf_arm.write(tmp_path, made)), Notes(), {})
    with pytest.raises(InputError, match="frames at 24 frames per second"):
        frame_times(animation, None, "arm.glb")
