# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false
"""Rasterization: the surface that each sample sees, and the depth that each light sees.

Both questions are depth buffers.  A minimum does not depend on the order in which threads reach
it, so every picture is bit-identical from run to run and across thread counts.

Triangles are drawn by homogeneous edge functions [Olano and Greer 1997]: with corners
p = (X, Y, w) in clip space and the sample r = (x, y, 1), e_0 = r . (p_1 x p_2) and cyclic;
then w = det(p_0, p_1, p_2) / sum e_i is the depth and b_i = w e_i / det are the barycentric
coordinates in space, so interpolation is perspective-correct and nothing needs clipping.  Two
neighbors evaluate their shared edge to exactly opposite numbers: no cracks, no double cover.
"""

from gf_usd.system.taichi_runtime import import_taichi

ti = import_taichi()

F32_1, F32_2, F32_3 = (ti.types.ndarray(dtype=ti.f32, ndim=n) for n in (1, 2, 3))
F64_1, F64_2 = (ti.types.ndarray(dtype=ti.f64, ndim=n) for n in (1, 2))
I32_1, I32_2 = (ti.types.ndarray(dtype=ti.i32, ndim=n) for n in (1, 2))
I64_2 = ti.types.ndarray(dtype=ti.i64, ndim=2)

vec2, vec3 = (ti.types.vector(n, ti.f32) for n in (2, 3))
dvec3 = ti.types.vector(3, ti.f64)

EMPTY = (1 << 63) - 1  # the key of a sample that sees nothing
EMPTY_BITS = EMPTY >> 32  # the depth in it


@ti.func
def row(a: ti.template(), i):
    """Row i of a (n, 3) array."""
    return ti.Vector([a[i, 0], a[i, 1], a[i, 2]])


@ti.func
def part(a: ti.template(), i):
    """Three numbers of a flat array from i on."""
    return ti.Vector([a[i], a[i + 1], a[i + 2]])


@ti.func
def single(v):
    """A vector in 32 bits, by component: the cast of a whole vector does not compile."""
    return ti.Vector([ti.cast(v[0], ti.f32), ti.cast(v[1], ti.f32), ti.cast(v[2], ti.f32)])


@ti.func
def double(v):
    """A vector in 64 bits."""
    return ti.Vector([ti.cast(v[0], ti.f64), ti.cast(v[1], ti.f64), ti.cast(v[2], ti.f64)])


@ti.func
def depth_key(depth, index):
    """Nearest first, then lowest index: positive floats order like their bits."""
    bits = ti.cast(ti.bit_cast(ti.cast(depth, ti.f32), ti.i32), ti.i64)
    return (bits << 32) | ti.cast(index, ti.i64)


@ti.func
def edge_functions(clip: ti.template(), tri: ti.template(), t):
    """Rows e_i of the edge functions of triangle t, and det(p_0, p_1, p_2)."""
    a, b, c = row(clip, tri[t, 0]), row(clip, tri[t, 1]), row(clip, tri[t, 2])
    e0, e1, e2 = b.cross(c), c.cross(a), a.cross(b)
    return e0, e1, e2, a.dot(e0)


@ti.func
def sample_at(x, y, skew):
    """Where sample (x, y) looks: with skew 1/4 each 2 x 2 block is a rotated grid.

    Its four samples then lie in four different rows and columns, which smooths upright and level
    edges in four steps instead of two.
    """
    return (
        x + 0.5 + skew * (2.0 * (y % 2) - 1.0),
        y + 0.5 - skew * (2.0 * (x % 2) - 1.0),
    )


@ti.func
def owns(e, value):
    """Inside the edge; a sample exactly on it belongs to one of its two triangles."""
    return value > 0.0 or (value == 0.0 and (e[0] > 0.0 or (e[0] == 0.0 and e[1] > 0.0)))


