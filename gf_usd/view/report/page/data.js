// Arrays out of the page: the other side of gf_usd/view/report_pack.py.

const TYPES = {
  uint8: Uint8Array, int8: Int8Array, uint16: Uint16Array, uint32: Uint32Array,
};

async function inflate(base64) {
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

// One array of the blob: byte planes are joined, and a moving array is summed up over its frames.
function unpack(entry, bytes) {
  const Type = TYPES[entry.type];
  const width = Type.BYTES_PER_ELEMENT;
  const count = entry.shape.reduce((a, b) => a * b, 1);
  const joined = new Uint8Array(count * width);
  for (let plane = 0; plane < width; plane++) {
    const start = entry.offset + plane * count;
    for (let i = 0; i < count; i++) joined[i * width + plane] = bytes[start + i];
  }
  const values = new Type(joined.buffer);
  const row = entry.shape[0] ? count / entry.shape[0] : 0;
  if (entry.moving) for (let i = row; i < count; i++) values[i] += values[i - row];
  return { ...entry, values, row, at: (frame) => values.subarray(frame * row, (frame + 1) * row) };
}

// All arrays of a variant, unpacked once.
async function loadVariant(variant, number) {
  if (!variant.arrays) {
    const bytes = await inflate(document.getElementById(`motion-${number}`).textContent);
    variant.arrays = {};
    for (const [name, entry] of Object.entries(variant.table)) variant.arrays[name] = unpack(entry, bytes);
  }
  return variant.arrays;
}

// Whether there is a mesh, or a surface of what flows.
function hasSurface(arrays) {
  return arrays.points.row > 0 || Boolean(arrays.flowStarts);
}

// Color maps as stops from low to high, sRGB 0..255: the shaders and the legend share them.
const MAPS = {
  diverging: [[37, 78, 166], [86, 143, 214], [178, 207, 232], [238, 236, 230],
    [244, 190, 150], [221, 107, 77], [163, 24, 45]],
  sequential: [[48, 38, 92], [58, 82, 139], [33, 124, 141], [45, 164, 122],
    [122, 197, 84], [206, 220, 62], [253, 231, 90]],
};

// What a bake may have written of its Gaussians: name and unit.
const MEASURED = {
  elastic: ["elastic strain of the Gaussians", ""],
  plastic: ["plastic strain of the Gaussians", ""],
  stress: ["von Mises stress of the Gaussians", " Pa"],
};

// The values 0..255 that color vertices or Gaussians in a mode; null where there are none.
function scalars(variant, mode, kind, frame) {
  const a = variant.arrays;
  if (mode === "strain") return a[kind === "mesh" ? "stretch" : "ratio"]?.at(frame) ?? null;
  if (MEASURED[mode]) return kind === "mesh" ? null : a[mode]?.at(frame) ?? null;
  if (mode !== "speed") return null;
  const places = a[kind === "mesh" ? "points" : "positions"];
  if (!places) return null;
  const [before, after] = [Math.max(0, frame - 1), Math.min(variant.seconds.length - 1, frame + 1)];
  const time = variant.seconds[after] - variant.seconds[before] || 1;
  const [p, q, step] = [places.at(before), places.at(after), places.step];
  const out = new Uint8Array(places.row / 3);
  for (let i = 0; i < out.length; i++) {
    const d = Math.hypot((q[3 * i] - p[3 * i]) * step[0], (q[3 * i + 1] - p[3 * i + 1]) * step[1],
      (q[3 * i + 2] - p[3 * i + 2]) * step[2]);
    out[i] = Math.min(255, (255 * d) / time / variant.topSpeed);
  }
  return out;
}

// The fastest that a mode of color shows: of 200 points, so that one stray does not set it.
function topSpeed(variant) {
  const places = variant.arrays.points?.row ? variant.arrays.points : variant.arrays.positions;
  if (!places?.row) return 1;
  const count = places.row / 3;
  const stride = Math.max(1, Math.floor(count / 200));
  let top = 0;
  for (let f = 1; f < variant.seconds.length; f++) {
    const [p, q] = [places.at(f - 1), places.at(f)];
    for (let i = 0; i < count; i += stride) {
      const d = Math.hypot((q[3 * i] - p[3 * i]) * places.step[0],
        (q[3 * i + 1] - p[3 * i + 1]) * places.step[1],
        (q[3 * i + 2] - p[3 * i + 2]) * places.step[2]);
      top = Math.max(top, d / (variant.seconds[f] - variant.seconds[f - 1]));
    }
  }
  return top || 1;
}

// How far from 1 the strain colors reach, in octaves: of what is shown.
function strainReach(variant, show) {
  const names = { mesh: ["stretch"], gaussians: ["ratio"] }[show] ?? ["stretch", "ratio"];
  return Math.max(...names.map((name) => variant.arrays[name]?.reach ?? 0)) || 1;
}
