"""Interpolation kernels in double precision, for the three components at once.

Position, velocity and deformation gradient of many points from their positions in their cells. Sums
over the 27 nodes of a cell are factored by axis,

    sum_ijk N_i(f_x) N_j(f_y) N_k(f_z) u_ijk = sum_i N_i sum_j N_j sum_k N_k u_ijk

and likewise with the derivative along one of the axes. Also products with sparse matrices, summed
in SciPy's order.

The components are a vector padded to four, the width of SIMD vectors.
"""

from gf_usd.physics.taichi_arrays import on_arrays
from gf_usd.system.taichi_runtime import import_taichi

ti = import_taichi()

LANES = 4

Lanes = ti.types.ndarray(dtype=ti.types.vector(LANES, ti.f64), ndim=1)
Rows = ti.types.ndarray(dtype=ti.f64, ndim=2)
Numbers = ti.types.ndarray(dtype=ti.f64, ndim=1)
Whole = ti.types.ndarray(dtype=ti.i32, ndim=1)
Nodes = ti.types.ndarray(dtype=ti.i32, ndim=2)


@ti.func
def spline(f):
    """N_i(f), i = 0, 1, 2: see `reference.stencil.bspline`."""
    a, b, c = 1.5 - f, f - 1.0, f - 0.5
    return 0.5 * a * a, 0.75 - b * b, 0.5 * c * c


@ti.func
def slope(f):
    """dN_i/df."""
    return f - 1.5, 2.0 - 2.0 * f, f - 0.5


@ti.func
def sums(around: ti.template(), c, fx: ti.template(), p, u: ti.template()):
    """sum_i w_ip u_i, and the same with the derivative along each axis, per cell."""
    wx, wy, wz = spline(fx[p, 0]), spline(fx[p, 1]), spline(fx[p, 2])
    dx, dy, dz = slope(fx[p, 0]), slope(fx[p, 1]), slope(fx[p, 2])
    zero = 0.0 * fx[p, 0]
    value = ti.Vector([zero, zero, zero, zero])
    x, y, z = value, value, value
    for i in ti.static(range(3)):
        plane, plane_y, plane_z = 0.0 * value, 0.0 * value, 0.0 * value
        for j in ti.static(range(3)):
            line, line_z = 0.0 * value, 0.0 * value
            for k in ti.static(range(3)):
                one = u[around[c, 9 * i + 3 * j + k]]
                line += wz[k] * one
                line_z += dz[k] * one
            plane += wy[j] * line
            plane_y += dy[j] * line
            plane_z += wy[j] * line_z
        value += wx[i] * plane
        x += dx[i] * plane
        y += wx[i] * plane_y
        z += wx[i] * plane_z
    return value, x, y, z


@ti.func
def weighted(around: ti.template(), c, fx: ti.template(), p, v: ti.template()):
    """sum_i w_ip v_i."""
    wx, wy, wz = spline(fx[p, 0]), spline(fx[p, 1]), spline(fx[p, 2])
    zero = 0.0 * fx[p, 0]
    value = ti.Vector([zero, zero, zero, zero])
    for i in ti.static(range(3)):
        plane = 0.0 * value
        for j in ti.static(range(3)):
            line = 0.0 * value
            for k in ti.static(range(3)):
                line += wz[k] * v[around[c, 9 * i + 3 * j + k]]
            plane += wy[j] * line
        value += wx[i] * plane
    return value


@on_arrays
@ti.kernel
def embed(
    cell: Whole, around: Nodes, fx: Rows, ih: ti.f64, X: Rows, offset: Numbers, u: Lanes,
    v: Lanes, x: Rows, rate: Rows, F: Rows,
):  # fmt: skip
    """x = X + offset + W u, rate = W v, F = I + sum_b (G_b u) e_b, (n, 9) row by row.

    cell, around, fx : of `embedding.SplineRows`; ih : 1 / h.
    """
    for p in range(X.shape[0]):
        moved, F0, F1, F2 = sums(around, cell[p], fx, p, u)
        speed = weighted(around, cell[p], fx, p, v)
        for a in ti.static(range(3)):
            x[p, a] = X[p, a] + offset[a] + moved[a]
            rate[p, a] = speed[a]
            for b, column in ti.static(((0, F0), (1, F1), (2, F2))):
                F[p, 3 * a + b] = ih * column[a] + ti.static(1.0 if a == b else 0.0)


@on_arrays
@ti.kernel
def stretch(cell: Whole, around: Nodes, fx: Rows, ih: ti.f64, u: Lanes, D: Rows):
    """D = sum_i u_i (x) grad w_ip, (n, 9) row by row."""
    for p in range(D.shape[0]):
        _, F0, F1, F2 = sums(around, cell[p], fx, p, u)
        for a in ti.static(range(3)):
            for b, column in ti.static(((0, F0), (1, F1), (2, F2))):
                D[p, 3 * a + b] = ih * column[a]


@on_arrays
@ti.kernel
def gather(cell: Whole, around: Nodes, fx: Rows, ih: ti.f64, P: Rows, f: Lanes):
    """f_i += sum_p P_p grad w_ip of P (n, 9), on one thread, for a fixed order of summation."""
    ti.loop_config(serialize=True)
    for p in range(P.shape[0]):
        wx, wy, wz = spline(fx[p, 0]), spline(fx[p, 1]), spline(fx[p, 2])
        dx, dy, dz = slope(fx[p, 0]), slope(fx[p, 1]), slope(fx[p, 2])
        zero = 0.0 * ih
        P0 = ih * ti.Vector([P[p, 0], P[p, 3], P[p, 6], zero])
        P1 = ih * ti.Vector([P[p, 1], P[p, 4], P[p, 7], zero])
        P2 = ih * ti.Vector([P[p, 2], P[p, 5], P[p, 8], zero])
        for i in ti.static(range(3)):
            for j in ti.static(range(3)):
                across = wy[j] * (dx[i] * P0) + dy[j] * (wx[i] * P1)
                along = wy[j] * (wx[i] * P2)
                for k in ti.static(range(3)):
                    node = around[cell[p], 9 * i + 3 * j + k]
                    f[node] = f[node] + wz[k] * across + dz[k] * along


@on_arrays
@ti.kernel
def multiply(start: Whole, node: Whole, W: Numbers, u: Lanes, x: Rows):
    """x = W u.

    start (n + 1,), node (nnz,), W : rows and values of a CSR matrix with n rows.
    """
    for p in range(x.shape[0]):
        zero = ti.f64(0.0)
        row = ti.Vector([zero, zero, zero, zero])
        for e in range(start[p], start[p + 1]):
            row += W[e] * u[node[e]]
        for a in ti.static(range(3)):
            x[p, a] = row[a]


@on_arrays
@ti.kernel
def iterate(
    start: Whole,
    node: Whole,
    S: Numbers,
    shrink: Numbers,
    grow: Numbers,
    r: Lanes,
    d: Lanes,
    z: Lanes,
):
    """r <- r - S d,  d <- shrink d + grow r,  z <- z + d, once per entry of `shrink` and `grow`.

    start (n + 1,), node (nnz,), S : rows and values of a CSR matrix (n, n).
    """
    ti.loop_config(serialize=True)
    for s in range(shrink.shape[0]):
        for p in range(r.shape[0]):
            zero = 0.0 * shrink[s]
            row = ti.Vector([zero, zero, zero, zero])
            for e in range(start[p], start[p + 1]):
                row += S[e] * d[node[e]]
            r[p] = r[p] - row
        for p in range(r.shape[0]):
            d[p] = shrink[s] * d[p] + grow[s] * r[p]
            z[p] = z[p] + d[p]
