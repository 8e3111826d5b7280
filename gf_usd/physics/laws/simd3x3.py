"""3x3 matrix algebra on eight particles at once, and inlined kernel code.

A matrix is a Python list of nine lane vectors, row by row: ``F[3 * a + b]`` is component ab of
eight particles. One Taichi operation is then one SIMD instruction (measured: seven times the speed
of scalar code on AVX2).

Taichi 1.7 with ``real_matrix_scalarize=False`` aborts on some vector operations: unary minus, abs,
exp and log. Use ``0.0 - x``, and compute logarithms by lane with `log`.

Taichi traverses the syntax tree of a `ti.func` at every call, and for every iteration of an
unrolled loop, at each start of a program: 7 us per node, although the compiled kernel is cached. A
function marked `unrolled` is executed by Python instead, with Taichi expressions as arguments, and
its operators generate the same statements in a fifth of the time. Differences from a `ti.func`:

- an expression is evaluated again at every use; `let` stores its value in a variable; - `put`
assigns to such a variable, as `+=` etc. do; a bare `=` only binds a Python name; - loops and
branches are Python's, over values known at compile time; - arrays are read by `at`, and written by
`put` to the result of `at`.
"""

from collections.abc import Callable
from types import SimpleNamespace

import taichi as ti
from taichi.lang import impl

LANE_BITS = 3
LANES = 1 << LANE_BITS


def unrolled(function: Callable) -> Callable:
    """Mark a plain Python function as callable from kernels, by Taichi's own attribute for this."""
    function._is_taichi_function = True
    function.func = SimpleNamespace(has_print=False)
    return function


@unrolled
def cofactor(F):
    """cof F = J F^-T, defined for singular F too."""
    return [
        F[4] * F[8] - F[5] * F[7],
        F[5] * F[6] - F[3] * F[8],
        F[3] * F[7] - F[4] * F[6],
        F[2] * F[7] - F[1] * F[8],
        F[0] * F[8] - F[2] * F[6],
        F[1] * F[6] - F[0] * F[7],
        F[1] * F[5] - F[2] * F[4],
        F[2] * F[3] - F[0] * F[5],
        F[0] * F[4] - F[1] * F[3],
    ]


@unrolled
def determinant(F, cof):
    """J = det F by its first row; cof as returned by `cofactor`."""
    return F[0] * cof[0] + F[1] * cof[1] + F[2] * cof[2]


@unrolled
def difference(A, B):
    """A - B."""
    return [A[a] - B[a] for a in range(9)]


@unrolled
def choose(A, where, B):
    """A <- B in the lanes where `where` > 0, in place; lists of lane vectors."""
    where = let(where > 0.0)
    for a, b in zip(A, B):
        put(a, ti.select(where, b, a))


@unrolled
def combination(p, A, q, B):
    """p A + q B."""
    p, q = let(p), let(q)
    return [p * A[a] + q * B[a] for a in range(9)]


@unrolled
def assign(A, B):
    """A <- B, in place."""
    for a, b in zip(A, let(B)):
        put(a, b)


@unrolled
def double_dot(A, B):
    """A : B = sum_ab A_ab B_ab."""
    s = A[0] * B[0]
    for a in range(1, 9):
        s = s + A[a] * B[a]
    return s


@ti.func
def log(x):
    """Natural logarithm, lane by lane."""
    return ti.Vector([ti.log(x[lane]) for lane in ti.static(range(x.n))])


@ti.func
def inverse_guarded(J):
    """1/J with |J| bounded below (sign kept), so that a flat particle gives a finite value."""
    tiny = 1e-12
    return 1.0 / ti.select(J >= 0.0, ti.max(J, tiny), ti.min(J, -tiny))


@ti.func
def rotation(F, converged):
    """The rotation of the polar decomposition, F = R S with det R = +1.

    Newton's iteration Q <- (g Q + Q^-T / g) / 2 with Higham's scaling g converges to the nearest
    orthogonal matrix (Higham 1986). Where det F < 0 that matrix is a reflection, which is replaced
    by the rotation nearest to F, R = Q (I - 2 n n^T), with n the direction of the smallest stretch:
    the convention of the signed SVD (Irving, Teran and Fedkiw 2004).

    converged : squared change |Q' - Q|^2 below which the next iterate is exact to rounding.
    """
    cof = cofactor(F)
    J = determinant(F, cof)
    rJ = inverse_guarded(J)
    g2 = ti.sqrt(double_dot(cof, cof) * rJ * rJ / ti.max(double_dot(F, F), 1e-30))
    g2 = ti.min(ti.max(g2, 1e-6), 1e6)
    # No scaling near a rotation, where it does not accelerate the iteration.
    g2 = ti.select((g2 < 1.5) & (g2 > 0.67), 1.0, g2)
    g = ti.sqrt(g2)
    p = 0.5 * g
    q = 0.5 * rJ / g
    Q = combination(p, F, q, cof)
    change = J * 0.0 + 1.0
    steps = 0
    while change.max() > converged and steps < 24:
        c = cofactor(Q)
        r = 0.5 * inverse_guarded(determinant(Q, c))
        change = J * 0.0
        advance(Q, r, c, change)
        steps += 1
    if J.min() < 0.0:
        unflip(Q, F, J)
    return Q


