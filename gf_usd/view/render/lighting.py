# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false
"""Lighting in kernels: visibility of the lights at a point, and the radiance it reflects.

Reflected radiance of a key light k, a fill light f and a dome, with albedo a, normal n, view v:
    a (1 - metal) (sky(n) o + L_k max(0, n.k) s + L_f max(0, n.f) o)
  + GGX(n, v, k) L_k s + GGX(n, v, f) L_f o + F(n.v) sky(r) o
where s is the visible fraction of the key light and o the cosine-weighted visible fraction of the
dome (ambient occlusion).
"""

from gf_usd.system.taichi_runtime import import_taichi
from gf_usd.view.render.raster import (
    F32_1,
    F32_2,
    F32_3,
    in_light_axes,
    row,
    to_shadow_map,
    vec2,
    vec3,
    vector_at,
)

ti = import_taichi()

# offsets in the uniforms array: vectors, then scalars (filled in surfaces.py)
UP, KEY_DIR, KEY, FILL_DIR, FILL, SKY, BOUNCE, CENTER, EDGE = (3 * i for i in range(9))
MAP_X, MAP_Y, MAP_O, RADIUS, FLOOR, MAP_HALF, KEY_SPREAD = 27, 30, 33, 36, 37, 38, 39
UNIFORM_COUNT = 40

# [texels] of a look-up of the dome, from the point itself
TAPS = ((0.0, 0.0), (2.6, 0.9), (-0.9, 2.6), (-2.6, -0.9), (0.9, -2.6))
FARTHEST_TAP = max(abs(offset) for tap in TAPS for offset in tap)
STEEPEST = 0.1  # cosine of the steepest plane that is followed


@ti.func
def smoothstep(low, high, x):
    """0 below low, 1 above high, a cubic Hermite polynomial between."""
    t = ti.min(1.0, ti.max(0.0, (x - low) / (high - low)))
    return t * t * (3.0 - 2.0 * t)


@ti.func
def texel_visibility(depth: ti.template(), light, x, y, z):
    """0 where a texel of a shadow map is nearer to the light than depth z, else 1."""
    size = depth.shape[1]
    visible = 1.0
    if 0 <= x < size and 0 <= y < size and depth[light, y, x] < z:
        visible = 0.0
    return visible


@ti.func
def in_map(q, size, reach):
    """Whether texels within `reach` of q are in the shadow map: nothing hides the others."""
    low, high = -reach, size + reach
    return low <= q[0] and q[0] <= high and low <= q[1] and q[1] <= high


@ti.func
def key_visibility(p, n, frames: ti.template(), key_count, depth: ti.template(), radius):
    """Visible fraction of the key light at p with normal n, by bilinear shadow map look-ups."""
    size = depth.shape[1]
    texel = 2.0 * radius / size
    visible, count = 0.0, 0.0
    biased = p + 1.6 * texel * n
    for light in range(key_count):
        if in_light_axes(frames, light, n)[2] > 0.0:
            q = to_shadow_map(frames, light, biased, radius, size)
            if not in_map(q, size, 1.0):
                visible, count = visible + 1.0, count + 1.0
                continue
            z = q[2] - 0.8 * texel
            fx, fy = ti.floor(q[0] - 0.5), ti.floor(q[1] - 0.5)
            s, t = q[0] - 0.5 - fx, q[1] - 0.5 - fy
            x, y = ti.cast(fx, ti.i32), ti.cast(fy, ti.i32)
            low = texel_visibility(depth, light, x, y, z) * (1.0 - s)
            low += texel_visibility(depth, light, x + 1, y, z) * s
            high = texel_visibility(depth, light, x, y + 1, z) * (1.0 - s)
            high += texel_visibility(depth, light, x + 1, y + 1, z) * s
            visible += low * (1.0 - t) + high * t
            count += 1.0
    return visible / ti.max(count, 1.0)


