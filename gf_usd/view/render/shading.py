# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false
"""The color of each pixel: the mean over its samples of what they see.

The floor is the background itself, darkened by the light it lacks: there is no horizon.

Texture look-ups inside kernels: wrapping, bilinear, and the mean over a sample's footprint.
"""

from gf_usd.system.taichi_runtime import import_taichi
from gf_usd.view.render.lighting import (
    CENTER,
    EDGE,
    FLOOR,
    RADIUS,
    UP,
    dome_seen,
    floor_factor,
    key_seen,
    lit,
    smooth,
)
from gf_usd.view.render.raster import (
    EMPTY_BITS,
    F32_1,
    F32_2,
    F32_3,
    F64_1,
    F64_2,
    I32_1,
    I32_2,
    I64_2,
    double,
    dvec3,
    edge_functions,
    hit_ellipsoid,
    part,
    row,
    sample_at,
    single,
    vec2,
    vec3,
    view_ray,
)
from gf_usd.view.render.textures import LEVELS

ti = import_taichi()


SAME_PATCH = 0.99  # cosine between normals in one pixel that may share one evaluation of the lights
BRIGHTEST = 4.0  # of one sample: an edge against a highlight stays smooth


@ti.func
def triple(a: ti.template(), t, b):
    """Mean of a triangle's three corner vectors, a (T, 9), by weights b."""
    out = vec3(0.0)
    for c in ti.static(range(3)):
        for k in ti.static(range(3)):
            out[k] += b[c] * a[t, 3 * c + k]
    return out


@ti.func
def weights(clip: ti.template(), tri: ti.template(), t, x, y):
    """Perspective-correct barycentric coordinates of triangle t at sample position (x, y)."""
    e0, e1, e2, _ = edge_functions(clip, tri, t)
    r = dvec3(x, y, 1.0)
    b = dvec3(r.dot(e0), r.dot(e1), r.dot(e2))
    return single(b / (b[0] + b[1] + b[2]))


@ti.func
def pair(uvs: ti.template(), t, b):
    """Texture coordinates, uvs (T, 6), by weights b."""
    return vec2(
        b[0] * uvs[t, 0] + b[1] * uvs[t, 2] + b[2] * uvs[t, 4],
        b[0] * uvs[t, 1] + b[1] * uvs[t, 3] + b[2] * uvs[t, 5],
    )


@ti.func
def backdrop(uniforms: ti.template(), x, y):
    """The studio wall: light in the middle, darker at the corners; x, y in -1..1."""
    t = smooth(0.15, 1.55, ti.sqrt(x * x + (y - 0.12) * (y - 0.12)))
    return part(uniforms, CENTER) * (1.0 - t) + part(uniforms, EDGE) * t


@ti.func
def facing(normal, flat, v):
    """A shading normal on the side of the surface that v sees, and no further than grazing."""
    n = normal
    if normal.dot(flat) * flat.dot(v) < 0.0:
        n = -1.0 * normal
    away = n.dot(v)
    if away < 0.02:
        n += (0.02 - away) * v
    return n.normalized()


