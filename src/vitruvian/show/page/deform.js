// Skin deformation on typed arrays: the same formulas as vitruvian.deform, in the browser.
// No drawing library here, so that node can run it beside the kernels.
//
// Poses are (J,12) float32: row-major 3x4 matrices of M_j in humanoid space, p' = sum w_j M_j p.
// Sources: linear blending as ISO/IEC 19774 browsers do it; dual quaternions after Kavan et al. 2008;
// "log" is one Karcher step on SE(3) from the dual quaternion blend, "log-pair" one from the motion of the joint with the
// largest weight, "log-absolute" one from rest. operators.js has those that are made of these.

/** Operators that blend the motions of joints, each vertex for itself. */
export const BLENDS = ["linear", "dual-quaternion", "log", "log-pair", "log-absolute"];

/** Area-weighted unit vertex normals (V*3) of a mesh; zero where a vertex has no area. */
export function restNormals(rest, triangles) {
  const n = new Float32Array(rest.length);
  for (let k = 0; k < triangles.length; k += 3) {
    const a = 3 * triangles[k], b = 3 * triangles[k + 1], c = 3 * triangles[k + 2];
    const ux = rest[b] - rest[a], uy = rest[b + 1] - rest[a + 1], uz = rest[b + 2] - rest[a + 2];
    const vx = rest[c] - rest[a], vy = rest[c + 1] - rest[a + 1], vz = rest[c + 2] - rest[a + 2];
    const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
    for (const i of [a, b, c]) { n[i] += x; n[i + 1] += y; n[i + 2] += z; }
  }
  for (let i = 0; i < n.length; i += 3) {
    const s = 1 / (Math.hypot(n[i], n[i + 1], n[i + 2]) || 1);
    n[i] *= s; n[i + 1] *= s; n[i + 2] *= s;
  }
  return n;
}

/**
 * Prepare a skin for deforming.
 *
 * rest (V*3), weights as compressed rows (row V+1, joint, weight), triangles (T*3) into V, centers (J*3),
 * morphs [{index, offset, joint, before}]. Missing weight stays at rest: that is one more influence, the identity,
 * kept as joint J. Rows are sorted by falling weight, so that the pivot of a vertex is its first influence.
 */
export function bind({ rest, row, joint, weight, triangles, centers, morphs = [] }) {
  const V = rest.length / 3, J = centers.length / 3;
  const rows = new Uint32Array(V + 1), joints = [], weights = [], over = new Float32Array(V);
  for (let v = 0; v < V; v++) {
    const list = [];
    let sum = 0;
    for (let k = row[v]; k < row[v + 1]; k++) { list.push([joint[k], weight[k]]); sum += weight[k]; }
    if (Math.abs(1 - sum) > 1e-6) {
      if (sum < 1) list.push([J, 1 - sum]);
      else over[v] = 1 - sum; // more than one: linear takes the formula as written, the others normalise
    }
    list.sort((a, b) => b[1] - a[1] || a[0] - b[0]);
    for (const [j, w] of list) { joints.push(j); weights.push(w); }
    rows[v + 1] = joints.length;
  }
  return {
    V, J, rest: Float32Array.from(rest), centers, morphs, over,
    row: rows, joint: Uint16Array.from(joints), weight: Float32Array.from(weights),
    normals: restNormals(rest, triangles),
    moved: Float32Array.from(rest), // rest with displacers that act before skinning
    M: new Float32Array(12 * (J + 1)), dq: new Float32Array(8 * (J + 1)),
    stretch: new Float32Array(12 * (J + 1)), stretched: false,
  };
}