@ti.func
def dome_visibility(p, n, frames: ti.template(), key_count, depth: ti.template(), radius):
    """Cosine-weighted visible fraction of the dome at p with normal n.

    A direction stands for those up to its neighbors, which an edge at a distance hides one after
    another: its shadow map, of depth (L - key_count, S, S), is looked up at TAPS places around p on
    the plane through p.
    """
    size = depth.shape[1]
    texel = 2.0 * radius / size
    visible, count = 0.0, 0.0
    biased = p + 1.6 * texel * n
    for light in range(key_count, frames.shape[0]):
        normal = in_light_axes(frames, light, n)
        cosine = normal[2]
        if cosine > 0.0:
            q = to_shadow_map(frames, light, biased, radius, size)
            slope = texel / ti.max(cosine, STEEPEST)  # depth of the plane per texel
            weight = cosine * frames[light, 9]
            if not in_map(q, size, FARTHEST_TAP):
                visible, count = visible + weight, count + weight
                continue
            seen = 0.0
            for a, b in ti.static(TAPS):
                x, y = ti.cast(ti.floor(q[0] + a), ti.i32), ti.cast(ti.floor(q[1] + b), ti.i32)
                z = q[2] - 0.8 * texel + ti.min(slope * (a * normal[0] + b * normal[1]), 0.0)
                seen += texel_visibility(depth, light - key_count, x, y, z)
            visible += weight * seen / ti.static(len(TAPS))
            count += weight
    return visible / ti.max(count, 1e-6)


@ti.func
def floor_point(uniforms: ti.template(), x, y, size):
    """The point of the floor at texel (x, y) of its light map: MAP_O + a MAP_X + b MAP_Y."""
    a, b = (2.0 * x + 1.0) / size - 1.0, (2.0 * y + 1.0) / size - 1.0
    offset = a * vector_at(uniforms, MAP_X) + b * vector_at(uniforms, MAP_Y)
    return vector_at(uniforms, MAP_O) + uniforms[MAP_HALF] * offset


@ti.kernel
def shade_floor(
    uniforms: F32_1,
    frames: F32_2,
    key_count: ti.i32,
    key_depth: F32_3,
    dome_depth: F32_3,
    key: F32_2,
    dome: F32_2,
):
    """Visibility of the key light (G, G) and the dome (D, D) over the floor's light map."""
    for y, x in ti.ndrange(key.shape[0], key.shape[0]):
        p = floor_point(uniforms, x, y, key.shape[0])
        key[y, x] = key_visibility(
            p, vector_at(uniforms, UP), frames, key_count, key_depth, uniforms[RADIUS]
        )
    for y, x in ti.ndrange(dome.shape[0], dome.shape[0]):
        p = floor_point(uniforms, x, y, dome.shape[0])
        dome[y, x] = dome_visibility(
            p, vector_at(uniforms, UP), frames, key_count, dome_depth, uniforms[RADIUS]
        )


@ti.kernel
def shade_points(
    uniforms: F32_1,
    frames: F32_2,
    key_count: ti.i32,
    key_depth: F32_3,
    dome_depth: F32_3,
    floor: F32_3,
    points: F32_2,
    normals: F32_2,
    out: F32_2,
):
    """Irradiance / pi, out (N, 3), at points (N, 3) with normals (N, 3)."""
    for i in range(points.shape[0]):
        p, n = row(points, i), row(normals, i)
        key = key_visibility(p, n, frames, key_count, key_depth, uniforms[RADIUS])
        dome = dome_visibility(p, n, frames, key_count, dome_depth, uniforms[RADIUS])
        light = diffuse(uniforms, floor, p, n, key, dome)
        for k in ti.static(range(3)):
            out[i, k] = light[k]


@ti.func
def floor_light(uniforms: ti.template(), floor: ti.template(), p):
    """Visibility of key and dome at the floor below p, bilinear; 1 outside the light map."""
    size = floor.shape[0]
    q = p - vector_at(uniforms, MAP_O)
    a = (q.dot(vector_at(uniforms, MAP_X)) / uniforms[MAP_HALF] + 1.0) * 0.5 * size - 0.5
    b = (q.dot(vector_at(uniforms, MAP_Y)) / uniforms[MAP_HALF] + 1.0) * 0.5 * size - 0.5
    key, dome = 1.0, 1.0
    if 0.0 <= a < size - 1.0 and 0.0 <= b < size - 1.0:
        x, y = ti.cast(a, ti.i32), ti.cast(b, ti.i32)
        s, t = a - x, b - y
        k = vec2(0.0, 0.0)
        for c in ti.static(range(2)):
            low = floor[y, x, c] * (1.0 - s) + floor[y, x + 1, c] * s
            high = floor[y + 1, x, c] * (1.0 - s) + floor[y + 1, x + 1, c] * s
            k[c] = low * (1.0 - t) + high * t
        # fades to 1 near the border, so that the light map has no visible edge
        border_distance = ti.max(ti.abs(2.0 * a / size - 1.0), ti.abs(2.0 * b / size - 1.0))
        fade = 1.0 - smoothstep(0.8, 0.98, border_distance)
        key, dome = 1.0 - fade * (1.0 - k[0]), 1.0 - fade * (1.0 - k[1])
    return key, dome


