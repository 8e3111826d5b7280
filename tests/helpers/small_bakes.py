"""What the tests of the command line share: a small asset, and what a bake says by its JSON."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from gf_usd.core.frames.frame import Health

SAMPLES = Path(__file__).parents[2] / "samples"
SMALL = ("--particles", "300", "--frames", "6")
RESULT = [
    "root", "report", "particles", "frames", "seconds", "settings", "bakes", "warnings", "outputs",
    "notes", "check",
]  # fmt: skip
REPORT = {
    "command", "version", "source", "input_sha256", "bodies", "embedded", "riders", "particles",
    "spacing_m", "volume_m3", "radius_m", "materials", "frames", "fps", "start", "drop_m",
    "settings", "outputs", "notes", "seconds", "bakes", "warnings", "check", "pins", "rigid",
    "separate_bodies", "obstacles", "tables", "advice", "own_values",
}  # fmt: skip
BAKE = ["variant", "look", "cache", "material", "frames", "at_rest", "health"]
HEALTH = {
    "frames", "substeps", "substeps_max_per_frame", "rollbacks", "restitution",
    "frames_without_substeps", "flying_body_frames", "sleeping_body_frames",
    "deepest_penetration_m", "deepest_penetration_spacings", "penetration_at_end_spacings",
    "deepest_overlap_m", "deepest_overlap_spacings", "overlap_pair", "overlap_names",
    "overlap_frame",
    "released_max", "let_go_max",
    "inside_at_end_share", "inside_at_end_m", "inside_max_share", "inside_max_m",
    "outside_mesh_max_share", "outside_mesh_max_m", "outside_mesh", "outside_meshes",
    "expanded_volume", "expanded_body", "expanded_frame",
    "stretched_share", "stretched_body", "stretched_frame",
    "resting_penetration_m", "resting_penetration_spacings", "first_contact_frame", "min_J",
    "max_J", "min_stretch", "max_stretch", "inverted_particle_frames", "inverted_max",
    "inverted_at_end", "first_inverted_frame", "clamped_particle_frames", "clamped_share",
    "stress_capped_particle_frames", "stress_capped_share", "friction_capped", "energy_start_J",
    "energy_end_J", "energy_max_J", "energy_scale_J", "energy_gain_max_J", "energy_gain_max_share",
    "dissipated_J", "work_of_pins_J", "injected_J", "planes_J", "planes_gain_share", "momentum_end",
    "angular_momentum_end", "free_flight_frames", "momentum_drift", "angular_momentum_drift",
    "falls", "flesh", "shift_max_m", "kinetic_max_J", "settling_dissipation_J",
}  # fmt: skip
# no law flows, few frames are looked at for what is inside; "centre" until 1.0
FRAME = {"time_code", *Health.__dataclass_fields__, "centre", "energy", "energy_gain"} - {
    "plastic_dissipation", "conversion_dissipation", "converted", "inside_share", "inside_depth",
    "outside_share", "outside_depth", "outside_mesh", "expanded", "expanded_body",
    "stretched", "stretched_body",
    "overlap_pair", "overlap_names", "pierced", "pierced_through", "pierced_pair",
    "fallen", "fallen_kinetic", "lost", "flow_volume", "flow_per_cell",
}  # fmt: skip
ESTIMATE = {"substeps_per_frame", "estimated_seconds", "estimated_bytes", "first_contact_frame"}

# A block of 20 x 20 x 30 cm, two meters above the floor; centimeters, Z up, 48 frames per second.
BLOCK = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 0.01
    upAxis = "Z"
    timeCodesPerSecond = 48
    startTimeCode = 101
    endTimeCode = 110
)
def Xform "World" (
    kind = "component"
)
{
    def Mesh "Block"
    {
        uniform token subdivisionScheme = "none"
        float3[] extent = [(-10, -10, 200), (10, 10, 230)]
        point3f[] points = [
            (-10, -10, 200), (10, -10, 200), (10, 10, 200), (-10, 10, 200),
            (-10, -10, 230), (10, -10, 230), (10, 10, 230), (-10, 10, 230)
        ]
        int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
        int[] faceVertexIndices = [
            0, 3, 2, 1, 4, 5, 6, 7, 0, 1, 5, 4, 1, 2, 6, 5, 2, 3, 7, 6, 3, 0, 4, 7
        ]
        color3f[] primvars:displayColor = [(0.2, 0.4, 0.6)]
    }
}
"""


@dataclass(frozen=True)
class Done:
    """How a command ended."""

    status: int
    out: str
    err: str


def names(folder: Path) -> list[str]:
    """What lies in a folder."""
    return sorted(path.name for path in folder.iterdir())


def strict(text: str) -> dict:
    """JSON as its standard has it: Infinity and NaN are refused."""

    def refuse(word: str) -> None:
        raise AssertionError(f"{word} is no JSON")

    return json.loads(text, parse_constant=refuse)
