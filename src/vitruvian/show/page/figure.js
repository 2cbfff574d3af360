// One actor: its geometry, deformed on the processor each frame, and what is drawn on top of its skin.

import * as THREE from "three";
import { DEFORMERS, bind, deform, restNormals } from "./deform.js";
import { flat, material } from "./looks.js";
import { RAMP, category, toLinear } from "./colors.js";
import { center, turned } from "./pose.js";
import * as wire from "./wire.js";

const LINEAR = Float32Array.from({ length: 256 }, (_, i) => toLinear(i / 255));

export class Figure {
  constructor(header, blocks) {
    const get = (name) => blocks[name]?.array;
    Object.assign(this, { name: header.actor, joints: header.joints, parents: header.parents, sites: header.sites });
    Object.assign(this, { displacers: header.displacers, deformer: header.deformer, travel: header.travel });
    this.centers = get("centers") ?? new Float32Array(0);
    this.limits = get("limits");
    this.limitOrientation = get("limit_orientation");
    this.sitePoints = get("site_points") ?? new Float32Array(0);
    this.binding = get("binding");
    this.row = get("row");
    this.joint = get("joint");
    this.weight = get("weight");
    const rest = get("rest"), V = rest.length / 3;
    this.source = get("source") ?? Uint32Array.from({ length: V }, (_, i) => i);
    this.whole = this.source.length === V && this.source.every((s, i) => s === i);
    this.triangles = get("triangles");
    const unsplit = this.triangles.map((i) => this.source[i]);
    this.turns = new Map(); // joint -> rotation (9) that was added by hand
    this.displaced = new Map(); // displacer -> weight set by hand
    this.isBody = this.joints.length > 0;
    this.positions = Float32Array.from(rest);
    this.normals = restNormals(rest, unsplit);
    if (this.isBody) {
      this.skin = bind({
        rest, row: this.row, joint: this.joint, weight: this.weight, triangles: unsplit, centers: this.centers,
        morphs: morphs(header.displacers, blocks),
      });
      this.pose = identity(this.joints.length); // as posed by hand, without binding
      this.clip = identity(this.joints.length); // as the frame has it
      this.bound = new Float32Array(this.pose.length);
      this.displacerWeights = new Float32Array(this.displacers.length);
      this.blobs = blobs(this, rest);
    }
    this.build(header.parts, get("colors"), get("openness"), get("placement"));
  }

  build(parts, colors, openness, placement) {
    const N = this.source.length, geometry = new THREE.BufferGeometry();
    const attribute = (size, usage) => new THREE.BufferAttribute(new Float32Array(size * N), size).setUsage(usage);
    geometry.setAttribute("position", attribute(3, THREE.DynamicDrawUsage));
    geometry.setAttribute("normal", attribute(3, THREE.DynamicDrawUsage));
    geometry.setIndex(new THREE.BufferAttribute(this.triangles, 1));
    geometry.boundingSphere = new THREE.Sphere(new THREE.Vector3(), 1e4);
    geometry.boundingBox = new THREE.Box3(new THREE.Vector3(-1e4, -1e4, -1e4), new THREE.Vector3(1e4, 1e4, 1e4));
    if (colors) {
      this.painted = attribute(3, THREE.StaticDrawUsage);
      this.source.forEach((s, i) => { for (let c = 0; c < 3; c++) this.painted.array[3 * i + c] = LINEAR[colors[3 * s + c]]; });
      geometry.setAttribute("color", this.painted);
    }
    const open = new Float32Array(N).fill(1);
    if (openness) this.source.forEach((s, i) => { open[i] = openness[s] / 255; });
    geometry.setAttribute("openness", new THREE.BufferAttribute(open, 1));
    parts.forEach((p, i) => geometry.addGroup(3 * p.start, 3 * (p.stop - p.start), i));
    this.looks = parts.map((p) => material(p, Boolean(colors)));
    this.mesh = new THREE.Mesh(geometry, this.looks);
    Object.assign(this.mesh, { frustumCulled: false, castShadow: true, receiveShadow: true });
    this.group = new THREE.Group();
    this.space = new THREE.Group(); // humanoid space
    if (placement) { this.space.matrixAutoUpdate = false; this.space.matrix.set(...placement, 0, 0, 0, 1); }
    this.space.add(this.mesh);
    this.group.add(this.space);
    this.parts = parts;
    this.upload();
  }

