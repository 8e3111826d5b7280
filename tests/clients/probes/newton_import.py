"""In Newton: read stages as its importer does, and write down the materials it understood.

    python newton_import.py STAGE ...

Next to each STAGE is written a file .json.  `tetmesh` holds the Lame parameters and the density of
</Proof/Tet> in stage units, as newton.usd.get_tetmesh reads them by the AOUSD proposal alone;
`soft` the Lame parameters that ModelBuilder.add_usd gives its tetrahedra; `particles` the moduli
[Pa], damping times [s] and densities [kg/m^3] of the Points that it imported as an MPM body.
"""

import json
import sys
from pathlib import Path

import newton
import newton.usd
import newton_usd_schemas  # noqa: F401  (Newton's definitions of its API schemas)
import numpy as np
from pxr import Usd

CORNERS = 4  # of the tetrahedron: the last particles of a model
MODULI = ("young_modulus", "poisson_ratio", "damping", "tensile_yield_ratio")


def read(path):
    stage = Usd.Stage.Open(path)
    tet = newton.usd.get_tetmesh(stage.GetPrimAtPath("/Proof/Tet"), compat_namespaces=())
    builder = newton.ModelBuilder()
    builder.add_usd(stage, load_visual_shapes=False)
    model = builder.finalize(device="cpu")
    mass = np.array(builder.particle_mass[:-CORNERS])
    width = 2.0 * np.array(builder.particle_radius[:-CORNERS])
    return {
        "tetmesh": [numbers(value) for value in (tet.k_mu, tet.k_lambda, tet.density)],
        "soft": [numbers(row) for row in builder.tet_materials],
        "particles": {
            "density": (mass / width**3).tolist(),
            **{name: getattr(model.mpm, name).numpy()[:-CORNERS].tolist() for name in MODULI},
        },
    }


def numbers(value):
    return None if value is None else np.ravel(value).tolist()


for path in sys.argv[1:]:
    Path(path).with_suffix(".json").write_text(json.dumps(read(path)))