@ti.kernel
def draw_triangles(clip: F64_2, tri: I32_2, near: ti.f64, skew: ti.f64, key: I64_2):
    """Depth-test triangles (T, 3) over corners clip (V, 3) = (X, Y, w), X / w in samples."""
    for t in range(tri.shape[0]):
        e0, e1, e2, det = edge_functions(clip, tri, t)
        low_w = ti.min(clip[tri[t, 0], 2], clip[tri[t, 1], 2], clip[tri[t, 2], 2])
        high_w = ti.max(clip[tri[t, 0], 2], clip[tri[t, 1], 2], clip[tri[t, 2], 2])
        if det != 0.0 and high_w > near:
            side = 1.0 if det > 0.0 else -1.0
            e0, e1, e2 = side * e0, side * e1, side * e2
            x0, x1, y0, y1 = 0, key.shape[1] - 1, 0, key.shape[0] - 1
            if low_w > near:
                a = row(clip, tri[t, 0]) / clip[tri[t, 0], 2]
                b = row(clip, tri[t, 1]) / clip[tri[t, 1], 2]
                c = row(clip, tri[t, 2]) / clip[tri[t, 2], 2]
                low = ti.min(a, b, c)
                high = ti.max(a, b, c)
                x0 = ti.max(x0, ti.cast(ti.floor(ti.max(low[0], -1.0) - 0.75), ti.i32))
                y0 = ti.max(y0, ti.cast(ti.floor(ti.max(low[1], -1.0) - 0.75), ti.i32))
                x1 = ti.min(x1, ti.cast(ti.ceil(ti.min(high[0], 1e6) - 0.25), ti.i32))
                y1 = ti.min(y1, ti.cast(ti.ceil(ti.min(high[1], 1e6) - 0.25), ti.i32))
            for y in range(y0, y1 + 1):
                for x in range(x0, x1 + 1):
                    sx, sy = sample_at(x, y, skew)
                    r = ti.Vector([sx, sy, ti.f64(1.0)])
                    v0, v1, v2 = r.dot(e0), r.dot(e1), r.dot(e2)
                    if owns(e0, v0) and owns(e1, v1) and owns(e2, v2):
                        w = side * det / (v0 + v1 + v2)
                        if w > near:
                            ti.atomic_min(key[y, x], depth_key(w, t))


@ti.func
def view_ray(camera: ti.template(), x, y):
    """World direction through sample coordinates (x, y), with unit component along the view."""
    a = (x - camera[13]) / camera[12]
    b = (camera[14] - y) / camera[12]
    return a * part(camera, 3) + b * part(camera, 6) + part(camera, 9)


@ti.func
def hit_ellipsoid(camera: ti.template(), center: ti.template(), inverse: ti.template(), i, d):
    """First s > 0 with |M (eye + s d - c)| = 1, else -1, and the point of the unit sphere."""
    o = part(camera, 0) - double(row(center, i))
    q = dvec3(0.0, 0.0, 0.0)
    m = dvec3(0.0, 0.0, 0.0)
    for k in ti.static(range(3)):
        for j in ti.static(range(3)):
            q[k] += inverse[i, 3 * k + j] * o[j]
            m[k] += inverse[i, 3 * k + j] * d[j]
    mm, mq = m.dot(m), m.dot(q)
    # |q|^2 |m|^2 - (m.q)^2 as |q x m|^2 keeps its digits for a small, far ellipsoid
    disc = mm - q.cross(m).norm_sqr()
    s = ti.f64(-1.0)
    if disc > 0.0:
        s = (-mq - ti.sqrt(disc)) / mm
    return s, q + s * m


@ti.kernel
def draw_ellipsoids(
    center: F32_2, inverse: F32_2, reach: F32_1, camera: F64_1, first: ti.i32, key: I64_2
):
    """Depth-test ellipsoids |M (x - c)| = 1, M (N, 9), within reach (N,) of c; ids from first."""
    for i in range(center.shape[0]):
        o = double(row(center, i)) - part(camera, 0)
        z = o.dot(part(camera, 9))
        near = camera[15]
        if z + reach[i] > near:
            x0, x1, y0, y1 = 0, key.shape[1] - 1, 0, key.shape[0] - 1
            if z - reach[i] > near:
                a, b = o.dot(part(camera, 3)) / z, o.dot(part(camera, 6)) / z
                spread = reach[i] / (z - reach[i])
                px, py = camera[13] + camera[12] * a, camera[14] - camera[12] * b
                sx = camera[12] * spread * (1.0 + ti.abs(a)) + 1.0
                sy = camera[12] * spread * (1.0 + ti.abs(b)) + 1.0
                x0 = ti.max(x0, ti.cast(ti.floor(ti.max(px - sx, -1.0)), ti.i32))
                y0 = ti.max(y0, ti.cast(ti.floor(ti.max(py - sy, -1.0)), ti.i32))
                x1 = ti.min(x1, ti.cast(ti.ceil(ti.min(px + sx, 1e6)), ti.i32))
                y1 = ti.min(y1, ti.cast(ti.ceil(ti.min(py + sy, 1e6)), ti.i32))
            for y in range(y0, y1 + 1):
                for x in range(x0, x1 + 1):
                    sx, sy = sample_at(x, y, camera[16])
                    d = view_ray(camera, sx, sy)
                    s, _ = hit_ellipsoid(camera, center, inverse, i, d)
                    if s > near:
                        ti.atomic_min(key[y, x], depth_key(s, first + i))


@ti.func
def to_map(frames: ti.template(), light, p, radius, size):
    """Texel coordinates and depth of p in the map of one light."""
    u = (frames[light, 0] * p[0] + frames[light, 1] * p[1] + frames[light, 2] * p[2]) / radius
    v = (frames[light, 3] * p[0] + frames[light, 4] * p[1] + frames[light, 5] * p[2]) / radius
    z = frames[light, 6] * p[0] + frames[light, 7] * p[1] + frames[light, 8] * p[2]
    return vec3(0.5 * size * (1.0 + u), 0.5 * size * (1.0 + v), -z)


