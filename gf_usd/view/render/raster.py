# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false
"""Rasterization into the z-buffer of the camera and the shadow maps of the lights.

Both are depth buffers.  A minimum does not depend on the order in which threads compute it, so
images are bit-identical from run to run and across thread counts.

Triangles are drawn by homogeneous edge functions [Olano and Greer 1997]: with corners
p = (X, Y, w) in clip space and the sample r = (x, y, 1), e_0 = r . (p_1 x p_2) and cyclic;
then w = det(p_0, p_1, p_2) / sum e_i is the depth and b_i = w e_i / det are the barycentric
coordinates in space, so interpolation is perspective-correct and clipping is not needed.  Adjacent
triangles evaluate their shared edge to exactly opposite numbers: no cracks, no double coverage.
"""

from gf_usd.system.taichi_runtime import import_taichi

ti = import_taichi()

F32_1, F32_2, F32_3 = (ti.types.ndarray(dtype=ti.f32, ndim=n) for n in (1, 2, 3))
F64_1, F64_2 = (ti.types.ndarray(dtype=ti.f64, ndim=n) for n in (1, 2))
I32_1, I32_2 = (ti.types.ndarray(dtype=ti.i32, ndim=n) for n in (1, 2))
I64_2 = ti.types.ndarray(dtype=ti.i64, ndim=2)

vec2, vec3 = (ti.types.vector(n, ti.f32) for n in (2, 3))
dvec3 = ti.types.vector(3, ti.f64)

EMPTY = (1 << 63) - 1  # depth key of a sample without a surface
EMPTY_BITS = EMPTY >> 32  # its depth bits


@ti.func
def row(a: ti.template(), i):
    """Row i of a (n, 3) array."""
    return ti.Vector([a[i, 0], a[i, 1], a[i, 2]])


@ti.func
def vector_at(a: ti.template(), i):
    """The vector at offset i of a flat array."""
    return ti.Vector([a[i], a[i + 1], a[i + 2]])


@ti.func
def to_f32(v):
    """A vector in float32, by component: Taichi does not compile the cast of a whole vector."""
    return ti.Vector([ti.cast(v[0], ti.f32), ti.cast(v[1], ti.f32), ti.cast(v[2], ti.f32)])


@ti.func
def to_f64(v):
    """A vector in float64."""
    return ti.Vector([ti.cast(v[0], ti.f64), ti.cast(v[1], ti.f64), ti.cast(v[2], ti.f64)])


@ti.func
def depth_key(depth, index):
    """64-bit key that orders by depth, then by index: positive floats order like their bits."""
    bits = ti.cast(ti.bit_cast(ti.cast(depth, ti.f32), ti.i32), ti.i64)
    return (bits << 32) | ti.cast(index, ti.i64)


@ti.func
def edge_functions(clip: ti.template(), tri: ti.template(), t):
    """Rows e_i of the edge functions of triangle t, and det(p_0, p_1, p_2)."""
    a, b, c = row(clip, tri[t, 0]), row(clip, tri[t, 1]), row(clip, tri[t, 2])
    e0, e1, e2 = b.cross(c), c.cross(a), a.cross(b)
    return e0, e1, e2, a.dot(e0)


@ti.func
def sample_position(x, y, skew):
    """Position of sample (x, y); with skew 1/4 each 2 x 2 block is a rotated grid.

    Its four samples then lie in four different rows and columns, so that vertical and horizontal
    edges have four levels of coverage instead of two.
    """
    return (
        x + 0.5 + skew * (2.0 * (y % 2) - 1.0),
        y + 0.5 - skew * (2.0 * (x % 2) - 1.0),
    )


@ti.func
def covers(e, value):
    """Inside an edge (fill rule); a sample exactly on it belongs to one of its two triangles."""
    return value > 0.0 or (value == 0.0 and (e[0] > 0.0 or (e[0] == 0.0 and e[1] > 0.0)))


@ti.kernel
def draw_triangles(clip: F64_2, tri: I32_2, near: ti.f64, skew: ti.f64, zbuffer: I64_2):
    """Draw triangles (T, 3) with vertices clip (V, 3) = (X, Y, w) of `PinholeCamera.clip`."""
    for t in range(tri.shape[0]):
        e0, e1, e2, det = edge_functions(clip, tri, t)
        low_w = ti.min(clip[tri[t, 0], 2], clip[tri[t, 1], 2], clip[tri[t, 2], 2])
        high_w = ti.max(clip[tri[t, 0], 2], clip[tri[t, 1], 2], clip[tri[t, 2], 2])
        if det != 0.0 and high_w > near:
            side = 1.0 if det > 0.0 else -1.0
            e0, e1, e2 = side * e0, side * e1, side * e2
            x0, x1, y0, y1 = 0, zbuffer.shape[1] - 1, 0, zbuffer.shape[0] - 1
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
                    sx, sy = sample_position(x, y, skew)
                    r = ti.Vector([sx, sy, ti.f64(1.0)])
                    v0, v1, v2 = r.dot(e0), r.dot(e1), r.dot(e2)
                    if covers(e0, v0) and covers(e1, v1) and covers(e2, v2):
                        w = side * det / (v0 + v1 + v2)
                        if w > near:
                            ti.atomic_min(zbuffer[y, x], depth_key(w, t))


