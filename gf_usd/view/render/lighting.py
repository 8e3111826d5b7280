# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false
"""Light inside kernels: what a point sees of the key and the dome, and what it makes of it.

Diffuse and specular light of a key k, a fill f and a dome, with albedo a, normal n, view v:
    a (1 - metal) (sky(n) o + L_k max(0, n.k) s + L_f max(0, n.f) o)
  + GGX(n, v, k) L_k s + GGX(n, v, f) L_f o + F(n.v) sky(r) o
where s is the part of the key's disc that is seen and o the cosine-weighted part of the dome.
"""

from gf_usd.system.taichi_runtime import import_taichi
from gf_usd.view.render.raster import F32_1, F32_2, F32_3, part, row, to_map, vec2, vec3

ti = import_taichi()

# slots of the uniforms array, three numbers each, then single ones (filled in surfaces.py)
UP, KEY_DIR, KEY, FILL_DIR, FILL, SKY, BOUNCE, CENTER, EDGE = (3 * i for i in range(9))
MAP_X, MAP_Y, MAP_O, RADIUS, FLOOR, MAP_HALF, KEY_SPREAD = 27, 30, 33, 36, 37, 38, 39
UNIFORM_COUNT = 40


@ti.func
def smooth(low, high, x):
    """0 below low, 1 above high, a cubic between."""
    t = ti.min(1.0, ti.max(0.0, (x - low) / (high - low)))
    return t * t * (3.0 - 2.0 * t)


@ti.func
def texel_seen(depth: ti.template(), light, x, y, z):
    """1 where nothing in that texel of a light's map is nearer to the light than z, else 0."""
    size = depth.shape[1]
    seen = 1.0
    if 0 <= x < size and 0 <= y < size and depth[light, y, x] < z:
        seen = 0.0
    return seen


@ti.func
def key_seen(p, n, frames: ti.template(), keys, depth: ti.template(), radius):
    """Part of the key's disc that p (normal n) sees, each map read bilinearly."""
    size = depth.shape[1]
    texel = 2.0 * radius / size
    seen, count = 0.0, 0.0
    lifted = p + 1.6 * texel * n
    for light in range(keys):
        cosine = frames[light, 6] * n[0] + frames[light, 7] * n[1] + frames[light, 8] * n[2]
        if cosine > 0.0:
            q = to_map(frames, light, lifted, radius, size)
            z = q[2] - 0.8 * texel
            fx, fy = ti.floor(q[0] - 0.5), ti.floor(q[1] - 0.5)
            s, t = q[0] - 0.5 - fx, q[1] - 0.5 - fy
            x, y = ti.cast(fx, ti.i32), ti.cast(fy, ti.i32)
            low = texel_seen(depth, light, x, y, z) * (1.0 - s)
            low += texel_seen(depth, light, x + 1, y, z) * s
            high = texel_seen(depth, light, x, y + 1, z) * (1.0 - s)
            high += texel_seen(depth, light, x + 1, y + 1, z) * s
            seen += low * (1.0 - t) + high * t
            count += 1.0
    return seen / ti.max(count, 1.0)


@ti.func
def dome_seen(p, n, frames: ti.template(), keys, depth: ti.template(), radius):
    """Cosine-weighted part of the dome that p (normal n) sees.

    Its maps, (L - keys, S, S) depth, are too many and too faint to need more than a nearest texel.
    """
    size = depth.shape[1]
    texel = 2.0 * radius / size
    seen, count = 0.0, 0.0
    lifted = p + 1.6 * texel * n
    for light in range(keys, frames.shape[0]):
        cosine = frames[light, 6] * n[0] + frames[light, 7] * n[1] + frames[light, 8] * n[2]
        if cosine > 0.0:
            q = to_map(frames, light, lifted, radius, size)
            x, y = ti.cast(ti.floor(q[0]), ti.i32), ti.cast(ti.floor(q[1]), ti.i32)
            weight = cosine * frames[light, 9]
            seen += weight * texel_seen(depth, light - keys, x, y, q[2] - 0.8 * texel)
            count += weight
    return seen / ti.max(count, 1e-6)


@ti.func
def on_floor(uniforms: ti.template(), x, y, size):
    """The point of the floor at texel (x, y) of its map (MAP_O + a MAP_X + b MAP_Y)."""
    a, b = (2.0 * x + 1.0) / size - 1.0, (2.0 * y + 1.0) / size - 1.0
    away = a * part(uniforms, MAP_X) + b * part(uniforms, MAP_Y)
    return part(uniforms, MAP_O) + uniforms[MAP_HALF] * away


@ti.kernel
def shade_floor(
    uniforms: F32_1,
    frames: F32_2,
    keys: ti.i32,
    key_depth: F32_3,
    dome_depth: F32_3,
    key: F32_2,
    dome: F32_2,
):
    """key (G, G) and dome (D, D): the parts of them that the floor sees, over its map."""
    for y, x in ti.ndrange(key.shape[0], key.shape[0]):
        p = on_floor(uniforms, x, y, key.shape[0])
        key[y, x] = key_seen(p, part(uniforms, UP), frames, keys, key_depth, uniforms[RADIUS])
    for y, x in ti.ndrange(dome.shape[0], dome.shape[0]):
        p = on_floor(uniforms, x, y, dome.shape[0])
        dome[y, x] = dome_seen(p, part(uniforms, UP), frames, keys, dome_depth, uniforms[RADIUS])


