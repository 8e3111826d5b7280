# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false
"""Shading: the color of each pixel is the mean radiance of its samples in the z-buffer.

The floor is the backdrop, darkened where it is in shadow: there is no horizon.
"""

from gf_usd.system.taichi_runtime import import_taichi
from gf_usd.view.render.lighting import (
    CENTER,
    EDGE,
    FLOOR,
    RADIUS,
    UP,
    dome_visibility,
    floor_factor,
    key_visibility,
    reflected_radiance,
    smoothstep,
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
    camera_ray,
    dvec3,
    edge_functions,
    intersect_ellipsoid,
    row,
    sample_position,
    to_f32,
    to_f64,
    vec2,
    vec3,
    vector_at,
)
from gf_usd.view.render.textures import sample_texture

ti = import_taichi()


SAME_NORMAL = 0.99  # cosine: samples of one pixel and one surface that share their visibility
MAX_RADIANCE = 4.0  # clamp of a sample, so that edges of highlights remain antialiased


@ti.func
def interpolate_corners(a: ti.template(), t, b):
    """Corner vectors a (T, 9) of triangle t at barycentric coordinates b."""
    out = vec3(0.0)
    for c in ti.static(range(3)):
        for k in ti.static(range(3)):
            out[k] += b[c] * a[t, 3 * c + k]
    return out


@ti.func
def barycentric(clip: ti.template(), tri: ti.template(), t, x, y):
    """Perspective-correct barycentric coordinates of triangle t at sample position (x, y)."""
    e0, e1, e2, _ = edge_functions(clip, tri, t)
    r = dvec3(x, y, 1.0)
    b = dvec3(r.dot(e0), r.dot(e1), r.dot(e2))
    return to_f32(b / (b[0] + b[1] + b[2]))


@ti.func
def interpolate_uv(uvs: ti.template(), t, b):
    """Texture coordinates uvs (T, 6) of triangle t at barycentric coordinates b."""
    return vec2(
        b[0] * uvs[t, 0] + b[1] * uvs[t, 2] + b[2] * uvs[t, 4],
        b[0] * uvs[t, 1] + b[1] * uvs[t, 3] + b[2] * uvs[t, 5],
    )


@ti.func
def backdrop(uniforms: ti.template(), x, y):
    """The backdrop: bright in the middle, darker at the corners; x, y in -1..1."""
    t = smoothstep(0.15, 1.55, ti.sqrt(x * x + (y - 0.12) * (y - 0.12)))
    return vector_at(uniforms, CENTER) * (1.0 - t) + vector_at(uniforms, EDGE) * t


@ti.func
def face_viewer(normal, face_normal, v):
    """The shading normal, flipped to the visible side of the face and bent to n.v >= 0.02."""
    n = normal
    if normal.dot(face_normal) * face_normal.dot(v) < 0.0:
        n = -1.0 * normal
    cosine = n.dot(v)
    if cosine < 0.02:
        n += (0.02 - cosine) * v
    return n.normalized()


@ti.func
def backdrop_color(uniforms: ti.template(), floor: ti.template(), camera: ti.template(), d, a, b):
    """The color where nothing is hit: backdrop with shadows on the floor; d : of the camera ray.

    a, b : position in the image, in -1..1.
    """
    color = backdrop(uniforms, a, b)
    up = to_f64(vector_at(uniforms, UP))
    height = vector_at(camera, 0).dot(up) - uniforms[FLOOR]
    descent = -d.dot(up)
    if height > 0.0 and descent > 1e-6 * d.norm():
        p = to_f32(vector_at(camera, 0) + height / descent * d)
        color *= floor_factor(uniforms, floor, p)
    return color


@ti.func
def triangle_point(
    clip: ti.template(),
    tri: ti.template(),
    points: ti.template(),
    normals: ti.template(),
    t,
    x,
    y,
    v,
):
    """Position and shading normal of triangle t at sample position (x, y); v : to the viewer."""
    w = barycentric(clip, tri, t, x, y)
    p0, p1 = row(points, tri[t, 0]), row(points, tri[t, 1])
    p2 = row(points, tri[t, 2])
    p = w[0] * p0 + w[1] * p1 + w[2] * p2
    n = face_viewer(interpolate_corners(normals, t, w), (p1 - p0).cross(p2 - p0), v)
    return p, n


@ti.func
def triangle_albedo(
    clip: ti.template(),
    tri: ti.template(),
    colors: ti.template(),
    uvs: ti.template(),
    texture_index: ti.template(),
    texels: ti.template(),
    levels: ti.template(),
    kinds: ti.template(),
    t,
    x,
    y,
):
    """Albedo of triangle t at sample position (x, y): of its texture, else of its corners."""
    w = barycentric(clip, tri, t, x, y)
    albedo = interpolate_corners(colors, t, w)
    if texture_index[t] >= 0:
        uv = interpolate_uv(uvs, t, w)
        du = interpolate_uv(uvs, t, barycentric(clip, tri, t, x + 1.0, y)) - uv
        dv = interpolate_uv(uvs, t, barycentric(clip, tri, t, x, y + 1.0)) - uv
        albedo = sample_texture(texels, levels, kinds, texture_index[t], uv, du, dv)
    return albedo


