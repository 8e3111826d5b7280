"""What a frame asks of every particle, as kernels: rotation, stretches, Gaussian.

In double precision, and to rounding what `gaussians` and `stretches` do with arrays in NumPy.
There each of some two hundred operations walks through memory, on one core; here a particle stays
in registers, and threads share the particles.  See `many`.
"""

import taichi as ti

from gf_usd.physics.gaussians import NEWTON, SETTLED, SWEEPS

Many = ti.types.ndarray(dtype=ti.f64, ndim=1)
Flags = ti.types.ndarray(dtype=ti.i32, ndim=1)


@ti.func
def matrix(values: ti.template(), p):
    """Matrix p of many, row by row."""
    return ti.Matrix(
        [[values[9 * p + 3 * a + b] for b in ti.static(range(3))] for a in ti.static(range(3))]
    )


@ti.func
def keep(values: ti.template(), p, A):
    for a, b in ti.static(ti.ndrange(3, 3)):
        values[9 * p + 3 * a + b] = A[a, b]


@ti.func
def cofactor(A):
    return ti.Matrix(
        [
            [
                A[(a + 1) % 3, (b + 1) % 3] * A[(a + 2) % 3, (b + 2) % 3]
                - A[(a + 1) % 3, (b + 2) % 3] * A[(a + 2) % 3, (b + 1) % 3]
                for b in ti.static(range(3))
            ]
            for a in ti.static(range(3))
        ]
    )


@ti.func
def first_row(A, B):
    """A00 B00 + A01 B01 + A02 B02: the determinant of A where B is its cofactor."""
    return A[0, 0] * B[0, 0] + A[0, 1] * B[0, 1] + A[0, 2] * B[0, 2]


@ti.func
def root(x):
    """sqrt(x), 0 where rounding made x negative; what is no number stays none."""
    return ti.sqrt(ti.select(x < 0.0, 0.0 * x, x))


@ti.func
def within(x):
    """x in [-1, 1]."""
    return ti.select(x > 1.0, x / x, ti.select(x < -1.0, 0.0 - x / x, x))


@ti.kernel
def rotations(F: Many, R: Many, done: Flags):
    """R of the polar decomposition of each F where `done`: see `gaussians.nearest_rotation`."""
    for p in range(done.shape[0]):
        Q = matrix(F, p)
        settled = 0
        if first_row(Q, cofactor(Q)) > 0.0:
            step = 0
            while step < NEWTON and settled == 0:
                C = cofactor(Q)
                J = first_row(Q, C)
                new = 0.5 * (Q + C / J)
                change = new - Q
                largest = 0.0 * J
                for a, b in ti.static(ti.ndrange(3, 3)):
                    largest = ti.max(largest, ti.abs(change[a, b]))
                if largest < SETTLED:
                    settled = 1
                Q = new
                step += 1
        done[p] = settled
        keep(R, p, Q)


@ti.kernel
def stretches(F: Many, s: Many, J: Many):
    """Singular values, ascending, and det F: see `stretches.strains`."""
    for p in range(J.shape[0]):
        A = matrix(F, p)
        J[p] = first_row(A, cofactor(A))
        C = A.transpose() @ A
        q = (C[0, 0] + C[1, 1] + C[2, 2]) / 3.0
        D = C
        size = 0.0 * q
        for a in ti.static(range(3)):
            D[a, a] = D[a, a] - q
        for a, b in ti.static(ti.ndrange(3, 3)):
            size += D[a, b] * D[a, b]
        r = ti.sqrt(size / 6.0)
        if r > 0.0:
            D = D / r
        cosine = within(first_row(D, cofactor(D)) / 2.0)
        angle = ti.acos(cosine) / 3.0
        # cos(angle + 2 pi / 3), of which a literal would have single precision only
        along, across = ti.cos(angle), ti.sqrt(0.0 * angle + 3.0) * ti.sin(angle)
        high = q + 2.0 * r * along
        low = q - r * (along + across)
        s[3 * p] = root(low)
        s[3 * p + 1] = root(3.0 * q - high - low)
        s[3 * p + 2] = root(high)


@ti.func
def quaternion(R):
    """(w, x, y, z) of a rotation: see `gaussians.quaternion_from_matrix`."""
    a, b, c = R[0, 0], R[1, 1], R[2, 2]
    wx, wy, wz = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    xy, xz, yz = R[1, 0] + R[0, 1], R[0, 2] + R[2, 0], R[2, 1] + R[1, 2]
    w2, x2, y2, z2 = 1 + a + b + c, 1 + a - b - c, 1 - a + b - c, 1 - a - b + c
    # The largest of four squared components is at least a quarter: divide by that one.
    q = ti.Vector([w2, wx, wy, wz])
    most = w2
    if x2 > most:
        most = x2
        q = ti.Vector([wx, x2, xy, xz])
    if y2 > most:
        most = y2
        q = ti.Vector([wy, xy, y2, yz])
    if z2 > most:
        q = ti.Vector([wz, xz, yz, z2])
    return q / q.norm()


@ti.func
def diagonalise(S):
    """Q with Q^T S Q diagonal, and that: see `gaussians.jacobi`."""
    Q = S * 0.0
    for a in ti.static(range(3)):
        Q[a, a] = 1.0
    least = 1e-14 * ti.max(S[0, 0] + S[1, 1] + S[2, 2], 1e-300)
    sweep = 0
    moved = 1
    while sweep < SWEEPS and moved == 1:
        moved = 0
        for p, q in ti.static(((0, 1), (0, 2), (1, 2))):
            off = S[p, q]
            if ti.abs(off) > least:
                moved = 1
                tau = (S[q, q] - S[p, p]) / (2.0 * off)
                sign = ti.select(tau >= 0.0, 1.0, -1.0)
                t = sign / (ti.abs(tau) + ti.sqrt(1.0 + tau * tau))
                c = 1.0 / ti.sqrt(1.0 + t * t)
                J = S * 0.0
                for a in ti.static(range(3)):
                    J[a, a] = 1.0
                J[p, p] = c
                J[q, q] = c
                J[p, q] = t * c
                J[q, p] = 0.0 - t * c
                S = J.transpose() @ S @ J
                Q = Q @ J
        sweep += 1
    return S, Q


@ti.kernel
def carry(
    F: Many, rest: Many, R: Many, turn: Many, axes: Many, last: Many, new_axes: Many,
    new_last: Many, scales: Many, count: ti.i32,
):  # fmt: skip
    """A frame of `gaussians.GaussianTrack`, of which turn, axes and last are the state.

    rest : Q0 diag(s0); R : rotations of F, the next turn.
    """
    for p in range(count):
        A = matrix(F, p) @ matrix(rest, p)
        start = matrix(R, p) @ matrix(turn, p).transpose() @ matrix(axes, p)
        B = start.transpose() @ A
        S, spin = diagonalise(B @ B.transpose())
        Q = start @ spin
        keep(new_axes, p, Q)
        for a in ti.static(range(3)):
            scales[3 * p + a] = root(S[a, a])
        q = quaternion(Q)
        before = ti.Vector([last[4 * p + a] for a in ti.static(range(4))])
        sign = 1.0
        if q.dot(before) < 0.0:
            sign = -1.0
        for a in ti.static(range(4)):
            new_last[4 * p + a] = sign * q[a]
