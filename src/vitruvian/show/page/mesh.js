// Surfaces as arrays: what lies at one place, and normals. No drawing library here.

/** (V) for each point (V*3) the first point at its place; places are cells of `size`, or for 0 the same bits. */
export function welded(points, size) {
  const out = new Uint32Array(points.length / 3), first = new Map();
  for (let v = 0; v < out.length; v++) {
    const p = [points[3 * v], points[3 * v + 1], points[3 * v + 2]], key = (size ? p.map((x) => Math.round(x / size) + 0) : p).join();
    if (!first.has(key)) first.set(key, v);
    out[v] = first.get(key);
  }
  return out;
}

/** Area-weighted unit normals into `out` (V*3) of `points` (V*3) by welded `faces` (T*3); `same` (V) as of `welded`. */
export function meshNormals(points, faces, same, out) {
  out.fill(0);
  for (let k = 0; k < faces.length; k += 3) {
    const a = 3 * faces[k], b = 3 * faces[k + 1], c = 3 * faces[k + 2];
    const ux = points[b] - points[a], uy = points[b + 1] - points[a + 1], uz = points[b + 2] - points[a + 2];
    const vx = points[c] - points[a], vy = points[c + 1] - points[a + 1], vz = points[c + 2] - points[a + 2];
    const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
    out[a] += x; out[a + 1] += y; out[a + 2] += z;
    out[b] += x; out[b + 1] += y; out[b + 2] += z;
    out[c] += x; out[c + 1] += y; out[c + 2] += z;
  }
  for (let v = 0, i = 0; v < same.length; v++, i += 3) {
    if (same[v] !== v) { const f = 3 * same[v]; out[i] = out[f]; out[i + 1] = out[f + 1]; out[i + 2] = out[f + 2]; continue; } // the first is done
    const s = 1 / (Math.sqrt(out[i] * out[i] + out[i + 1] * out[i + 1] + out[i + 2] * out[i + 2]) || 1);
    out[i] *= s; out[i + 1] *= s; out[i + 2] *= s;
  }
}