@unrolled
def advance(Q, r, c, change):
    """Q <- Q + d with d = r c - Q / 2; adds |d|^2 to change."""
    for a in range(9):
        d = let(r * c[a] - 0.5 * Q[a])
        put(Q[a], Q[a] + d)
        put(change, change + d * d)


@ti.func
def unflip(Q: ti.template(), F, J):
    """Where J < 0, replace the reflection Q by Q (I - 2 n n^T), in place."""
    # S = Q^T F is positive semi-definite; powers of its cofactor converge to the smallest stretch.
    S = product([Q[0], Q[3], Q[6], Q[1], Q[4], Q[7], Q[2], Q[5], Q[8]], F)
    B = cofactor(S)
    for _ in range(12):
        s = 1.0 / ti.max(ti.sqrt(double_dot(B, B)), 1e-30)
        square(B, s)
    # B is now n n^T up to scale; its longest column is n.
    mirror(Q, longest_column(B), J < 0.0)


@unrolled
def product(A, B):
    """A B."""
    return [
        A[3 * a] * B[b] + A[3 * a + 1] * B[3 + b] + A[3 * a + 2] * B[6 + b]
        for a in range(3)
        for b in range(3)
    ]


@unrolled
def transposed(A):
    """A^T."""
    return [A[3 * b + a] for a in range(3) for b in range(3)]


@ti.func
def inverse(F):
    """F^-1 = (cof F)^T / J, finite where F is flat: see `inverse_guarded`."""
    cof = cofactor(F)
    r = inverse_guarded(determinant(F, cof))
    return scaled(r, transposed(cof))


@unrolled
def scaled(k, A):
    """k A."""
    k = let(k)
    return let([k * a for a in A])


@unrolled
def square(B, s):
    """B <- (s B)^2."""
    A = let([s * B[a] for a in range(9)])
    for a, value in enumerate(product(A, A)):
        put(B[a], value)


@unrolled
def longest_column(B):
    """The longest of the three columns, by the diagonal of B = n n^T."""
    n, best = [B[0], B[3], B[6]], B[0]
    for b in range(1, 3):
        longer = let(B[4 * b] > best)
        best = let(ti.select(longer, B[4 * b], best))
        n = [let(ti.select(longer, B[3 * a + b], n[a])) for a in range(3)]
    return n


@unrolled
def mirror(Q, n, where):
    """Q <- Q (I - 2 n n^T / |n|^2) in the lanes where `where` > 0."""
    k = 2.0 / ti.max(n[0] * n[0] + n[1] * n[1] + n[2] * n[2], 1e-30)
    k = let(ti.select(where, k, 0.0))
    for a in range(3):
        t = let(k * (Q[3 * a] * n[0] + Q[3 * a + 1] * n[1] + Q[3 * a + 2] * n[2]))
        for b in range(3):
            put(Q[3 * a + b], Q[3 * a + b] - t * n[b])


@ti.func
def von_mises(P, F):
    """sqrt(3/2 s:s) of the deviator s of the Cauchy stress sigma = P F^T / J."""
    r = inverse_guarded(determinant(F, cofactor(F)))
    s00 = r * (P[0] * F[0] + P[1] * F[1] + P[2] * F[2])
    s11 = r * (P[3] * F[3] + P[4] * F[4] + P[5] * F[5])
    s22 = r * (P[6] * F[6] + P[7] * F[7] + P[8] * F[8])
    s01 = r * (P[0] * F[3] + P[1] * F[4] + P[2] * F[5])
    s02 = r * (P[0] * F[6] + P[1] * F[7] + P[2] * F[8])
    s12 = r * (P[3] * F[6] + P[4] * F[7] + P[5] * F[8])
    d0 = s00 - s11
    d1 = s11 - s22
    d2 = s22 - s00
    return ti.sqrt(0.5 * (d0 * d0 + d1 * d1 + d2 * d2) + 3.0 * (s01 * s01 + s02 * s02 + s12 * s12))


def let(x):
    """A variable initialized with the expression x, or a list of them."""
    return impl.expr_init(x)


def put(variable, x):
    """variable = x."""
    variable._assign(x)


def at(array, n):
    """array[n]."""
    return impl.subscript(impl.get_runtime().compiling_callable.ast_builder(), array, n)