@ti.kernel
def shade_points(
    uniforms: F32_1,
    frames: F32_2,
    keys: ti.i32,
    key_depth: F32_3,
    dome_depth: F32_3,
    floor: F32_3,
    points: F32_2,
    normals: F32_2,
    out: F32_2,
):
    """out (N, 3): diffuse light / pi at points with normals, to multiply an albedo."""
    for i in range(points.shape[0]):
        p, n = row(points, i), row(normals, i)
        key = key_seen(p, n, frames, keys, key_depth, uniforms[RADIUS])
        dome = dome_seen(p, n, frames, keys, dome_depth, uniforms[RADIUS])
        light = diffuse(uniforms, floor, p, n, key, dome)
        for k in ti.static(range(3)):
            out[i, k] = light[k]


@ti.func
def floor_light(uniforms: ti.template(), floor: ti.template(), p):
    """Key and dome at the floor below p, bilinear; 1 beyond the map."""
    size = floor.shape[0]
    q = p - part(uniforms, MAP_O)
    a = (q.dot(part(uniforms, MAP_X)) / uniforms[MAP_HALF] + 1.0) * 0.5 * size - 0.5
    b = (q.dot(part(uniforms, MAP_Y)) / uniforms[MAP_HALF] + 1.0) * 0.5 * size - 0.5
    key, dome = 1.0, 1.0
    if 0.0 <= a < size - 1.0 and 0.0 <= b < size - 1.0:
        x, y = ti.cast(a, ti.i32), ti.cast(b, ti.i32)
        s, t = a - x, b - y
        k = vec2(0.0, 0.0)
        for c in ti.static(range(2)):
            low = floor[y, x, c] * (1.0 - s) + floor[y, x + 1, c] * s
            high = floor[y + 1, x, c] * (1.0 - s) + floor[y + 1, x + 1, c] * s
            k[c] = low * (1.0 - t) + high * t
        # the last tenth fades out, so that the map has no edge
        rim = ti.max(ti.abs(2.0 * a / size - 1.0), ti.abs(2.0 * b / size - 1.0))
        fade = 1.0 - smooth(0.8, 0.98, rim)
        key, dome = 1.0 - fade * (1.0 - k[0]), 1.0 - fade * (1.0 - k[1])
    return key, dome


@ti.func
def floor_factor(uniforms: ti.template(), floor: ti.template(), p):
    """Light on the floor below p relative to the bare floor."""
    key, dome = floor_light(uniforms, floor, p)
    up = part(uniforms, UP)
    sun = part(uniforms, KEY) * ti.max(0.0, up.dot(part(uniforms, KEY_DIR)))
    sky = part(uniforms, SKY)
    return (sun * key + sky * dome) / ti.max(sun + sky, 1e-6)


@ti.func
def diffuse(uniforms: ti.template(), floor: ti.template(), p, n, key, dome):
    """Irradiance / pi at p with normal n that sees those parts of key and dome."""
    up = part(uniforms, UP)
    t = 0.5 + 0.5 * n.dot(up)
    bounce = part(uniforms, BOUNCE) * floor_factor(uniforms, floor, p)
    sun = part(uniforms, KEY) * (ti.max(0.0, n.dot(part(uniforms, KEY_DIR))) * key)
    fill = part(uniforms, FILL) * (ti.max(0.0, n.dot(part(uniforms, FILL_DIR))) * dome)
    return (part(uniforms, SKY) * t + bounce * (1.0 - t)) * dome + sun + fill


@ti.func
def highlight(n, v, light, rough, spread):
    """pi D V n.l of GGX, for a light whose disc widens the lobe; times radiance and Fresnel."""
    h = (v + light).normalized()
    nl, nv, nh = ti.max(0.0, n.dot(light)), ti.max(1e-3, n.dot(v)), ti.max(0.0, n.dot(h))
    alpha = ti.max(0.02, rough * rough)
    wide = ti.min(1.0, alpha + 0.5 * spread)
    d = nh * nh * (wide * wide - 1.0) + 1.0
    k = 0.5 * alpha
    smith = 0.25 / ((nl * (1.0 - k) + k) * (nv * (1.0 - k) + k))
    return wide * wide / (d * d) * smith * nl


@ti.func
def lit(uniforms: ti.template(), floor: ti.template(), p, n, v, albedo, rough, metal, key, dome):
    """Radiance towards v (unit)."""
    base = 0.04 + (albedo - 0.04) * metal
    nv = ti.max(0.0, n.dot(v))
    grazing = (1.0 - nv) ** 5
    fresnel = base + (ti.max(vec3(1.0 - rough), base) - base) * grazing
    r = 2.0 * n.dot(v) * n - v
    t = smooth(-0.6 * (0.3 + rough), 0.6 * (0.3 + rough), r.dot(part(uniforms, UP)))
    bounce = part(uniforms, BOUNCE) * floor_factor(uniforms, floor, p)
    mirror = bounce + (1.6 * part(uniforms, SKY) - bounce) * t
    key_dir, fill_dir = part(uniforms, KEY_DIR), part(uniforms, FILL_DIR)
    shine = part(uniforms, KEY) * (key * highlight(n, v, key_dir, rough, uniforms[KEY_SPREAD]))
    shine += part(uniforms, FILL) * (dome * highlight(n, v, fill_dir, rough, uniforms[KEY_SPREAD]))
    return (
        albedo * (1.0 - metal) * diffuse(uniforms, floor, p, n, key, dome)
        + fresnel * mirror * dome * (1.0 - 0.5 * rough)
        + base * shine
    )