/** The same skin with only those `vertices`, in that order: each deforms exactly as before. */
export function subset(skin, vertices) {
  const V = vertices.length, row = new Uint32Array(V + 1), of = new Int32Array(skin.V).fill(-1);
  vertices.forEach((v, i) => { row[i + 1] = row[i] + skin.row[v + 1] - skin.row[v]; of[v] = i; });
  const joint = new Uint16Array(row[V]), weight = new Float32Array(row[V]);
  vertices.forEach((v, i) => {
    joint.set(skin.joint.subarray(skin.row[v], skin.row[v + 1]), row[i]);
    weight.set(skin.weight.subarray(skin.row[v], skin.row[v + 1]), row[i]);
  });
  const pick = (array, n) => { const out = new Float32Array(n * V); vertices.forEach((v, i) => out.set(array.subarray(n * v, n * v + n), n * i)); return out; };
  const morphs = skin.morphs.map((m) => {
    const keep = [...m.index.keys()].filter((k) => of[m.index[k]] >= 0);
    return { ...m, index: Uint32Array.from(keep, (k) => of[m.index[k]]), offset: Float32Array.from(keep.flatMap((k) => [...m.offset.subarray(3 * k, 3 * k + 3)])) };
  });
  const rest = pick(skin.rest, 3);
  return { ...skin, V, morphs, rest, moved: rest.slice(), over: pick(skin.over, 1), normals: pick(skin.normals, 3), row, joint, weight };
}

/** Arrays of a skin that are made once, and never twice: `make()` under that name. */
export const once = (skin, name, make) => ((skin.made ??= {})[name] ??= make());

/** positions and normals (V*3 each, written) of `skin` in `pose` (J*12) with displacer `weights`, by one of `BLENDS`. */
export function deform(name, skin, pose, weights, positions, normals) {
  setPose(skin, pose);
  const p = displaceBefore(skin, weights);
  if (name === "linear") linear(skin, p, positions, normals);
  else {
    rigid(skin);
    blend(skin, p, positions, normals, name);
  }
  displaceAfter(skin, weights, positions);
}

export function setPose({ M, J }, pose) {
  M.set(pose);
  M.set([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0], 12 * J);
}

/** (V*3) the rest points with displacers that act before skinning. */
export function displaceBefore(skin, weights) {
  const { morphs, rest, moved } = skin;
  let any = false;
  morphs.forEach((m, d) => { any ||= m.before && weights?.[d]; });
  if (!any) return rest;
  moved.set(rest);
  morphs.forEach((m, d) => {
    const w = m.before ? weights[d] : 0;
    if (w) for (let k = 0; k < m.index.length; k++) for (let i = 0; i < 3; i++) moved[3 * m.index[k] + i] += w * m.offset[3 * k + i];
  });
  return moved;
}

export function displaceAfter(skin, weights, out) {
  const { morphs, M } = skin;
  morphs.forEach((m, d) => {
    const w = m.before ? 0 : weights?.[d];
    if (!w) return;
    const a = 12 * m.joint, o = m.offset;
    for (let k = 0; k < m.index.length; k++) {
      const i = 3 * m.index[k], x = w * o[3 * k], y = w * o[3 * k + 1], z = w * o[3 * k + 2];
      out[i] += M[a] * x + M[a + 1] * y + M[a + 2] * z;
      out[i + 1] += M[a + 4] * x + M[a + 5] * y + M[a + 6] * z;
      out[i + 2] += M[a + 8] * x + M[a + 9] * y + M[a + 10] * z;
    }
  });
}

/** Blends matrices: `out` and `outN` (V*3) of `rest` (V*3) in the pose that was set. */
export function linear(skin, rest, out, outN) {
  const { V, row, joint, weight, over, M, normals } = skin;
  for (let v = 0, i = 0; v < V; v++, i += 3) {
    let a = over[v], b = 0, c = 0, d = 0, e = 0, f = over[v], g = 0, h = 0, p = 0, q = 0, r = over[v], s = 0;
    for (let k = row[v]; k < row[v + 1]; k++) {
      const w = weight[k], m = 12 * joint[k];
      a += w * M[m]; b += w * M[m + 1]; c += w * M[m + 2]; d += w * M[m + 3];
      e += w * M[m + 4]; f += w * M[m + 5]; g += w * M[m + 6]; h += w * M[m + 7];
      p += w * M[m + 8]; q += w * M[m + 9]; r += w * M[m + 10]; s += w * M[m + 11];
    }
    const x = rest[i], y = rest[i + 1], z = rest[i + 2];
    out[i] = a * x + b * y + c * z + d;
    out[i + 1] = e * x + f * y + g * z + h;
    out[i + 2] = p * x + q * y + r * z + s;
    cofactor(outN, i, a, b, c, e, f, g, p, q, r, normals[i], normals[i + 1], normals[i + 2]);
  }
}

