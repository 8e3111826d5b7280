"""The closest point of a surface by a bounding volume tree, per point.

The tree of a surface is complete and stored as a heap, from the first of its boxes on: node i has
the children 2 i and 2 i + 1, and the leaves are the last level. A query visits the nearer child of
a node first, and skips boxes that are not nearer than the closest point found. Instead of a stack
it has a bit for each level, whether the sibling there is to be visited: the parent and the sibling
of node i are i // 2 and i ^ 1.
"""

import taichi as ti

from gf_usd.physics.contact.distance.closest import (
    AROUND,
    BOXES,
    FACES,
    FIRST_LEAF,
    LEAVES,
    MOVED,
    TRIANGLES,
)
from gf_usd.physics.taichi_arrays import on_arrays

ON_EDGE = 1e-9  # a barycentric weight below it counts as 0
# What the distance of a triangle that is known beforehand is enlarged by, so that the query finds
# it again: a factor, and a share of the coordinates, which are rounded.
NOT_NEARER, ROUNDING = 1.0 + 2.0**-20, 1e-12


@ti.func
def vector(A: ti.template(), i, first: ti.template() = 0):
    """Three numbers of row i of (n, k) numbers, from column `first` on."""
    return ti.Vector([A[i, first], A[i, first + 1], A[i, first + 2]])


@ti.func
def box_distance(boxes: ti.template(), i, p):
    """Squared distance from p to box i."""
    out = p[0] * 0.0
    for a in ti.static(range(3)):
        off = ti.max(ti.max(boxes[i, a] - p[a], p[a] - boxes[i, a + 3]), 0.0 * p[a])
        out += off * off
    return out


@ti.func
def closest_on_edge(p, a, b):
    """Parameter along the edge from a to b of the point nearest to p, 0 to 1."""
    way = b - a
    square = way.norm_sqr()
    t = p[0] * 0.0
    if square > 0.0:
        t = ti.min(ti.max((p - a).dot(way) / square, 0.0 * square), 1.0 + 0.0 * square)
    return t


@ti.func
def closest_on_triangle(p, a, b, c):
    """Barycentric weights of the point of a triangle nearest to p.

    The projection to its plane where that is inside, otherwise the nearest point of the three
    edges.
    """
    u, v, w = b - a, c - a, p - a
    n = u.cross(v)
    area = n.norm_sqr()
    weights = ti.Vector([p[0] * 0.0, p[0] * 0.0, p[0] * 0.0])
    inside = 0
    if area > 0.0:
        s, t = w.cross(v).dot(n) / area, u.cross(w).dot(n) / area
        if s >= 0.0 and t >= 0.0 and s + t <= 1.0:
            inside = 1
            weights = ti.Vector([1.0 - s - t, s, t])
    if inside == 0:
        least = p[0] * 0.0 + ti.math.inf
        for k in ti.static(range(3)):
            first, last = (a, b, c)[k], (b, c, a)[k]
            along = closest_on_edge(p, first, last)
            square = (p - first - along * (last - first)).norm_sqr()
            if square < least:
                least = square
                for j in ti.static(range(3)):
                    weights[j] = 0.0 * along
                weights[k] = 1.0 - along
                weights[(k + 1) % 3] = along
    return weights


@ti.func
def normal_of(points: ti.template(), corners: ti.template(), t):
    """Unit normal of triangle t; 0 where it has no area."""
    a = vector(points, corners[t, 0])
    n = (vector(points, corners[t, 1]) - a).cross(vector(points, corners[t, 2]) - a)
    size = n.norm()
    if size > 0.0:
        n /= size
    return n


@ti.func
def angle_of(points: ti.template(), corners: ti.template(), t, k):
    """Angle of triangle t at its corner k."""
    a = vector(points, corners[t, k])
    u = vector(points, corners[t, (k + 1) % 3]) - a
    v = vector(points, corners[t, (k + 2) % 3]) - a
    return ti.atan2(u.cross(v).norm(), u.dot(v))


@ti.func
def pseudo_normal(
    points: ti.template(), corners: ti.template(), around: ti.template(), t, w, faces, first, list0
):
    """The angle-weighted normal of the face, edge or vertex that contains the point with weights w.

    around : of `SurfaceTree`, whose list of the surface begins at `list0`; faces : its number of
    triangles, the first of which is `first`.
    """
    zeros = 0
    corner = 0  # whose weight is 0
    most = 0  # the corner with the largest
    for k in ti.static(range(3)):
        if w[k] <= ti.static(ON_EDGE):
            zeros += 1
            corner = k
        if w[k] > w[most]:
            most = k
    n = normal_of(points, corners, t)
    own = t - first
    if zeros == 1:
        n = 0.0 * n
        edge = around[list0 + 3 * own + (corner + 1) % 3]
        start = list0 + 6 * faces + edge
        for e in range(list0 + around[start], list0 + around[start + 1]):
            n += normal_of(points, corners, first + around[e])
    if zeros == 2:
        n = 0.0 * n
        start = list0 + around[list0 + 3 * faces + 3 * own + most]
        for e in range(list0 + around[start], list0 + around[start + 1]):
            other = first + around[e] // 3
            n += angle_of(points, corners, other, around[e] % 3) * normal_of(points, corners, other)
    return n


@ti.func
def nearest_in_leaf(points: ti.template(), corners: ti.template(), first, behind, p, best, at, w):
    """The nearest of triangles `first` to `behind` (exclusive), if nearer than `best` [m^2]."""
    for t in range(first, behind):
        a, b = vector(points, corners[t, 0]), vector(points, corners[t, 1])
        c = vector(points, corners[t, 2])
        # Most triangles of a leaf are excluded by their own boxes.
        low, high = ti.min(a, ti.min(b, c)), ti.max(a, ti.max(b, c))
        if ti.max(ti.max(low - p, p - high), 0.0 * p).norm_sqr() < best:
            weights = closest_on_triangle(p, a, b, c)
            square = (p - weights[0] * a - weights[1] * b - weights[2] * c).norm_sqr()
            if square < best:
                best, at, w = square, t, weights
    return best, at, w