@ti.func
def camera_ray(camera: ti.template(), x, y):
    """Camera ray through image coordinates (x, y) [samples]; its component along the view is 1."""
    a = (x - camera[13]) / camera[12]
    b = (camera[14] - y) / camera[12]
    return a * vector_at(camera, 3) + b * vector_at(camera, 6) + vector_at(camera, 9)


@ti.func
def intersect_ellipsoid(camera: ti.template(), center: ti.template(), inverse: ti.template(), i, d):
    """First s > 0 with |M (eye + s d - c)| = 1, else -1, and M (eye + s d - c)."""
    offset = vector_at(camera, 0) - to_f64(row(center, i))
    q = dvec3(0.0, 0.0, 0.0)
    m = dvec3(0.0, 0.0, 0.0)
    for k in ti.static(range(3)):
        for j in ti.static(range(3)):
            q[k] += inverse[i, 3 * k + j] * offset[j]
            m[k] += inverse[i, 3 * k + j] * d[j]
    mm, mq = m.dot(m), m.dot(q)
    # |q|^2 |m|^2 - (m.q)^2 as |q x m|^2: no cancellation for a small, distant ellipsoid
    disc = mm - q.cross(m).norm_sqr()
    s = ti.f64(-1.0)
    if disc > 0.0:
        s = (-mq - ti.sqrt(disc)) / mm
    return s, q + s * m


@ti.kernel
def draw_ellipsoids(
    center: F32_2, inverse: F32_2, radius_bound: F32_1, camera: F64_1, first: ti.i32, zbuffer: I64_2
):
    """Draw ellipsoids |M (x - c)| = 1, M (N, 9), of longest semi-axes radius_bound (N,).

    Their indices in the z-buffer start at `first`.
    """
    for i in range(center.shape[0]):
        offset = to_f64(row(center, i)) - vector_at(camera, 0)
        z = offset.dot(vector_at(camera, 9))
        near = camera[15]
        if z + radius_bound[i] > near:
            x0, x1, y0, y1 = 0, zbuffer.shape[1] - 1, 0, zbuffer.shape[0] - 1
            if z - radius_bound[i] > near:
                a, b = offset.dot(vector_at(camera, 3)) / z, offset.dot(vector_at(camera, 6)) / z
                spread = radius_bound[i] / (z - radius_bound[i])
                px, py = camera[13] + camera[12] * a, camera[14] - camera[12] * b
                sx = camera[12] * spread * (1.0 + ti.abs(a)) + 1.0
                sy = camera[12] * spread * (1.0 + ti.abs(b)) + 1.0
                x0 = ti.max(x0, ti.cast(ti.floor(ti.max(px - sx, -1.0)), ti.i32))
                y0 = ti.max(y0, ti.cast(ti.floor(ti.max(py - sy, -1.0)), ti.i32))
                x1 = ti.min(x1, ti.cast(ti.ceil(ti.min(px + sx, 1e6)), ti.i32))
                y1 = ti.min(y1, ti.cast(ti.ceil(ti.min(py + sy, 1e6)), ti.i32))
            for y in range(y0, y1 + 1):
                for x in range(x0, x1 + 1):
                    sx, sy = sample_position(x, y, camera[16])
                    d = camera_ray(camera, sx, sy)
                    s, _ = intersect_ellipsoid(camera, center, inverse, i, d)
                    if s > near:
                        ti.atomic_min(zbuffer[y, x], depth_key(s, first + i))


@ti.func
def in_light_axes(frames: ti.template(), light, p):
    """Components of p to the right, up and towards the light of one light direction."""
    return vec3(
        frames[light, 0] * p[0] + frames[light, 1] * p[1] + frames[light, 2] * p[2],
        frames[light, 3] * p[0] + frames[light, 4] * p[1] + frames[light, 5] * p[2],
        frames[light, 6] * p[0] + frames[light, 7] * p[1] + frames[light, 8] * p[2],
    )


@ti.func
def to_shadow_map(frames: ti.template(), light, p, radius, size):
    """Texel coordinates and depth of p in the shadow map of one light direction."""
    q = in_light_axes(frames, light, p)
    u, v = q[0] / radius, q[1] / radius
    return vec3(0.5 * size * (1.0 + u), 0.5 * size * (1.0 + v), -q[2])


@ti.kernel
def shadow_triangles(points: F32_2, tri: I32_2, frames: F32_2, radius: ti.f32, depth: F32_3):
    """Draw triangles into the shadow map of each light direction, frames (L, 10) of `LightRig`."""
    count, size = tri.shape[0], depth.shape[1]
    for job in range(frames.shape[0] * count):
        light, t = job // count, job % count
        a = to_shadow_map(frames, light, row(points, tri[t, 0]), radius, size)
        b = to_shadow_map(frames, light, row(points, tri[t, 1]), radius, size)
        c = to_shadow_map(frames, light, row(points, tri[t, 2]), radius, size)
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
def shadow_ellipsoids(
    center: F32_2, covariance: F32_2, frames: F32_2, radius: ti.f32, depth: F32_3
):
    """Draw ellipsoids x' C^-1 x = 1, C (N, 6) = xx xy xz yy yz zz, into the shadow maps as discs.

    The disc of an ellipsoid contains its silhouette in the view of the light: its depth is the
    conditional mean of z given x and y.
    """
    count, size = center.shape[0], depth.shape[1]
    for job in range(frames.shape[0] * count):
        light, i = job // count, job % count
        p = to_shadow_map(frames, light, row(center, i), radius, size)
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
        # a radius of half a texel at least, so that smaller particles cast shadows too
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