/** out[i..i+2] = unit(cof(A) n): safe for singular A, right for scaled ones. */
function cofactor(out, i, a, b, c, e, f, g, p, q, r, x, y, z) {
  const nx = (f * r - g * q) * x + (g * p - e * r) * y + (e * q - f * p) * z;
  const ny = (c * q - b * r) * x + (a * r - c * p) * y + (b * p - a * q) * z;
  const nz = (b * g - c * f) * x + (c * e - a * g) * y + (a * f - b * e) * z;
  const s = 1 / (Math.sqrt(nx * nx + ny * ny + nz * nz) || 1);
  out[i] = nx * s; out[i + 1] = ny * s; out[i + 2] = nz * s;
}

/** Dual quaternion (w x y z | w x y z) of each joint; scale and shear, if any, go to `stretch`, to be applied first. */
export function rigid(skin) {
  const { M, dq, stretch, J, centers } = skin;
  skin.stretched = false;
  const R = new Float64Array(9);
  for (let j = 0; j <= J; j++) {
    const m = 12 * j;
    for (let r = 0; r < 3; r++) for (let c = 0; c < 3; c++) R[3 * r + c] = M[m + 4 * r + c];
    let tx = M[m + 3], ty = M[m + 7], tz = M[m + 11];
    stretch.set([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0], m);
    if (!orthonormal(R)) {
      const A = Float64Array.from(R);
      polar(R);
      const S = multiply3(transpose3(R), A), C = [centers[3 * j], centers[3 * j + 1], centers[3 * j + 2]];
      for (let r = 0; r < 3; r++) {
        let move = C[r];
        for (let c = 0; c < 3; c++) { stretch[m + 4 * r + c] = S[3 * r + c]; move -= S[3 * r + c] * C[c]; }
        stretch[m + 4 * r + 3] = move;
      }
      const SC = apply3(S, C).map((s, r) => s - C[r]), shift = apply3(R, SC);
      tx += shift[0]; ty += shift[1]; tz += shift[2];
      skin.stretched = true;
    }
    const [w, x, y, z] = quaternion(R), d = 8 * j;
    dq[d] = w; dq[d + 1] = x; dq[d + 2] = y; dq[d + 3] = z;
    dq[d + 4] = -0.5 * (tx * x + ty * y + tz * z);
    dq[d + 5] = 0.5 * (tx * w + ty * z - tz * y);
    dq[d + 6] = 0.5 * (-tx * z + ty * w + tz * x);
    dq[d + 7] = 0.5 * (tx * y - ty * x + tz * w);
  }
  skin.agreed = agree(skin);
}

/**
 * Give dual quaternions signs that agree down the skeleton, so that turns of joints add up on the way to another: a fist's
 * last bones are turned by more than half a turn against the palm. False where joints hang on several roots.
 */
function agree({ dq, J, parents = [] }) {
  const roots = Array.from(parents, (p, j) => (p < 0 ? j : -1)).filter((j) => j >= 0);
  if (roots.length !== 1) return false;
  const follow = (a, b) => {
    const i = 8 * a, k = 8 * b;
    if (dq[i] * dq[k] + dq[i + 1] * dq[k + 1] + dq[i + 2] * dq[k + 2] + dq[i + 3] * dq[k + 3] < 0) for (let c = k; c < k + 8; c++) dq[c] = -dq[c];
  };
  for (let j = 0; j < J; j++) if (parents[j] >= 0) follow(parents[j], j);
  follow(roots[0], J);
  return true;
}

function orthonormal(R) {
  for (let a = 0; a < 3; a++) for (let b = a; b < 3; b++) {
    const dot = R[a] * R[b] + R[3 + a] * R[3 + b] + R[6 + a] * R[6 + b];
    if (Math.abs(dot - (a === b ? 1 : 0)) > 1e-4) return false;
  }
  return true;
}