@ti.func
def keep_box(boxes: ti.template(), i, low, high):
    """Store the corners of box i."""
    for a in ti.static(range(3)):
        boxes[i, a] = low[a]
        boxes[i, a + 3] = high[a]


@ti.func
def enclose_leaf(
    points: ti.template(), corners: ti.template(), boxes: ti.template(), first, behind, box
):
    """Bounding box of triangles `first` to `behind` (exclusive), a leaf."""
    low = vector(points, corners[first, 0])
    high = low
    for t in range(first, behind):
        for k in ti.static(range(3)):
            p = vector(points, corners[t, k])
            low, high = ti.min(low, p), ti.max(high, p)
    keep_box(boxes, box, low, high)


@ti.func
def enclose_children(boxes: ti.template(), root, node):
    """Bounding box of a node, from those of its children; root : where its tree begins."""
    left, right = root + 2 * node, root + 2 * node + 1
    for a in ti.static(range(3)):
        boxes[root + node, a] = ti.min(boxes[left, a], boxes[right, a])
        boxes[root + node, a + 3] = ti.max(boxes[left, a + 3], boxes[right, a + 3])


@on_arrays
@ti.kernel
def closest_points(
    X: ti.types.ndarray(dtype=ti.f64, ndim=2),
    of: ti.types.ndarray(dtype=ti.i32, ndim=1),
    points: ti.types.ndarray(dtype=ti.f64, ndim=2),
    corners: ti.types.ndarray(dtype=ti.i32, ndim=2),
    around: ti.types.ndarray(dtype=ti.i32, ndim=1),
    boxes: ti.types.ndarray(dtype=ti.f64, ndim=2),
    starts: ti.types.ndarray(dtype=ti.i32, ndim=1),
    of_leaf: ti.types.ndarray(dtype=ti.i32, ndim=1),
    table: ti.types.ndarray(dtype=ti.i32, ndim=2),
    reach: ti.f64,
    moved: ti.i32,
    found: ti.types.ndarray(dtype=ti.f64, ndim=2),
    which: ti.types.ndarray(dtype=ti.i32, ndim=1),
):
    """The nearest triangle of its surface to each X (n, 3) [m] within a reach [m], -1 where there
    is none.

    of : (n,) the surfaces; moved : 1: the boxes of some are first refitted, from the leaves to the
    root; found : (n, 6) weights and pseudo-normal, not normalized; which : (n,) before, a triangle
    that may be near, or -1; the others as in `SurfaceTree`.
    """
    for number in range(of_leaf.shape[0] * moved):
        k = of_leaf[number]
        if table[k, MOVED] == 1:
            # The list of starts has one more of each surface than there are leaves.
            leaf = table[k, FIRST_LEAF] + number - table[k, BOXES] // 2
            box = table[k, LEAVES] + number + table[k, BOXES] // 2
            enclose_leaf(points, corners, boxes, starts[leaf], starts[leaf + 1], box)
    for k in range(table.shape[0] * moved):
        if table[k, MOVED] == 1:
            node = table[k, LEAVES] - 1
            while node > 0:
                enclose_children(boxes, table[k, BOXES], node)
                node -= 1
    for i in range(X.shape[0]):
        p = vector(X, i)
        k = of[i]
        leaves, root = table[k, LEAVES], table[k, BOXES]
        first = table[k, FIRST_LEAF] - leaves  # of leaf i is the start at i
        best, at = reach * reach, -1
        w = 0.0 * p
        if which[i] >= 0:
            # Only boxes that are farther are skipped: what is found does not depend on it.
            a, b = vector(points, corners[which[i], 0]), vector(points, corners[which[i], 1])
            c = vector(points, corners[which[i], 2])
            nearest = closest_on_triangle(p, a, b, c)
            square = (p - nearest[0] * a - nearest[1] * b - nearest[2] * c).norm_sqr()
            size = ti.max(ti.abs(p[0]), ti.max(ti.abs(p[1]), ti.abs(p[2])))
            bound = NOT_NEARER * ti.sqrt(square) + ROUNDING * size
            best = ti.min(best, bound * bound)
        node = 1
        siblings = 0  # a bit for each level, the last one that of the node
        going = box_distance(boxes, root + 1, p) < best
        while going:
            up = 1
            if node < leaves:
                child = 2 * node
                one = box_distance(boxes, root + child, p)
                other = box_distance(boxes, root + child + 1, p)
                if other < one:
                    child += 1
                if ti.min(one, other) < best:
                    siblings = 2 * siblings + int(ti.max(one, other) < best)
                    node, up = child, 0
            else:
                leaf = first + node
                best, at, w = nearest_in_leaf(
                    points, corners, starts[leaf], starts[leaf + 1], p, best, at, w
                )
            while up == 1:  # to the next sibling that is still near
                while node > 1 and siblings % 2 == 0:
                    node //= 2
                    siblings //= 2
                if node == 1:
                    up, going = 0, False
                else:
                    node ^= 1
                    siblings -= 1
                    if box_distance(boxes, root + node, p) < best:
                        up = 0
        which[i] = at
        if at >= 0:
            n = pseudo_normal(
                points, corners, around, at, w, table[k, FACES], table[k, TRIANGLES],
                table[k, AROUND],
            )  # fmt: skip
            for a in ti.static(range(3)):
                found[i, a] = w[a]
                found[i, a + 3] = n[a]