  /** Take a frame's blocks; deform again. */
  update(blocks) {
    if (!this.isBody) return;
    if (blocks?.pose) {
      this.clip.set(blocks.pose.array);
      this.displacerWeights.set(blocks.displacers?.array ?? []);
    }
    this.served = blocks?.vertices ? blocks : null;
    this.refresh();
  }

  /** Deform in the present pose. */
  refresh() {
    if (!this.isBody) return;
    turned(this.clip, this.turns, this.parents, this.centers, this.pose);
    if (this.served) {
      wire.positions(this.served.vertices, this.positions);
      wire.normals(this.served.normals, this.normals);
    } else {
      const name = DEFORMERS.includes(this.deformer) ? this.deformer : "log";
      deform(name, this.skin, this.matrices(), this.weights(), this.positions, this.normals);
    }
    this.upload();
  }

  matrices() { return this.binding ? multiply(this.pose, this.binding, this.bound) : this.pose; }

  weights() {
    if (!this.displaced.size) return this.displacerWeights;
    const w = Float32Array.from(this.displacerWeights);
    for (const [d, value] of this.displaced) w[d] = value;
    return w;
  }

  upload() {
    const { position, normal } = this.mesh.geometry.attributes, p = position.array, n = normal.array, { source, positions, normals } = this;
    if (this.whole) { p.set(positions); n.set(normals); } // nothing was split
    else for (let i = 0, k = 0; i < source.length; i++, k += 3) {
      const s = 3 * source[i];
      p[k] = positions[s]; p[k + 1] = positions[s + 1]; p[k + 2] = positions[s + 2];
      n[k] = normals[s]; n[k + 1] = normals[s + 1]; n[k + 2] = normals[s + 2];
    }
    position.needsUpdate = normal.needsUpdate = true;
  }

  /** skin, weights (of joint `j`) or segments. */
  paint(mode, j = 0) {
    const { geometry } = this.mesh, N = this.source.length;
    if (mode === "skin" || !this.isBody) {
      if (this.painted) geometry.setAttribute("color", this.painted);
      this.mesh.material = this.looks;
      return;
    }
    const value = mode === "weights" ? this.jointWeights(j) : this.owners(), c = new Float32Array(3 * N), linear = RAMP.map((rgb) => rgb.map(toLinear));
    const palette = mode === "weights" ? null : this.joints.map((_, i) => category(i).map(toLinear));
    for (let i = 0; i < N; i++) {
      const v = value[this.source[i]];
      c.set(palette ? palette[v] : linear[Math.round(255 * Math.min(1, Math.max(0, v)))], 3 * i);
    }
    geometry.setAttribute("color", new THREE.BufferAttribute(c, 3));
    this.mesh.material = this.flat ??= flat();
  }

  jointWeights(j) {
    const out = new Float32Array(this.row.length - 1);
    for (let v = 0; v < out.length; v++) for (let k = this.row[v]; k < this.row[v + 1]; k++) if (this.joint[k] === j) out[v] += this.weight[k];
    return out;
  }

  /** Joint with the largest weight, of each vertex. */
  owners() {
    const out = new Uint16Array(this.row.length - 1);
    for (let v = 0; v < out.length; v++) {
      let best = -1;
      for (let k = this.row[v]; k < this.row[v + 1]; k++) if (this.weight[k] > best) { best = this.weight[k]; out[v] = this.joint[k]; }
    }
    return out;
  }

  wireframe(on) {
    if (on && !this.edges) {
      const lines = new THREE.BufferGeometry(), seen = new Set(), index = [], t = this.triangles, N = this.source.length;
      for (let k = 0; k < t.length; k += 3) for (const [a, b] of [[t[k], t[k + 1]], [t[k + 1], t[k + 2]], [t[k + 2], t[k]]]) {
        const id = Math.min(a, b) * N + Math.max(a, b);
        if (!seen.has(id)) { seen.add(id); index.push(a, b); }
      }
      lines.setAttribute("position", this.mesh.geometry.attributes.position);
      lines.setIndex(index);
      const look = new THREE.LineBasicMaterial({ color: "#0d3b4a", transparent: true, opacity: 0.35, toneMapped: false });
      this.edges = new THREE.LineSegments(lines, look);
      this.edges.frustumCulled = false;
      this.space.add(this.edges);
      for (const look of [...this.looks, (this.flat ??= flat())]) Object.assign(look, { polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1, needsUpdate: true });
    }
    if (this.edges) this.edges.visible = on;
  }