/** The nearest rotation, in place: Higham's iteration X <- (X + X^-T) / 2. */
function polar(X) {
  for (let n = 0; n < 30; n++) {
    const C = [
      X[4] * X[8] - X[5] * X[7], X[5] * X[6] - X[3] * X[8], X[3] * X[7] - X[4] * X[6],
      X[2] * X[7] - X[1] * X[8], X[0] * X[8] - X[2] * X[6], X[1] * X[6] - X[0] * X[7],
      X[1] * X[5] - X[2] * X[4], X[2] * X[3] - X[0] * X[5], X[0] * X[4] - X[1] * X[3],
    ];
    const det = X[0] * C[0] + X[1] * C[1] + X[2] * C[2];
    if (Math.abs(det) < 1e-12) { X.set([1, 0, 0, 0, 1, 0, 0, 0, 1]); return; }
    let change = 0;
    for (let i = 0; i < 9; i++) { const x = 0.5 * (X[i] + C[i] / det); change += Math.abs(x - X[i]); X[i] = x; }
    if (change < 1e-9) return;
  }
}

export const transpose3 = (R) => [R[0], R[3], R[6], R[1], R[4], R[7], R[2], R[5], R[8]];
export const apply3 = (R, p) => [0, 3, 6].map((r) => R[r] * p[0] + R[r + 1] * p[1] + R[r + 2] * p[2]);
export function multiply3(A, B) {
  const C = new Float64Array(9);
  for (let r = 0; r < 9; r += 3) for (let c = 0; c < 3; c++) C[r + c] = A[r] * B[c] + A[r + 1] * B[c + 3] + A[r + 2] * B[c + 6];
  return C;
}

/** Unit quaternion [w, x, y, z] of a rotation (9 row-major), by the largest of trace and diagonal. */
export function quaternion(R) {
  const t = R[0] + R[4] + R[8];
  let q;
  if (t >= Math.max(R[0], R[4], R[8])) q = [1 + t, R[7] - R[5], R[2] - R[6], R[3] - R[1]];
  else if (R[0] >= R[4] && R[0] >= R[8]) q = [R[7] - R[5], 1 + 2 * R[0] - t, R[1] + R[3], R[2] + R[6]];
  else if (R[4] >= R[8]) q = [R[2] - R[6], R[1] + R[3], 1 + 2 * R[4] - t, R[5] + R[7]];
  else q = [R[3] - R[1], R[2] + R[6], R[5] + R[7], 1 + 2 * R[8] - t];
  const s = 1 / Math.hypot(...q);
  return q.map((x) => x * s);
}