@ti.func
def floor_factor(uniforms: ti.template(), floor: ti.template(), p):
    """Irradiance of the floor below p, relative to that of the unoccluded floor."""
    key, dome = floor_light(uniforms, floor, p)
    up = vector_at(uniforms, UP)
    key_light = vector_at(uniforms, KEY) * ti.max(0.0, up.dot(vector_at(uniforms, KEY_DIR)))
    sky = vector_at(uniforms, SKY)
    return (key_light * key + sky * dome) / ti.max(key_light + sky, 1e-6)


@ti.func
def diffuse(uniforms: ti.template(), floor: ti.template(), p, n, key, dome):
    """Irradiance / pi at p with normal n, for visibilities key and dome."""
    up = vector_at(uniforms, UP)
    t = 0.5 + 0.5 * n.dot(up)
    bounce = vector_at(uniforms, BOUNCE) * floor_factor(uniforms, floor, p)
    key_light = vector_at(uniforms, KEY) * (ti.max(0.0, n.dot(vector_at(uniforms, KEY_DIR))) * key)
    fill = vector_at(uniforms, FILL) * (ti.max(0.0, n.dot(vector_at(uniforms, FILL_DIR))) * dome)
    return (vector_at(uniforms, SKY) * t + bounce * (1.0 - t)) * dome + key_light + fill


@ti.func
def ggx_specular(n, v, light, rough, spread):
    """pi D V n.l of GGX, without Fresnel; the light's angular size `spread` widens the lobe."""
    h = (v + light).normalized()
    nl, nv, nh = ti.max(0.0, n.dot(light)), ti.max(1e-3, n.dot(v)), ti.max(0.0, n.dot(h))
    alpha = ti.max(0.02, rough * rough)
    alpha_light = ti.min(1.0, alpha + 0.5 * spread)
    d = nh * nh * (alpha_light * alpha_light - 1.0) + 1.0
    k = 0.5 * alpha
    smith = 0.25 / ((nl * (1.0 - k) + k) * (nv * (1.0 - k) + k))
    return alpha_light * alpha_light / (d * d) * smith * nl


@ti.func
def reflected_radiance(
    uniforms: ti.template(), floor: ti.template(), p, n, v, albedo, rough, metal, key, dome
):
    """Radiance reflected towards v (unit): the equation of this module, F by Schlick."""
    f0 = 0.04 + (albedo - 0.04) * metal
    nv = ti.max(0.0, n.dot(v))
    schlick = (1.0 - nv) ** 5
    fresnel = f0 + (ti.max(vec3(1.0 - rough), f0) - f0) * schlick
    r = 2.0 * n.dot(v) * n - v
    t = smoothstep(-0.6 * (0.3 + rough), 0.6 * (0.3 + rough), r.dot(vector_at(uniforms, UP)))
    bounce = vector_at(uniforms, BOUNCE) * floor_factor(uniforms, floor, p)
    mirror = bounce + (1.6 * vector_at(uniforms, SKY) - bounce) * t
    key_dir, fill_dir = vector_at(uniforms, KEY_DIR), vector_at(uniforms, FILL_DIR)
    specular = vector_at(uniforms, KEY) * (
        key * ggx_specular(n, v, key_dir, rough, uniforms[KEY_SPREAD])
    )
    specular += vector_at(uniforms, FILL) * (
        dome * ggx_specular(n, v, fill_dir, rough, uniforms[KEY_SPREAD])
    )
    return (
        albedo * (1.0 - metal) * diffuse(uniforms, floor, p, n, key, dome)
        + fresnel * mirror * dome * (1.0 - 0.5 * rough)
        + f0 * specular
    )