@ti.kernel
def shadow_triangles(points: F32_2, tri: I32_2, frames: F32_2, radius: ti.f32, depth: F32_3):
    """Depth of triangles as each light l sees them; frames (L, 10): right, up, to the light."""
    count, size = tri.shape[0], depth.shape[1]
    for job in range(frames.shape[0] * count):
        light, t = job // count, job % count
        a = to_map(frames, light, row(points, tri[t, 0]), radius, size)
        b = to_map(frames, light, row(points, tri[t, 1]), radius, size)
        c = to_map(frames, light, row(points, tri[t, 2]), radius, size)
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area != 0.0:
            low, high = ti.min(a, b, c), ti.max(a, b, c)
            x0 = ti.max(0, ti.cast(ti.ceil(low[0] - 0.5), ti.i32))
            y0 = ti.max(0, ti.cast(ti.ceil(low[1] - 0.5), ti.i32))
            x1 = ti.min(size - 1, ti.cast(ti.floor(high[0] - 0.5), ti.i32))
            y1 = ti.min(size - 1, ti.cast(ti.floor(high[1] - 0.5), ti.i32))
            for y in range(y0, y1 + 1):
                for x in range(x0, x1 + 1):
                    dx, dy = x + 0.5 - a[0], y + 0.5 - a[1]
                    s = (dx * (c[1] - a[1]) - dy * (c[0] - a[0])) / area
                    r = (dy * (b[0] - a[0]) - dx * (b[1] - a[1])) / area
                    if s >= -1e-4 and r >= -1e-4 and s + r <= 1.0002:
                        z = a[2] + s * (b[2] - a[2]) + r * (c[2] - a[2])
                        ti.atomic_min(depth[light, y, x], z)


@ti.kernel
def shadow_blobs(center: F32_2, covariance: F32_2, frames: F32_2, radius: ti.f32, depth: F32_3):
    """Depth of ellipsoids x' C^-1 x = 1, C (N, 6) = xx xy xz yy yz zz, as tilted discs.

    A disc lies where the ellipsoid is widest along the light: at the mean of z given x and y.
    """
    count, size = center.shape[0], depth.shape[1]
    for job in range(frames.shape[0] * count):
        light, i = job // count, job % count
        p = to_map(frames, light, row(center, i), radius, size)
        k = 0.5 * size / radius
        u, v, w = vec3(0.0), vec3(0.0), vec3(0.0)
        towards = ti.Vector([frames[light, 6], frames[light, 7], frames[light, 8]])
        right = ti.Vector([frames[light, 0], frames[light, 1], frames[light, 2]])
        upward = ti.Vector([frames[light, 3], frames[light, 4], frames[light, 5]])
        for r in ti.static(range(3)):
            for c in ti.static(range(3)):
                low, high = min(r, c), max(r, c)
                u[r] += covariance[i, low * (5 - low) // 2 + high] * right[c]
                v[r] += covariance[i, low * (5 - low) // 2 + high] * upward[c]
                w[r] += covariance[i, low * (5 - low) // 2 + high] * towards[c]
        # a quarter texel at least, so that a grain finer than the map still shades
        xx = ti.max(k * k * u.dot(right), 0.25)
        yy = ti.max(k * k * v.dot(upward), 0.25)
        xy = k * k * u.dot(upward)
        det = ti.max(xx * yy - xy * xy, 1e-6)
        xz, yz = -k * w.dot(right), -k * w.dot(upward)
        tilt_x, tilt_y = (yy * xz - xy * yz) / det, (xx * yz - xy * xz) / det
        sy = ti.sqrt(yy)
        y0 = ti.max(0, ti.cast(ti.ceil(p[1] - sy - 0.5), ti.i32))
        y1 = ti.min(size - 1, ti.cast(ti.floor(p[1] + sy - 0.5), ti.i32))
        for y in range(y0, y1 + 1):
            # yy dx^2 - 2 xy dx dy + xx dy^2 <= det, solved for dx
            dy = y + 0.5 - p[1]
            middle = p[0] - 0.5 + xy * dy / yy
            half = ti.sqrt(ti.max(det * (yy - dy * dy), 0.0)) / yy
            x0 = ti.max(0, ti.cast(ti.ceil(middle - half), ti.i32))
            x1 = ti.min(size - 1, ti.cast(ti.floor(middle + half), ti.i32))
            for x in range(x0, x1 + 1):
                dx = x + 0.5 - p[0]
                ti.atomic_min(depth[light, y, x], p[2] + tilt_x * dx + tilt_y * dy)
