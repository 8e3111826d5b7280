# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false
"""Texture look-ups inside kernels: wrapping, bilinear, and the mean over a sample's footprint."""

from gf_usd.runtime import import_taichi
from gf_usd.view.raster import row, vec3
from gf_usd.view.texture import LEVELS

ti = import_taichi()


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
    """Texture k at one mip level, texel centres at halves."""
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
