// The same surface with fewer triangles, and triangles in an order that graphics processors like. No drawing library.
//
// A processor that draws takes the time of a figure of 60,000 triangles mostly for triangles smaller than a pixel, so
// while it plays, points within a cell of about a pixel are drawn as one: vertex clustering after Rossignac and Borrel,
// "Multi-resolution 3D approximations for rendering complex scenes", 1993. The order is after Sander, Nehab and
// Barczak, "Fast triangle reordering for vertex locality and reduced overdraw", 2007.

const CACHE = 24; // transformed vertices that are surely still there
const FAR = 4; // cells: how far on a picture corners may be moved when points are joined
const SIDE = 8192; // cells a side at most: keys of three are whole numbers that a double holds

/**
 * {source, triangles, groups} of the surface with one drawn vertex for each part and occupied cell of `cell` metres at
 * rest, or null when that is too fine to be of use.
 *
 * rest (V*3), triangles (T*3) into V, groups [{start, stop}] in triangles, kind (V) below 256: only vertices of one kind
 * are joined. The vertex drawn is the one of V nearest to the
 * mean of its cell's, so that it deforms exactly as that one; `source` says which. Triangles that collapse or repeat go;
 * `corners` says which corner of `triangles` each that is left was.
 */
export function coarser(rest, triangles, groups, cell, kind) {
  const low = [0, 0, 0].map((_, c) => extreme(rest, c, Math.min)), high = [0, 0, 0].map((_, c) => extreme(rest, c, Math.max));
  if (!low.every((x, c) => (high[c] - x) / cell < SIDE - 1)) return null;
  const V = rest.length / 3, of = new Int32Array(V), touched = new Int32Array(V).fill(-1);
  const out = [], corners = [], bounds = [], source = [];
  groups.forEach(({ start, stop }, g) => {
    const ids = new Map(), cells = [], points = [], first = source.length;
    for (let k = 3 * start; k < 3 * stop; k++) {
      const v = triangles[k];
      if (touched[v] === g) continue;
      touched[v] = g;
      points.push(v);
      const x = rest[3 * v], y = rest[3 * v + 1], z = rest[3 * v + 2];
      const at = (Math.floor((x - low[0]) / cell) * SIDE + Math.floor((y - low[1]) / cell)) * SIDE + Math.floor((z - low[2]) / cell);
      const key = 256 * at + kind[v];
      let id = ids.get(key);
      if (id === undefined) { ids.set(key, (id = cells.length)); cells.push({ n: 0, x: 0, y: 0, z: 0, best: Infinity }); }
      const c = cells[id];
      c.n++; c.x += x; c.y += y; c.z += z;
      of[v] = id;
    }
    for (const v of points) {
      const c = cells[of[v]], x = rest[3 * v] - c.x / c.n, y = rest[3 * v + 1] - c.y / c.n, z = rest[3 * v + 2] - c.z / c.n;
      const d = x * x + y * y + z * z;
      if (d < c.best) { c.best = d; source[first + of[v]] = v; }
    }
    const seen = new Set(), from = out.length / 3, n = cells.length;
    for (let k = 3 * start; k < 3 * stop; k += 3) {
      let a = of[triangles[k]], b = of[triangles[k + 1]], c = of[triangles[k + 2]];
      if (a === b || b === c || c === a) continue;
      let turn = 0;
      if (b < a && b < c) { [a, b, c] = [b, c, a]; turn = 1; } // the smallest first, the same side up
      else if (c < a && c < b) { [a, b, c] = [c, a, b]; turn = 2; }
      const key = (a * n + b) * n + c;
      if (seen.has(key)) continue;
      seen.add(key);
      out.push(first + a, first + b, first + c);
      corners.push(k + turn, k + ((turn + 1) % 3), k + ((turn + 2) % 3));
    }
    bounds.push({ start: from, stop: out.length / 3 });
  });
  return { source: Uint32Array.from(source), triangles: Uint32Array.from(out), groups: bounds, corners: Uint32Array.from(corners) };
}

function extreme(points, c, choose) {
  let out = points[c];
  for (let i = c; i < points.length; i += 3) out = choose(out, points[i]);
  return out;
}

/**
 * {source, triangles}: `triangles` (T*3) reordered within each group so that vertices are reused soon, and vertices
 * renumbered by first use; vertex i is what `source[i]` was. The same surface: only the order changes.
 */
