"""In Newton: read the TetMesh of a bake and let VBD simulate it, in free fall.

    python newton_tets.py STAGE PRIM FRAMES

Next to STAGE is written a file .json: `tets` and `points` as many as Newton read, `masses` of its
particles, `lame` parameters of its tetrahedra, `start` and `end` positions of the particles before
and after so many frames of 1/24 s, in steps of `step` s, and `gravity`.
"""

import json
import sys
from pathlib import Path

import newton
import newton_usd_schemas  # noqa: F401  (Newton's definitions of its API schemas)
import numpy as np
from pxr import Usd

SUBSTEPS = 10
FRAME = 1.0 / 24.0


def simulate(path, prim, frames):
    stage = Usd.Stage.Open(path)
    builder = newton.ModelBuilder(up_axis=newton.Axis.Y)
    builder.add_usd(stage, root_path=prim, load_visual_shapes=False)
    builder.color()
    model = builder.finalize(device="cpu")
    solver = newton.solvers.SolverVBD(
        model, iterations=20, particle_enable_self_contact=False, particle_enable_tile_solve=False
    )
    now, then, control = model.state(), model.state(), model.control()
    start = now.particle_q.numpy().tolist()
    step = FRAME / SUBSTEPS
    for _ in range(frames * SUBSTEPS):
        now.clear_forces()
        solver.step(now, then, control, None, step)
        now, then = then, now
    return {
        "tets": builder.tet_count,
        "points": builder.particle_count,
        "masses": np.array(builder.particle_mass).tolist(),
        "lame": np.array(builder.tet_materials)[:, :2].tolist(),
        "start": start,
        "end": now.particle_q.numpy().tolist(),
        "step": step,
        "gravity": np.ravel(model.gravity.numpy()).tolist()[:3],
    }


stage, prim, frames = sys.argv[1:]
Path(stage).with_suffix(".json").write_text(json.dumps(simulate(stage, prim, int(frames))))
