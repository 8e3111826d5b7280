"""The field whose zero level set is the surface of particles, and interpolation to that surface.

Lengths are in cells, relative to the corner of a block of `BLOCK` cells per side, so that
coordinates are small for any distance of the particles. Each node sums over the particles of the 27
blocks around it in a fixed order, so that the sums are bit-identical for any number of threads.
"""

import taichi as ti

BLOCK = 5  # [cells] edge of a block, equal to the radius of the kernel
NODES = BLOCK**3
# The radius decreases with the largest eigenvalue of grad x_mean from LOW on, to 0 at HIGH
# (Solenthaler et al. 2007, section 4).
LOW, HIGH = 0.4, 3.5

Floats1 = ti.types.ndarray(dtype=ti.f32, ndim=1)
Floats2 = ti.types.ndarray(dtype=ti.f32, ndim=2)
Ints1 = ti.types.ndarray(dtype=ti.i32, ndim=1)
Ints2 = ti.types.ndarray(dtype=ti.i32, ndim=2)


@ti.func
def place(a: ti.template(), i):
    """Row i of an (n, 3) array."""
    return ti.Vector([a[i, 0], a[i, 1], a[i, 2]])


@ti.func
def corner(k):
    """[cells] corner of neighbor k of 27, relative to that of the central block."""
    return ti.Vector([k // 9 - 1.0, k // 3 % 3 - 1.0, k % 3 - 1.0]) * BLOCK


@ti.func
def slabs(o, step, at):
    """First and last of the slabs along x of occupied block o that may be within reach.

    step : offset of the block along x, -1, 0 or 1; at : [cells] x relative to the central block.
    """
    floor = ti.cast(ti.floor(at), ti.i32)
    low, high = BLOCK * o, BLOCK * (o + 1)
    if step < 0:
        low += floor
    elif step > 0:
        high = BLOCK * o + ti.min(BLOCK, floor + 1)
    return low, high


@ti.func
def largest_eigenvalue(square, mixed):
    """Largest eigenvalue of a symmetric matrix with the diagonal `square` and xy, yz, zx in `mixed`
    (Smith 1961).
    """
    q = (square[0] + square[1] + square[2]) / 3.0
    a = square - q
    r = ti.sqrt(a.dot(a) / 6.0 + mixed.dot(mixed) / 3.0)
    value = q
    if r > 0.0:
        xy, yz, zx = mixed[0], mixed[1], mixed[2]
        det = a[0] * a[1] * a[2] + 2.0 * xy * yz * zx
        det -= a[0] * yz * yz + a[1] * zx * zx + a[2] * xy * xy
        half = det / (2.0 * r * r * r)
        value = q + 2.0 * r * ti.cos(ti.acos(ti.min(1.0, ti.max(-1.0, half))) / 3.0)
    return value


@ti.kernel
def field(x: Floats2, r: Floats1, first: Ints1, around: Ints2, phi: Floats2, reach: ti.f32):
    """phi (B, NODES) [cells] at the nodes of each block: see `surface`.

    x : (N, 3) of particles relative to the corners of their blocks; r : (N,) their radii.
    first : (BLOCK O + 1,) start of the particles of each slab of each occupied block: BLOCK slabs
    along x, one cell thick.
    around : (B, 27) the occupied blocks around each block, -1 where there is none.
    """
    for b in range(phi.shape[0]):
        for node in range(NODES):
            at = ti.Vector([node // (BLOCK * BLOCK), node // BLOCK % BLOCK, node % BLOCK]) * 1.0
            w_sum, r_sum = 0.0, 0.0
            mean, slope = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
            square, mixed = ti.Vector([0.0, 0.0, 0.0]), ti.Vector([0.0, 0.0, 0.0])
            for k in range(27):
                o = around[b, k]
                start = corner(k) - at
                if o >= 0:
                    low, high = slabs(o, k // 9 - 1, at[0])
                    for p in range(first[low], first[high]):
                        d = place(x, p) + start
                        u = 1.0 - d.dot(d) / (reach * reach)
                        if u > 0.0:
                            w, g = u * u * u, u * u
                            w_sum += w
                            r_sum += w * r[p]
                            mean += w * d
                            e = g * d
                            slope += e
                            square += e * d
                            mixed += e * ti.Vector([d[1], d[2], d[0]])  # xy, yz, zx
            phi[b, node] = reach
            if w_sum > 0.0:
                m = mean / w_sum
                square = square - m * slope
                mixed[0] -= 0.5 * (m[0] * slope[1] + m[1] * slope[0])
                mixed[1] -= 0.5 * (m[1] * slope[2] + m[2] * slope[1])
                mixed[2] -= 0.5 * (m[2] * slope[0] + m[0] * slope[2])
                value = 6.0 / (reach * reach * w_sum) * largest_eigenvalue(square, mixed)
                s = ti.min(1.0, ti.max(0.0, (HIGH - value) / (HIGH - LOW)))
                phi[b, node] = m.norm() - r_sum / w_sum * (s * s * s - 3.0 * s * s + 3.0 * s)


@ti.kernel
def interpolated(
    x: Floats2, values: Floats2, first: Ints1, around: Ints2,
    at: Floats2, block: Ints1, out: Floats2, reach: ti.f32
):  # fmt: skip
    """out (V, c): kernel-weighted means of the values (N, c) of particles.

    at : (V, 3) points relative to the corners of the blocks `block` (V,), which index `around`; the
    others as for `field`.
    """
    for v in range(out.shape[0]):
        total = 0.0
        for c in range(out.shape[1]):
            out[v, c] = 0.0
        for k in range(27):
            o = around[block[v], k]
            if o >= 0:
                start = corner(k) - place(at, v)
                low, high = slabs(o, k // 9 - 1, at[v, 0])
                for p in range(first[low], first[high]):
                    d = place(x, p) + start
                    u = 1.0 - d.dot(d) / (reach * reach)
                    if u > 0.0:
                        total += u * u * u
                        for c in range(out.shape[1]):
                            out[v, c] += u * u * u * values[p, c]
        for c in range(out.shape[1]):
            out[v, c] /= total
