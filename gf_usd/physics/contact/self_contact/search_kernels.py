"""Kernel that searches, for each sample, the opposite place of the same surface.

See `SelfContact.find`.

The values of a sample stay in registers, and neighbors are found in a uniform grid; NumPy would
need some hundred passes over memory, and SciPy a new tree for every detection.
"""

import taichi as ti

from gf_usd.physics.contact.distance.closest import (
    LEAST,
    LOOKS,
    PSEUDO,
    SEED,
    TIES,
    TRIANGLE,
    WANTED,
    WEIGHTS,
)
from gf_usd.physics.contact.distance.kernels import closest_on_triangle, vector
from gf_usd.physics.taichi_arrays import on_arrays

LOOKED = 8  # candidates from which SEEDS are chosen
SEEDS = 3  # opposite samples whose triangles are searched


@ti.func
def listed(lists: ti.template(), i, j):
    """Whether j is in the ascending list of i.

    lists : the start of each list and the end of the last one; then the lists.
    """
    low, high = lists[i], lists[i + 1]
    while low < high:
        middle = (low + high) // 2
        if lists[middle] < j:
            low = middle + 1
        else:
            high = middle
    there = False
    if low < lists[i + 1]:
        there = lists[low] == j
    return there


@ti.func
def cell_at(p, low, edge, size, a):
    """Index of the cell along axis a that contains a point, clamped to 0 .. size - 1."""
    return ti.min(ti.max(ti.floor((p[a] - low[a]) / edge, ti.i32), 0), size[a] - 1)


@ti.func
def opposite_seeds(
    x: ti.template(),
    found: ti.template(),
    near: ti.template(),
    cells: ti.template(),
    ordered: ti.template(),
    items,
    i,
    low,
    edge,
    size,
    turn,
    widest,
):
    """The SEEDS nearest of the LOOKED samples that are most nearly opposite to sample i and not
    near it at rest; -1: no more.

    Opposite means near in space and in minus the normal: `turn` [m] is the weight of a radian,
    `widest` [m] the search radius.
    """
    p, n = vector(x, i), vector(found, i)
    best = ti.Vector([widest * widest for _ in range(ti.static(LOOKED))])
    who = ti.Vector([-1 for _ in range(ti.static(LOOKED))])
    worst, far = 0, widest * widest
    own = ti.Vector([cell_at(p, low, edge, size, a) for a in range(2)])
    # Columns of cells in rings around its own, until they are farther than the candidates.
    ring, behind = 0, ti.max(size[0], size[1])
    while ring < behind:
        across = ti.max(ring - 1, 0) * edge
        if across * across >= far:
            behind = ring
        else:
            first = cell_at(p - ti.sqrt(far), low, edge, size, 2)
            last = cell_at(p + ti.sqrt(far), low, edge, size, 2)
            for cx in range(ti.max(own[0] - ring, 0), ti.min(own[0] + ring + 1, size[0])):
                cy = own[1] - ring
                while cy <= own[1] + ring:
                    if cy >= 0 and cy < size[1]:
                        column = (cx * size[1] + cy) * size[2]
                        for e in range(cells[column + first], cells[column + last + 1]):
                            along = n.dot(vector(ordered, e, 3))
                            square = (vector(ordered, e) - p).norm_sqr()
                            square += turn * turn * (2.0 + 2.0 * along)
                            # one branch, to reduce mispredictions
                            if ti.select(along < 0.0, square, far) < far:
                                j = cells[items + e]
                                for k in ti.static(range(LOOKED)):  # replaces the farthest
                                    best[k] = ti.select(k == worst, square, best[k])
                                    who[k] = ti.select(k == worst, j, who[k])
                                worst, far = 0, best[0]
                                for k in ti.static(range(1, LOOKED)):
                                    worst = ti.select(best[k] > far, k, worst)
                                    far = ti.max(best[k], far)
                    # only the first and last row of a ring have inner columns
                    inner = cx != own[0] - ring and cx != own[0] + ring
                    cy += 2 * ring if inner and ring > 0 else 1
        ring += 1
    # The nearest of these in space, by insertion sort; ties by index.
    seeds = ti.Vector([-1 for _ in range(ti.static(SEEDS))])
    least = ti.Vector([4.0 * widest * widest for _ in range(ti.static(SEEDS))])
    for k in ti.static(range(LOOKED)):
        j = who[k]
        if j >= 0:
            square = (vector(x, j) - p).norm_sqr()
            if square <= least[SEEDS - 1] and not listed(near, i, j):
                for m in ti.static(range(SEEDS)):
                    if square < least[m] or (square == least[m] and j < seeds[m]):
                        other, later = least[m], seeds[m]
                        least[m], seeds[m] = square, j
                        square, j = other, later
    return seeds