/** Blends rigid motions, after `rigid`, by the operator `name`: the same as `linear` otherwise. */
export function blend(skin, rest, out, outN, name) {
  const step = name !== "dual-quaternion", pair = name === "log-pair", absolute = name === "log-absolute";
  const { V, row, joint, weight, M, dq, normals, stretch, stretched, agreed } = skin;
  for (let v = 0, i = 0; v < V; v++, i += 3) {
    const first = row[v], last = row[v + 1];
    let x = rest[i], y = rest[i + 1], z = rest[i + 2];
    let nx = normals[i], ny = normals[i + 1], nz = normals[i + 2];
    if (last - first <= 1) { // rides on one joint: exact, and most of a face and the trunk
      const m = 12 * (last > first ? joint[first] : skin.J);
      out[i] = M[m] * x + M[m + 1] * y + M[m + 2] * z + M[m + 3];
      out[i + 1] = M[m + 4] * x + M[m + 5] * y + M[m + 6] * z + M[m + 7];
      out[i + 2] = M[m + 8] * x + M[m + 9] * y + M[m + 10] * z + M[m + 11];
      if (stretched) cofactor(outN, i, M[m], M[m + 1], M[m + 2], M[m + 4], M[m + 5], M[m + 6], M[m + 8], M[m + 9], M[m + 10], nx, ny, nz);
      else {
        outN[i] = M[m] * nx + M[m + 1] * ny + M[m + 2] * nz;
        outN[i + 1] = M[m + 4] * nx + M[m + 5] * ny + M[m + 6] * nz;
        outN[i + 2] = M[m + 8] * nx + M[m + 9] * ny + M[m + 10] * nz;
      }
      continue;
    }
    // Dual quaternion blend; signs that do not agree anyway by the pivot's hemisphere.
    const pivot = 8 * joint[first];
    const pw = dq[pivot], px = dq[pivot + 1], py = dq[pivot + 2], pz = dq[pivot + 3];
    let total = 0, w = 0, a = 0, b = 0, c = 0, dw = 0, da = 0, db = 0, dc = 0;
    for (let k = first; k < last; k++) {
      const d = 8 * joint[k];
      const s = !agreed && pw * dq[d] + px * dq[d + 1] + py * dq[d + 2] + pz * dq[d + 3] < 0 ? -weight[k] : weight[k];
      total += weight[k];
      w += s * dq[d]; a += s * dq[d + 1]; b += s * dq[d + 2]; c += s * dq[d + 3];
      dw += s * dq[d + 4]; da += s * dq[d + 5]; db += s * dq[d + 6]; dc += s * dq[d + 7];
    }
    const norm = Math.sqrt(w * w + a * a + b * b + c * c);
    if (absolute) {
      w = 1;
      a = b = c = dw = da = db = dc = 0;
    } else if (pair || norm < 1e-8) { // opposite rotations cancel: the pivot decides alone
      w = pw; a = px; b = py; c = pz;
      dw = dq[pivot + 4]; da = dq[pivot + 5]; db = dq[pivot + 6]; dc = dq[pivot + 7];
    } else {
      const s = 1 / norm;
      w *= s; a *= s; b *= s; c *= s; dw *= s; da *= s; db *= s; dc *= s;
    }
    const tx = 2 * (w * da - dw * a + b * dc - c * db);
    const ty = 2 * (w * db - dw * b + c * da - a * dc);
    const tz = 2 * (w * dc - dw * c + a * db - b * da);
    if (stretched) {
      let A = 0, B = 0, C = 0, D = 0, E = 0, F = 0, G = 0, H = 0, P = 0, Q = 0, R = 0, S = 0;
      for (let k = first; k < last; k++) {
        const u = weight[k] / total, m = 12 * joint[k];
        A += u * stretch[m]; B += u * stretch[m + 1]; C += u * stretch[m + 2]; D += u * stretch[m + 3];
        E += u * stretch[m + 4]; F += u * stretch[m + 5]; G += u * stretch[m + 6]; H += u * stretch[m + 7];
        P += u * stretch[m + 8]; Q += u * stretch[m + 9]; R += u * stretch[m + 10]; S += u * stretch[m + 11];
      }
      const X = x, Y = y, Z = z;
      x = A * X + B * Y + C * Z + D; y = E * X + F * Y + G * Z + H; z = P * X + Q * Y + R * Z + S;
      cofactor(outN, i, A, B, C, E, F, G, P, Q, R, nx, ny, nz);
      nx = outN[i]; ny = outN[i + 1]; nz = outN[i + 2];
    }
    if (step) {
      // xi = sum w_i log(A0^-1 M_i), A0 the motion above
      let wx = 0, wy = 0, wz = 0, vx = 0, vy = 0, vz = 0;
      for (let k = first; k < last; k++) {
        const d = 8 * joint[k], u = weight[k] / total;
        const qw = dq[d], qx = dq[d + 1], qy = dq[d + 2], qz = dq[d + 3];
        const ew = dq[d + 4], ex = dq[d + 5], ey = dq[d + 6], ez = dq[d + 7];
        // relative dual quaternion conj(b) * q_i
        let rw = w * qw + a * qx + b * qy + c * qz;
        let rx = w * qx - a * qw - b * qz + c * qy;
        let ry = w * qy + a * qz - b * qw - c * qx;
        let rz = w * qz - a * qy + b * qx - c * qw;
        let sw = w * ew + a * ex + b * ey + c * ez + dw * qw + da * qx + db * qy + dc * qz;
        let sx = w * ex - a * ew - b * ez + c * ey + dw * qx - da * qw - db * qz + dc * qy;
        let sy = w * ey + a * ez - b * ew - c * ex + dw * qy + da * qz - db * qw - dc * qx;
        let sz = w * ez - a * ey + b * ex - c * ew + dw * qz - da * qy + db * qx - dc * qw;
        // the sign that the blend above took, which for the last is the short way from rest
        if ((absolute ? rw : agreed ? 1 : pw * qw + px * qx + py * qy + pz * qz) < 0) { rw = -rw; rx = -rx; ry = -ry; rz = -rz; sw = -sw; sx = -sx; sy = -sy; sz = -sz; }
        const lx = 2 * (rw * sx - sw * rx + ry * sz - rz * sy);
        const ly = 2 * (rw * sy - sw * ry + rz * sx - rx * sz);
        const lz = 2 * (rw * sz - sw * rz + rx * sy - ry * sx);
        // f = angle / |r|, kk = (1 - (angle/2) cot(angle/2)) / angle^2; series in tt = tan^2(angle/2) up to 33 degrees
        const nn = rx * rx + ry * ry + rz * rz, tt = nn / (rw * rw);
        let f, kk;
        if (rw > 0 && tt < 0.09) {
          const tail = 1 / 3 - tt * (1 / 5 - tt * (1 / 7 - tt * (1 / 9 - tt * (1 / 11 - tt / 13)))), p = 1 - tt * tail;
          f = 2 * p / rw;
          kk = tail / (4 * p * p);
        } else {
          const n = Math.sqrt(nn), angle = 2 * Math.atan2(n, rw);
          f = angle / n;
          kk = (1 - angle * rw / (2 * n)) / (angle * angle);
        }
        const ox = f * rx, oy = f * ry, oz = f * rz;
        const cx = oy * lz - oz * ly, cy = oz * lx - ox * lz, cz = ox * ly - oy * lx;
        wx += u * ox; wy += u * oy; wz += u * oz;
        vx += u * (lx - 0.5 * cx + kk * (oy * cz - oz * cy));
        vy += u * (ly - 0.5 * cy + kk * (oz * cx - ox * cz));
        vz += u * (lz - 0.5 * cz + kk * (ox * cy - oy * cx));
      }
      const s = wx * wx + wy * wy + wz * wz;
      let A, B, C;
      if (s < 0.25) {
        A = 1 - s * (1 / 6 - s * (1 / 120 - s / 5040));
        B = 1 / 2 - s * (1 / 24 - s * (1 / 720 - s / 40320));
        C = 1 / 6 - s * (1 / 120 - s * (1 / 5040 - s / 362880));
      } else {
        const th = Math.sqrt(s), h = Math.sin(th / 2);
        A = Math.sin(th) / th; B = 2 * h * h / s; C = (1 - A) / s;
      }
      // exp(xi) on the point and on the normal, without forming a matrix
      let cx = wy * z - wz * y, cy = wz * x - wx * z, cz = wx * y - wy * x;
      let dx = wy * vz - wz * vy, dy = wz * vx - wx * vz, dz = wx * vy - wy * vx;
      x += A * cx + B * (wy * cz - wz * cy) + vx + B * dx + C * (wy * dz - wz * dy);
      y += A * cy + B * (wz * cx - wx * cz) + vy + B * dy + C * (wz * dx - wx * dz);
      z += A * cz + B * (wx * cy - wy * cx) + vz + B * dz + C * (wx * dy - wy * dx);
      cx = wy * nz - wz * ny; cy = wz * nx - wx * nz; cz = wx * ny - wy * nx;
      nx += A * cx + B * (wy * cz - wz * cy);
      ny += A * cy + B * (wz * cx - wx * cz);
      nz += A * cz + B * (wx * cy - wy * cx);
    }
    // rotate by the blended quaternion: r = p + 2 u x (u x p + w p)
    let gx = b * z - c * y + w * x, gy = c * x - a * z + w * y, gz = a * y - b * x + w * z;
    out[i] = x + 2 * (b * gz - c * gy) + tx;
    out[i + 1] = y + 2 * (c * gx - a * gz) + ty;
    out[i + 2] = z + 2 * (a * gy - b * gx) + tz;
    gx = b * nz - c * ny + w * nx; gy = c * nx - a * nz + w * ny; gz = a * ny - b * nx + w * nz;
    outN[i] = nx + 2 * (b * gz - c * gy);
    outN[i + 1] = ny + 2 * (c * gx - a * gz);
    outN[i + 2] = nz + 2 * (a * gy - b * gx);
  }
}
