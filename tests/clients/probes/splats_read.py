"""Read splat files with gsply and with NVIDIA's usd-convert-gsplat, and write some with gsply.

    python splats_read.py FOLDER

Of each NAME.ply and NAME.spz in the folder the numbers are written to NAME.KIND.PROGRAM.npz:
positions, logarithms of scales, quaternions (w, x, y, z), logits of opacities, and coefficients
(N, K, 3).  Of each NAME.ply gsply makes NAME.packed.ply, NAME.gsply.spz (version 3) and
NAME.gsply4.spz (version 4) as well, and reads them again; usd-convert-gsplat makes
NAME.nvidia.usdc.
"""

import shutil
import sys
from pathlib import Path

import gsply
import numpy as np


def save(path, program, positions, scales, turns, opacities, base, rest):
    np.savez(
        path.with_name(f"{path.name}.{program}.npz"),
        positions=positions,
        scales=scales,
        orientations=turns,
        opacities=opacities,
        harmonics=np.concatenate([np.reshape(base, (-1, 1, 3)), rest], axis=1),
    )


def by_gsply(path):
    data = gsply.read_spz(path) if path.suffix == ".spz" else gsply.plyread(path)
    rest = np.zeros((len(data.means), 0, 3)) if data.shN is None else data.shN
    rest = np.reshape(rest, (len(data.means), -1, 3))
    save(path, "gsply", data.means, data.scales, data.quats, data.opacities, data.sh0, rest)


def by_nvidia(path):
    from usd_convert_gsplat.ply_reader import read_ply
    from usd_convert_gsplat.spz_reader import read_spz
    from usd_convert_gsplat.usd_writer import write_gaussian_splat_usd

    spz = path.suffix == ".spz"
    data = read_spz(str(path)) if spz else read_ply(str(path))
    rest = np.zeros((len(data.positions), 0)) if data.f_rest is None else data.f_rest
    shape = (len(rest), -1, 3) if spz else (len(rest), 3, -1)
    rest = np.reshape(rest, shape) if rest.size else np.zeros((len(rest), 0, 3))
    if not spz and rest.size:
        rest = np.swapaxes(rest, 1, 2)
    if not spz:
        write_gaussian_splat_usd(data, str(path.with_suffix(".nvidia.usdc")), source_file=str(path))
    save(
        path, "nvidia", data.positions, data.scales, data.rotations, data.opacities, data.f_dc, rest
    )


def convert(path):
    data = gsply.plyread(path)
    packed = path.with_name(f"{path.stem}.packed.ply")
    made = path.with_name(f"{path.stem}.made.ply")
    gsply.plywrite(made, data, compressed=True)  # names it made.compressed.ply
    written = [p for p in path.parent.glob(f"{path.stem}.made*") if p.is_file()]
    shutil.move(written[0], packed)
    made = [packed]
    for mark, version in (("", 3), ("4", 4)):
        made.append(path.with_name(f"{path.stem}.gsply{mark}.spz"))
        gsply.write_spz(made[-1], data, version=version)
    return made


folder = Path(sys.argv[1])
theirs = [made for path in sorted(folder.glob("*.ply")) for made in convert(path)]
for path in sorted([*folder.glob("*.ply"), *folder.glob("*.spz")]):
    by_gsply(path)
    if path not in theirs and "no-nvidia" not in sys.argv:
        by_nvidia(path)