@ti.kernel
def shade(
    key: I64_2,
    oversampling: ti.i32,
    camera: F64_1,
    clip: F64_2,
    tri: I32_2,
    points: F32_2,
    normals: F32_2,
    colors: F32_2,
    uvs: F32_2,
    finish: F32_2,
    skin: I32_1,
    texels: F32_2,
    levels: I32_2,
    kinds: I32_2,
    center: F32_2,
    inverse: F32_2,
    tint: F32_2,
    uniforms: F32_1,
    frames: F32_2,
    keys: ti.i32,
    key_depth: F32_3,
    dome_depth: F32_3,
    floor: F32_3,
    out: F32_3,
    seen: F32_2,
):
    """Resolve keys (H s, W s) into linear color out (H, W, 3) and depth seen (H, W).

    The depth is that of the farthest sample: a pixel on an outline hides nothing behind it.

    Triangles have normals and colors (T, 9), uvs (T, 6), finish (T, 2) roughness and metallic,
    skin (T,) texture or -1; ids from T on are ellipsoids with tint (N, 3).
    """
    for py, px in ti.ndrange(out.shape[0], out.shape[1]):
        total = vec3(0.0)
        farthest = 0.0
        sun, sky, lit_id, lit_n = 0.0, 0.0, -1, vec3(0.0)
        for s in range(oversampling * oversampling):
            y = py * oversampling + s // oversampling
            x = px * oversampling + s % oversampling
            sx, sy = sample_at(x, y, camera[16])
            d = view_ray(camera, sx, sy)
            v = -1.0 * single(d).normalized()
            color = vec3(0.0)
            nearness = ti.cast(key[y, x] >> 32, ti.i32)
            if nearness == EMPTY_BITS:
                farthest = 3e38
                a = ti.cast(2.0 * sx / key.shape[1] - 1.0, ti.f32)
                b = ti.cast(1.0 - 2.0 * sy / key.shape[0], ti.f32)
                color = backdrop(uniforms, a, b)
                up = double(part(uniforms, UP))
                height = part(camera, 0).dot(up) - uniforms[FLOOR]
                fall = -d.dot(up)
                if height > 0.0 and fall > 1e-6 * d.norm():
                    p = single(part(camera, 0) + height / fall * d)
                    color *= floor_factor(uniforms, floor, p)
            else:
                item = ti.cast(key[y, x], ti.i32)
                farthest = ti.max(farthest, ti.bit_cast(nearness, ti.f32))
                p, n, albedo = vec3(0.0), vec3(0.0), vec3(0.0)
                rough, metal = 0.5, 0.0
                if item < tri.shape[0]:
                    w = weights(clip, tri, item, sx, sy)
                    p0, p1 = row(points, tri[item, 0]), row(points, tri[item, 1])
                    p2 = row(points, tri[item, 2])
                    p = w[0] * p0 + w[1] * p1 + w[2] * p2
                    n = facing(triple(normals, item, w), (p1 - p0).cross(p2 - p0), v)
                    albedo = triple(colors, item, w)
                    rough, metal = finish[item, 0], finish[item, 1]
                    if skin[item] >= 0:
                        uv = pair(uvs, item, w)
                        du = pair(uvs, item, weights(clip, tri, item, sx + 1.0, sy)) - uv
                        dv = pair(uvs, item, weights(clip, tri, item, sx, sy + 1.0)) - uv
                        albedo = textured(texels, levels, kinds, skin[item], uv, du, dv)
                else:
                    i = item - tri.shape[0]
                    t, q = hit_ellipsoid(camera, center, inverse, i, d)
                    p = single(part(camera, 0) + t * d)
                    # the gradient of |M (x - c)|^2 is M' q
                    for k in ti.static(range(3)):
                        for j in ti.static(range(3)):
                            n[k] += inverse[i, 3 * j + k] * ti.cast(q[j], ti.f32)
                    n = n.normalized()
                    albedo = row(tint, i)
                # neighboring samples of one smooth patch see the same light
                if lit_id != item or n.dot(lit_n) < SAME_PATCH:
                    sun = key_seen(p, n, frames, keys, key_depth, uniforms[RADIUS])
                    sky = dome_seen(p, n, frames, keys, dome_depth, uniforms[RADIUS])
                    lit_id, lit_n = item, n
                color = lit(uniforms, floor, p, n, v, albedo, rough, metal, sun, sky)
            total += ti.min(color, BRIGHTEST)
        for k in ti.static(range(3)):
            out[py, px, k] = total[k] / (oversampling * oversampling)
        seen[py, px] = farthest


@ti.func
def wrapped(i, size, kind):
    """Texel index in 0..size-1, or -1 for black."""
    j = i
    if kind == 1:
        j = ti.min(size - 1, ti.max(0, i))
    elif kind == 2:
        j = ti.raw_mod(ti.raw_mod(i, 2 * size) + 2 * size, 2 * size)
        if j >= size:
            j = 2 * size - 1 - j
    elif kind == 3:
        if i < 0 or i >= size:
            j = -1
    else:
        j = ti.raw_mod(ti.raw_mod(i, size) + size, size)
    return j


@ti.func
def bilinear(texels: ti.template(), levels: ti.template(), kinds: ti.template(), k, level, uv):
    """Texture k at one mip level, texel centers at halves."""
    start, w, h = (
        levels[k * LEVELS + level, 0],
        levels[k * LEVELS + level, 1],
        levels[k * LEVELS + level, 2],
    )
    a, b = uv[0] * w - 0.5, (1.0 - uv[1]) * h - 0.5
    fa, fb = ti.floor(a), ti.floor(b)
    out = vec3(0.0)
    for j in range(2):
        for i in range(2):
            x = wrapped(ti.cast(fa, ti.i32) + i, w, kinds[k, 1])
            y = wrapped(ti.cast(fb, ti.i32) + j, h, kinds[k, 2])
            s = a - fa if i == 1 else 1.0 - (a - fa)
            t = b - fb if j == 1 else 1.0 - (b - fb)
            if x >= 0 and y >= 0:
                out += s * t * row(texels, start + y * w + x)
    return out


@ti.func
def textured(texels: ti.template(), levels: ti.template(), kinds: ti.template(), k, uv, du, dv):
    """Mean of texture k over the sample's footprint: up to 4 trilinear taps along its long axis."""
    w, h = levels[k * LEVELS, 1], levels[k * LEVELS, 2]
    a = ti.Vector([du[0] * w, du[1] * h])
    b = ti.Vector([dv[0] * w, dv[1] * h])
    long, short, axis = a.norm(), b.norm(), du
    if short > long:
        long, short, axis = short, long, dv
    taps = ti.cast(ti.min(4.0, ti.max(1.0, ti.ceil(long / ti.max(short, 1e-6)))), ti.i32)
    level = ti.log(ti.max(1.0, long / taps)) / ti.log(2.0)
    top = kinds[k, 0] - 1
    low = ti.min(top, ti.cast(level, ti.i32))
    mix = ti.min(1.0, level - low)
    out = vec3(0.0)
    for i in range(taps):
        q = uv + ((i + 0.5) / taps - 0.5) * axis
        near = bilinear(texels, levels, kinds, k, low, q)
        if mix > 0.0 and low < top:
            far = bilinear(texels, levels, kinds, k, low + 1, q)
            near += mix * (far - near)
        out += near / taps
    return out
