"""Position, velocity and deformation gradient of many embedded points in one pass over their rows.

In double precision and in the order of SciPy's products, of which it takes four passes.
"""

from gf_usd.system.taichi_runtime import import_taichi

ti = import_taichi()

Many = ti.types.ndarray(dtype=ti.f64, ndim=1)
Rows = ti.types.ndarray(dtype=ti.f64, ndim=2)
Whole = ti.types.ndarray(dtype=ti.i32, ndim=1)


@ti.kernel
def embed(
    start: Whole, node: Whole, w: Many, g0: Many, g1: Many, g2: Many,
    X: Rows, offset: Many, u: Rows, v: Rows, x: Rows, rate: Rows, F: Rows,
):  # fmt: skip
    """x = X + offset + W u,  rate = W v,  F = I + sum_b (G_b u) e_b.

    start (n + 1,), node (nnz,) : rows of W and of the three of G; w, g0, g1, g2 : their values;
    F : (n, 9), row by row.
    """
    for p in range(X.shape[0]):
        zero = 0.0 * offset[0]
        moved, speed = ti.Vector([zero, zero, zero]), ti.Vector([zero, zero, zero])
        F0, F1, F2 = moved, moved, moved
        for e in range(start[p], start[p + 1]):
            i = node[e]
            at = ti.Vector([u[i, 0], u[i, 1], u[i, 2]])
            moved += w[e] * at
            speed += w[e] * ti.Vector([v[i, 0], v[i, 1], v[i, 2]])
            F0 += g0[e] * at
            F1 += g1[e] * at
            F2 += g2[e] * at
        for a in ti.static(range(3)):
            x[p, a] = X[p, a] + offset[a] + moved[a]
            rate[p, a] = speed[a]
            for b, column in ti.static(((0, F0), (1, F1), (2, F2))):
                one = zero
                if ti.static(a == b):
                    one = zero + 1.0
                F[p, 3 * a + b] = column[a] + one