@ti.func
def is_unsearched_opposite(triangles: ti.template(), faces: ti.template(), seeds, m, t, n, aside):
    """Whether triangle t, at seed m, faces a sample with the normal n, and has no earlier seed as a
    corner, whose triangles were already searched.
    """
    yes = n.dot(vector(faces, t)) < aside
    for k in ti.static(range(3)):
        for earlier in ti.static(range(SEEDS - 1)):
            yes = yes and (earlier >= m or triangles[t, k] != seeds[earlier])
    return yes


@ti.func
def any_listed(lists: ti.template(), i, triangles: ti.template(), t):
    """Whether a corner of triangle t is in the list of i."""
    there, k = False, 0
    while k < 3 and not there:
        there = listed(lists, i, triangles[t, k])
        k += 1
    return there


@on_arrays
@ti.kernel
def find_opposite(
    x: ti.types.ndarray(dtype=ti.f64, ndim=2),
    triangles: ti.types.ndarray(dtype=ti.i32, ndim=2),
    around: ti.types.ndarray(dtype=ti.i32, ndim=2),
    near: ti.types.ndarray(dtype=ti.i32, ndim=1),
    flags: ti.types.ndarray(dtype=ti.i32, ndim=2),
    cells: ti.types.ndarray(dtype=ti.i32, ndim=1),
    ordered: ti.types.ndarray(dtype=ti.f64, ndim=2),
    faces: ti.types.ndarray(dtype=ti.f64, ndim=2),
    found: ti.types.ndarray(dtype=ti.f64, ndim=2),
    which: ti.types.ndarray(dtype=ti.i32, ndim=2),
    low: ti.types.vector(3, ti.f64),
    edge: ti.f64,
    size: ti.types.vector(3, ti.i32),
    radius: ti.f64,
    turn: ti.f64,
    widest: ti.f64,
    reach: ti.f64,
    aside: ti.f64,
    tie: ti.f64,
    vertex: ti.f64,
):
    """The closest opposite point for each wanted sample of x (n, 3) [m]: see `SelfContact.find`.

    triangles (T, 3), around (n, k) : of the `SampleMesh`; near : of `Neighbors`, see `listed`.
    flags : (n, 2) whether samples search, and are wanted anyway; other wanted samples are added.
    cells : (c + 1 + 2 n,), ordered : (n, 6) and faces : (T, 6) are temporary, of a grid of `size`
    cells of an edge [m] from a corner [m] on, of positions and normals in its order, and of the
    normals and angles of triangles.
    found, which : (n, 10), (n, 3) results, see the columns; -1: none.
    radius : [m] search radius; turn, widest : of `opposite_seeds`; reach : [m] largest distance,
    relative to the first seed; tie : [m] tolerance of distances; vertex : barycentric weight of a
    corner.
    """
    for t in range(triangles.shape[0]):
        a, b = vector(x, triangles[t, 0]), vector(x, triangles[t, 1])
        c = vector(x, triangles[t, 2])
        edges = (b - a, c - b, a - c)
        n = edges[2].cross(edges[0])
        length = n.norm()
        for k in ti.static(range(3)):
            faces[t, k] = n[k] / length if length > 0.0 else n[k]
            # tan of an angle = |cross| / dot of its two edges
            faces[t, k + 3] = ti.atan2(length, -edges[(k + 2) % 3].dot(edges[k]))
    for i in range(x.shape[0]):
        n = 0.0 * vector(x, i)
        for k in range(around.shape[1]):
            t = around[i, k]
            if t >= 0:
                for corner in ti.static(range(3)):
                    if triangles[t, corner] == i:
                        n += faces[t, 3 + corner] * vector(faces, t)
        length = n.norm()
        for a in ti.static(range(3)):
            found[i, a] = n[a] / length if length > 0.0 else n[a]
    for _ in range(1):
        count = size[0] * size[1] * size[2]
        for k in range(count + 1):
            cells[k] = 0
        for i in range(x.shape[0]):
            p = vector(x, i)
            own = (
                cell_at(p, low, edge, size, 0) * size[1] + cell_at(p, low, edge, size, 1)
            ) * size[2] + cell_at(p, low, edge, size, 2)
            cells[count + 1 + x.shape[0] + i] = own
            cells[own] += 1
        for k in range(count):
            cells[k + 1] += cells[k]
        i = x.shape[0] - 1
        while i >= 0:
            own = cells[count + 1 + x.shape[0] + i]
            cells[own] -= 1
            cells[count + 1 + cells[own]] = i
            for a in ti.static(range(3)):
                ordered[cells[own], a] = x[i, a]
                ordered[cells[own], a + 3] = found[i, a]
            i -= 1
    for i in range(x.shape[0]):
        if flags[i, LOOKS] == 1:
            items = size[0] * size[1] * size[2] + 1
            center = vector(x, i) + radius * vector(found, i)
            first = ti.Vector([cell_at(center - radius, low, edge, size, a) for a in range(3)])
            last = ti.Vector([cell_at(center + radius, low, edge, size, a) for a in range(3)])
            inside = radius - tie
            seen = 0
            for cx in range(first[0], last[0] + 1):
                for cy in range(first[1], last[1] + 1):
                    column = (cx * size[1] + cy) * size[2]
                    for e in range(cells[column + first[2]], cells[column + last[2] + 1]):
                        if (vector(ordered, e) - center).norm_sqr() < inside * inside:
                            j = cells[items + e]
                            seen += 1
                            if not listed(near, i, j):
                                flags[i, WANTED] = 1
                                flags[j, WANTED] = 1
            # In a crease, neighbors may exclude more distant candidates.
            if seen >= LOOKED:
                flags[i, WANTED] = 1
    for i in range(x.shape[0]):
        which[i, SEED] = which[i, TRIANGLE] = -1
        if flags[i, WANTED] == 1:
            items = size[0] * size[1] * size[2] + 1
            seeds = opposite_seeds(
                x, found, near, cells, ordered, items, i, low, edge, size, turn, widest
            )
            which[i, SEED] = seeds[0]
            p, n = vector(x, i), vector(found, i)
            far = reach
            if seeds[0] >= 0:
                far = (p - vector(x, seeds[0])).norm()
            if seeds[0] >= 0 and far < reach:
                least, at, ties = ti.math.inf + 0.0 * far, -1, 0
                w, pseudo = 0.0 * p, 0.0 * p
                for e in range(ti.static(SEEDS) * around.shape[1]):
                    m = e // around.shape[1]
                    seed = seeds[0]
                    if m > 0:
                        seed = seeds[1] if m == 1 else seeds[2]
                    t = -1
                    if seed >= 0:
                        t = around[seed, e % around.shape[1]]
                    if t >= 0 and is_unsearched_opposite(triangles, faces, seeds, m, t, n, aside):
                        a, b = vector(x, triangles[t, 0]), vector(x, triangles[t, 1])
                        c = vector(x, triangles[t, 2])
                        weights = closest_on_triangle(p, a, b, c)
                        distance = (p - weights[0] * a - weights[1] * b - weights[2] * c).norm()
                        # Searching lists takes the longest: only for a triangle that is chosen.
                        if distance <= least + tie and not any_listed(near, i, triangles, t):
                            if distance < least - tie:
                                least, at, ties, pseudo = distance, -1, 0, 0.0 * p
                            # Faces and edges by face normals, vertices weighted by angles.
                            share = 1.0 + 0.0 * distance
                            for corner in ti.static(range(3)):
                                if weights[corner] > vertex:
                                    share = faces[t, 3 + corner]
                            pseudo += share * vector(faces, t)
                            ties += 1
                            least = ti.min(least, distance)
                            if at < 0 or t < at:
                                at, w = t, weights
                which[i, TRIANGLE], which[i, TIES] = at, ties
                found[i, LEAST] = least
                for a in ti.static(range(3)):
                    found[i, WEIGHTS + a] = w[a]
                    found[i, PSEUDO + a] = pseudo[a]