@ti.func
def ellipsoid_point(camera: ti.template(), center: ti.template(), inverse: ti.template(), i, d):
    """Position and normal of ellipsoid i where the camera ray of direction d hits it."""
    t, q = intersect_ellipsoid(camera, center, inverse, i, d)
    p = to_f32(vector_at(camera, 0) + t * d)
    n = vec3(0.0)
    # the gradient of |M (x - c)|^2 is M' q
    for k in ti.static(range(3)):
        for j in ti.static(range(3)):
            n[k] += inverse[i, 3 * j + k] * ti.cast(q[j], ti.f32)
    return p, n.normalized()


@ti.func
def is_empty(zbuffer: ti.template(), y, x, count):
    """Whether no sample of a pixel, count x count from (x, y), has a surface."""
    empty = True
    for s in range(count * count):
        if ti.cast(zbuffer[y + s // count, x + s % count] >> 32, ti.i32) != EMPTY_BITS:
            empty = False
    return empty


@ti.kernel
def shade(
    zbuffer: I64_2,
    oversampling: ti.i32,
    camera: F64_1,
    clip: F64_2,
    tri: I32_2,
    points: F32_2,
    normals: F32_2,
    colors: F32_2,
    uvs: F32_2,
    roughness_metallic: F32_2,
    texture_index: I32_1,
    texels: F32_2,
    levels: I32_2,
    kinds: I32_2,
    center: F32_2,
    inverse: F32_2,
    ellipsoid_colors: F32_2,
    uniforms: F32_1,
    frames: F32_2,
    key_count: ti.i32,
    key_depth: F32_3,
    dome_depth: F32_3,
    floor: F32_3,
    out: F32_3,
    depth: F32_2,
):
    """Resolve the z-buffer (H s, W s) into linear color out (H, W, 3) and depth (H, W).

    The depth of a pixel is that of its farthest sample, so that a pixel on a silhouette hides no
    splat behind it.

    Triangles have normals and colors (T, 9), uvs (T, 6), roughness_metallic (T, 2) and
    texture_index (T,), -1 for none; indices from T on are ellipsoids, of ellipsoid_colors (N, 3).
    """
    for py, px in ti.ndrange(out.shape[0], out.shape[1]):
        total = vec3(0.0)
        farthest = 0.0
        key_light, dome_light, shaded_id, shaded_normal = 0.0, 0.0, -1, vec3(0.0)
        samples, first = oversampling * oversampling, 0
        if is_empty(zbuffer, py * oversampling, px * oversampling, oversampling):
            # the backdrop is smooth within a pixel: its center is the mean of the samples
            sx, sy = (px + 0.5) * oversampling, (py + 0.5) * oversampling
            a = ti.cast(2.0 * sx / zbuffer.shape[1] - 1.0, ti.f32)
            b = ti.cast(1.0 - 2.0 * sy / zbuffer.shape[0], ti.f32)
            d = camera_ray(camera, ti.cast(sx, ti.f64), ti.cast(sy, ti.f64))
            color = backdrop_color(uniforms, floor, camera, d, a, b)
            total = ti.min(color, MAX_RADIANCE) * samples
            farthest, first = 3e38, samples
        for s in range(first, samples):
            y = py * oversampling + s // oversampling
            x = px * oversampling + s % oversampling
            sx, sy = sample_position(x, y, camera[16])
            d = camera_ray(camera, sx, sy)
            v = -1.0 * to_f32(d).normalized()
            color = vec3(0.0)
            depth_bits = ti.cast(zbuffer[y, x] >> 32, ti.i32)
            if depth_bits == EMPTY_BITS:
                farthest = 3e38
                a = ti.cast(2.0 * sx / zbuffer.shape[1] - 1.0, ti.f32)
                b = ti.cast(1.0 - 2.0 * sy / zbuffer.shape[0], ti.f32)
                color = backdrop_color(uniforms, floor, camera, d, a, b)
            else:
                item = ti.cast(zbuffer[y, x], ti.i32)
                farthest = ti.max(farthest, ti.bit_cast(depth_bits, ti.f32))
                p, n, albedo = vec3(0.0), vec3(0.0), vec3(0.0)
                rough, metal = 0.5, 0.0
                if item < tri.shape[0]:
                    p, n = triangle_point(clip, tri, points, normals, item, sx, sy, v)
                    albedo = triangle_albedo(
                        clip, tri, colors, uvs, texture_index, texels, levels, kinds, item, sx, sy
                    )
                    rough, metal = roughness_metallic[item, 0], roughness_metallic[item, 1]
                else:
                    i = item - tri.shape[0]
                    p, n = ellipsoid_point(camera, center, inverse, i, d)
                    albedo = row(ellipsoid_colors, i)
                # samples of one smooth surface in one pixel share their visibility: it is costly
                if shaded_id != item or n.dot(shaded_normal) < SAME_NORMAL:
                    key_light = key_visibility(p, n, frames, key_count, key_depth, uniforms[RADIUS])
                    dome_light = dome_visibility(
                        p, n, frames, key_count, dome_depth, uniforms[RADIUS]
                    )
                    shaded_id, shaded_normal = item, n
                color = reflected_radiance(
                    uniforms, floor, p, n, v, albedo, rough, metal, key_light, dome_light
                )
            total += ti.min(color, MAX_RADIANCE)
        for k in ti.static(range(3)):
            out[py, px, k] = total[k] / samples
        depth[py, px] = farthest