export function ordered(triangles, groups, V) {
  const out = new Uint32Array(triangles.length), counts = new Uint32Array(V + 1), corners = new Uint32Array(triangles.length);
  const live = new Int32Array(V), stamp = new Int32Array(V), done = new Uint8Array(triangles.length / 3);
  for (const { start, stop } of groups) {
    counts.fill(0);
    for (let k = 3 * start; k < 3 * stop; k++) counts[triangles[k] + 1]++;
    for (let v = 0; v < V; v++) { live[v] = counts[v + 1]; counts[v + 1] += counts[v]; }
    const at = counts.slice();
    for (let k = 3 * start; k < 3 * stop; k++) corners[at[triangles[k]]++] = (k / 3) | 0;
    stamp.fill(-CACHE);
    const stack = [];
    let time = 0, to = 3 * start, cursor = 3 * start, fan = start < stop ? triangles[3 * start] : -1;
    while (fan >= 0) {
      const near = [];
      for (let c = counts[fan]; c < counts[fan + 1]; c++) {
        const t = corners[c];
        if (done[t]) continue;
        done[t] = 1;
        for (let k = 3 * t; k < 3 * t + 3; k++) {
          const v = triangles[k];
          out[to++] = v;
          stack.push(v);
          near.push(v);
          live[v]--;
          if (time - stamp[v] >= CACHE) stamp[v] = time++;
        }
      }
      let best = -1;
      fan = -1;
      for (const v of near) { // the one that has been there longest and will still be there when its fan is done
        if (live[v] <= 0) continue;
        const age = time - stamp[v], rank = age + 2 * live[v] <= CACHE ? age : 0;
        if (rank > best) { best = rank; fan = v; }
      }
      while (fan < 0 && stack.length) { const v = stack.pop(); if (live[v] > 0) fan = v; }
      while (fan < 0 && cursor < 3 * stop) { const v = triangles[cursor++]; if (live[v] > 0) fan = v; }
    }
  }
  const number = new Int32Array(V).fill(-1), source = new Uint32Array(V);
  let next = 0;
  for (let k = 0; k < out.length; k++) {
    const v = out[k];
    if (number[v] < 0) { number[v] = next; source[next++] = v; }
    out[k] = number[v];
  }
  for (let v = 0; v < V; v++) if (number[v] < 0) source[next++] = v;
  return { source, triangles: out };
}

/**
 * A coarser surface `made` by `coarser`, {source, triangles, groups, uv}: its points split where the picture needs it.
 * `corners` (T'*3) of `made`: the corner of `triangles` (T*3) that each corner was; `source`, `uv` (N*2), `rest` of the
 * whole surface. A corner takes the coordinates of the point that it moved to, or keeps its own when those lie
 * elsewhere on the picture, as across a seam.
 */
export function mapped(made, { source, triangles, uv, rest }, cell) {
  const first = new Map(), ids = new Map(), out = { source: [], triangles: new Uint32Array(made.triangles.length), groups: made.groups, uv: [] };
  for (let i = source.length - 1; i >= 0; i--) first.set(source[i], i); // copies of a point follow one another
  for (let k = 0; k < made.triangles.length; k++) {
    const id = made.triangles[k], own = triangles[made.corners[k]], reach = FAR * cell * stretch(triangles, uv, rest, source, 3 * ((made.corners[k] / 3) | 0));
    let best = own, least = reach;
    for (let i = first.get(made.source[id]); i < source.length && source[i] === made.source[id]; i++) {
      const away = Math.hypot(uv[2 * i] - uv[2 * own], uv[2 * i + 1] - uv[2 * own + 1]);
      if (away <= least) { least = away; best = i; }
    }
    const key = id * source.length + best;
    if (!ids.has(key)) { ids.set(key, out.source.length); out.source.push(made.source[id]); out.uv.push(uv[2 * best], uv[2 * best + 1]); }
    out.triangles[k] = ids.get(key);
  }
  return { ...out, source: Uint32Array.from(out.source), uv: Float32Array.from(out.uv) };
}

/** How far the picture goes per metre of the triangle at corner k. */
function stretch(triangles, uv, rest, source, k) {
  let most = 0, edge = 1e-9;
  for (let i = 0; i < 3; i++) {
    const a = triangles[k + i], b = triangles[k + ((i + 1) % 3)], p = 3 * source[a], q = 3 * source[b];
    most = Math.max(most, Math.hypot(uv[2 * a] - uv[2 * b], uv[2 * a + 1] - uv[2 * b + 1]));
    edge = Math.max(edge, Math.hypot(rest[p] - rest[q], rest[p + 1] - rest[q + 1], rest[p + 2] - rest[q + 2]));
  }
  return most / edge;
}