  /** World position of joint j's centre. */
  jointPosition(j, out = new THREE.Vector3()) {
    return out.fromArray(center(this.pose, this.centers, j)).applyMatrix4(this.space.matrixWorld);
  }

  sitePosition(s, out = new THREE.Vector3()) {
    const m = 12 * this.sites[s].joint, p = this.sitePoints, x = p[3 * s], y = p[3 * s + 1], z = p[3 * s + 2], M = this.pose;
    return out.fromArray([0, 4, 8].map((r) => M[m + r] * x + M[m + r + 1] * y + M[m + r + 2] * z + M[m + r + 3])).applyMatrix4(this.space.matrixWorld);
  }

  /** Spheres [x, y, z, r] about the vertices of each joint, in world space. */
  spheres() {
    if (!this.isBody) return [];
    const p = new THREE.Vector3();
    return this.blobs.map(([j, x, y, z, r]) => {
      const m = 12 * j, M = this.pose;
      p.fromArray([0, 4, 8].map((a) => M[m + a] * x + M[m + a + 1] * y + M[m + a + 2] * z + M[m + a + 3])).applyMatrix4(this.space.matrixWorld);
      return [p.x, p.y, p.z, r];
    });
  }

  /** [low, high] of the present surface. */
  box() {
    const low = [1e9, 1e9, 1e9], high = [-1e9, -1e9, -1e9], p = new THREE.Vector3();
    this.group.updateMatrixWorld(true);
    for (let i = 0; i < this.positions.length; i += 3) {
      p.fromArray(this.positions, i).applyMatrix4(this.space.matrixWorld);
      for (const [a, v] of [[0, p.x], [1, p.y], [2, p.z]]) { low[a] = Math.min(low[a], v); high[a] = Math.max(high[a], v); }
    }
    return [low, high];
  }
}

function identity(J) {
  const out = new Float32Array(12 * J);
  for (let m = 0; m < out.length; m += 12) out[m] = out[m + 5] = out[m + 10] = 1;
  return out;
}

/** Rows of 3x4 matrices: A B. */
function multiply(A, B, out) {
  for (let m = 0; m < A.length; m += 12) for (let r = 0; r < 12; r += 4) for (let c = 0; c < 4; c++) {
    out[m + r + c] = A[m + r] * B[m + c] + A[m + r + 1] * B[m + 4 + c] + A[m + r + 2] * B[m + 8 + c] + (c === 3 ? A[m + r + 3] : 0);
  }
  return out;
}

function morphs(displacers, blocks) {
  const row = blocks.morph_row?.array, index = blocks.morph_index?.array, offset = blocks.morph_offset?.array;
  return displacers.map((d, i) => ({
    ...d, index: index.subarray(row[i], row[i + 1]), offset: offset.subarray(3 * row[i], 3 * row[i + 1]),
  }));
}

/** For each joint that owns skin: [joint, centre x, y, z, radius] of a sphere of about that skin, for contact shadows. */
function blobs(figure, rest) {
  const owner = figure.owners(), J = figure.joints.length, sum = new Float64Array(4 * J), spread = new Float64Array(J);
  owner.forEach((j, v) => { for (let c = 0; c < 3; c++) sum[4 * j + c] += rest[3 * v + c]; sum[4 * j + 3]++; });
  for (let j = 0; j < J; j++) for (let c = 0; c < 3; c++) sum[4 * j + c] /= sum[4 * j + 3] || 1;
  owner.forEach((j, v) => { spread[j] += Math.hypot(rest[3 * v] - sum[4 * j], rest[3 * v + 1] - sum[4 * j + 1], rest[3 * v + 2] - sum[4 * j + 2]); });
  const out = [];
  for (let j = 0; j < J; j++) {
    const n = sum[4 * j + 3];
    if (n > 2) out.push([j, sum[4 * j], sum[4 * j + 1], sum[4 * j + 2], (0.85 * spread[j]) / n]);
  }
  return out;
}
