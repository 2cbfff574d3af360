// One actor: its geometry, deformed on the processor each frame, and what is drawn on top of its skin.
// Where drawing is slow, less of it while it plays (detail.js); all of it, exactly, as soon as it stands.

import * as THREE from "three";
import { restNormals } from "./deform.js";
import { coarser, mapped, ordered } from "./detail.js";
import { heated } from "./heat.js";
import { flat, material } from "./looks.js";
import { coordinates, pictures } from "./pictures.js";
import { able, run } from "./operators.js";
import { skinOf, subset } from "./skin.js";
import { limbPlaces, striped } from "./stripes.js";
import { RAMP, category, toLinear } from "./colors.js";
import { aboveAt, follow, keptAt } from "./level.js";
import { center, shifted, turned } from "./pose.js";
import * as wire from "./wire.js";

const LINEAR = Float32Array.from({ length: 256 }, (_, i) => toLinear(i / 255));

export class Figure {
  constructor(header, blocks) {
    const get = (name) => blocks[name]?.array;
    Object.assign(this, { name: header.actor, joints: header.joints, parents: header.parents, sites: header.sites });
    Object.assign(this, { displacers: header.displacers, deformer: header.deformer, travel: header.travel, on: header.on });
    Object.assign(this, { loa: header.loa ?? [], otherNames: header.names ?? [], segments: header.segments ?? [], cameras: header.cameras ?? [], features: header.features, handles: header.handles ?? [] });
    this.heat = header.heat && { ...header.heat, mm: get("heat") };
    this.heat?.layers?.forEach((layer, i) => { layer.mm = get(i ? `heat_${i}` : "heat"); });
    this.marks = header.markers && { names: header.markers, joint: get("marker_joint"), point: get("marker_point"), now: null };
    this.centers = get("centers") ?? new Float32Array(0);
    this.stiffness = get("stiffness");
    this.limits = get("limits");
    this.limitOrientation = get("limit_orientation");
    this.sitePoints = get("site_points") ?? new Float32Array(0);
    this.binding = get("binding");
    this.row = get("row");
    this.joint = get("joint");
    this.weight = get("weight");
    const rest = (this.rest = get("rest")), V = rest.length / 3;
    this.source = get("source") ?? Uint32Array.from({ length: V }, (_, i) => i);
    this.unsplit = this.source.length === V && this.source.every((s, i) => s === i);
    this.triangles = get("triangles");
    const unsplit = this.triangles.map((i) => this.source[i]);
    this.uv = header.parts.some((p) => p.picture) ? get("uv") : null;
    this.levels = new Map(); // cell -> a coarser surface, or null
    this.coarse = null; // the one that is drawn
    this.turns = new Map(); // joint -> rotation (9) that was added by hand
    this.shift = null; // of the first joint and all below it, by hand
    this.displaced = new Map(); // displacer -> weight set by hand
    this.isBody = this.joints.length > 0;
    this.positions = Float32Array.from(rest);
    this.normals = restNormals(rest, unsplit);
    if (this.isBody) {
      this.skin = skinOf(header, blocks);
      this.pose = identity(this.joints.length); // as posed by hand, without binding
      this.given = identity(this.joints.length); // as the frame has it
      this.clip = identity(this.joints.length); // the same at the level of articulation that is shown
      this.bound = new Float32Array(this.pose.length);
      this.displacerWeights = new Float32Array(this.displacers.length);
      this.blobs = blobs(this, rest);
    }
    this.stature = extent(rest, this.centers); // in units of the humanoid's space, which need not be metres
    this.setLevel(4);
    this.build(header.parts, get("colors"), get("openness"), get("placement"));
  }

  /** Show only joints up to this level of articulation; the others follow (level.js). */
  setLevel(level) {
    this.level = level;
    this.kept = keptAt(this.loa, this.parents, level);
    this.above = aboveAt(this.kept, this.parents);
    this.folded = this.kept.some((k, j) => k !== j);
    this.bindingShown = this.binding && follow(this.binding, this.kept, new Float32Array(this.binding.length));
    if (this.isBody) follow(this.given, this.kept, this.clip);
  }

  /** Turns by hand of the joints that are kept. */
  get shownTurns() { return this.folded ? new Map([...this.turns].filter(([j]) => this.kept[j] === j)) : this.turns; }

  build(parts, colors, openness, placement) {
    this.colors = colors;
    this.openness = openness;
    this.geometry = this.shape(this.source, this.triangles, parts, this.uv); // whole; the mesh may have a coarser one
    this.looks = parts.map((p) => pictures.dress(material(p, Boolean(colors)), p.picture));
    this.mesh = new THREE.Mesh(this.geometry, this.looks);
    Object.assign(this.mesh, { frustumCulled: false, castShadow: true, receiveShadow: true });
    this.group = new THREE.Group();
    this.space = new THREE.Group(); // humanoid space
    if (placement) { this.space.matrixAutoUpdate = false; this.space.matrix.set(...placement, 0, 0, 0, 1); }
    this.space.add(this.mesh);
    this.group.add(this.space);
    this.parts = parts;
    this.upload();
  }

  /** A geometry that draws the skin vertices `source`, `uv` (N*2) or null; positions and normals are still to be filled in. */
  shape(source, triangles, groups, uv) {
    const N = source.length, geometry = new THREE.BufferGeometry(), { colors, openness } = this;
    const moving = () => new THREE.BufferAttribute(new Float32Array(3 * N), 3).setUsage(THREE.DynamicDrawUsage);
    geometry.setAttribute("position", moving());
    geometry.setAttribute("normal", moving());
    geometry.setIndex(new THREE.BufferAttribute(N < 65536 ? Uint16Array.from(triangles) : triangles, 1));
    geometry.boundingSphere = new THREE.Sphere(new THREE.Vector3(), 1e4);
    geometry.boundingBox = new THREE.Box3(new THREE.Vector3(-1e4, -1e4, -1e4), new THREE.Vector3(1e4, 1e4, 1e4));
    if (colors) {
      const paint = new Float32Array(3 * N);
      source.forEach((s, i) => { for (let c = 0; c < 3; c++) paint[3 * i + c] = LINEAR[colors[3 * s + c]]; });
      geometry.setAttribute("color", (geometry.userData.painted = new THREE.BufferAttribute(paint, 3)));
    }
    if (uv) geometry.setAttribute("uv", coordinates(uv));
    const open = new Float32Array(N).fill(1);
    if (openness) source.forEach((s, i) => { open[i] = openness[s] / 255; });
    geometry.setAttribute("openness", new THREE.BufferAttribute(open, 1));
    groups.forEach((g, i) => geometry.addGroup(3 * g.start, 3 * (g.stop - g.start), i));
    return geometry;
  }

  /** Draw, from the next frame on, one point for each cell of `cell` metres; 0: all of them. */
  detail(cell) {
    const before = this.coarse;
    if (!cell || !this.isBody) { this.coarse = null; return; }
    const step = 2 ** (Math.floor(4 * Math.log2(cell)) / 4); // few different ones, so that each is made once
    if (!this.levels.has(step)) this.levels.set(step, this.simplify(step));
    this.coarse = this.levels.get(step);
    if (this.coarse && this.coarse !== before && this.look) this.mesh.material = this.dress(this.coarse.geometry, this.coarse.source, ...this.look);
  }

  simplify(cell) {
    const { source, rest } = this, made = coarser(rest, this.triangles.map((i) => source[i]), this.parts, cell, this.kinds());
    if (!made || made.triangles.length > 0.85 * this.triangles.length) return null; // not worth the difference
    const split = this.uv ? mapped(made, this, cell) : made;
    const { source: order, triangles } = ordered(split.triangles, split.groups, split.source.length), points = order.map((i) => split.source[i]);
    const uv = this.uv && Float32Array.from({ length: 2 * order.length }, (_, i) => split.uv[2 * order[i >> 1] + (i & 1)]);
    return { source: points, triangles, groups: made.groups, uv, geometry: this.shape(points, triangles, made.groups, uv), skin: subset(this.skin, points) };
  }

  /** What must not be joined: what looks another way (6), has another colour (8), or lies in a fold as the mouth does (2). */
  kinds() {
    const { colors, openness } = this, { normals } = this.skin, out = new Uint8Array(this.rest.length / 3);
    for (let v = 0, i = 0; v < out.length; v++, i += 3) {
      const n = [normals[i], normals[i + 1], normals[i + 2]], size = n.map(Math.abs), axis = size.indexOf(Math.max(...size));
      const color = colors ? (colors[i] >> 7) | ((colors[i + 1] >> 7) << 1) | ((colors[i + 2] >> 7) << 2) : 0;
      out[v] = ((2 * Math.max(0, axis) + (n[axis] > 0)) * 8 + color) * 2 + (openness ? openness[v] < 90 : 0);
    }
    return out;
  }

  /** Skin vertex of each vertex that is being drawn. */
  get drawn() { return this.coarse?.source ?? this.source; }

  /** (V*3) of the whole skin as it is now, also while less of it is drawn. */
  whole() {
    if (this.coarse && !this.served) run(this.kernel(), this.skin, this.matrices(), this.weights(), this.positions, this.normals);
    return this.positions;
  }

  /** Take a frame's blocks; deform again. */
  update(blocks) {
    if (!this.isBody) { // cloth that the server moves
      if (!blocks?.vertices) return;
      wire.positions(blocks.vertices, this.positions);
      wire.normals(blocks.normals, this.normals);
      return this.upload();
    }
    if (blocks?.pose) {
      this.given.set(blocks.pose.array);
      follow(this.given, this.kept, this.clip);
      this.displacerWeights.set(blocks.displacers?.array ?? []);
      if (blocks.markers) this.marks.now = blocks.markers.array;
    }
    this.served = blocks?.vertices && !this.reweighted && !this.sparse ? blocks : null;
    this.refresh();
  }

  /** Deform in the present pose. */
  refresh() {
    if (!this.isBody) return;
    turned(this.clip, this.shownTurns, this.parents, this.centers, this.pose);
    if (this.shift) shifted(this.pose, this.shift, this.parents);
    if (this.served && !this.folded) {
      this.pose.set((this.served.posed ?? this.served.pose).array); // joints wait for their points
      wire.positions(this.served.vertices, this.positions);
      wire.normals(this.served.normals, this.normals);
      this.coarse = null;
    } else if (this.coarse) {
      const { geometry, skin } = this.coarse, { position, normal } = geometry.attributes;
      run(this.kernel(), skin, this.matrices(), this.weights(), position.array, normal.array);
      position.needsUpdate = normal.needsUpdate = true;
      this.mesh.geometry = geometry;
      return;
    } else run(this.kernel(), this.skin, this.matrices(), this.weights(), this.positions, this.normals);
    this.mesh.geometry = this.geometry;
    this.upload();
  }

  /** Less than all of it was asked for, and the page can deform that much itself: the server's surface comes whole. */
  get sparse() { return this.coarse && this.byHand && able(this.deformer, this.skin); }

  kernel() { return able(this.deformer, this.skin) ? this.deformer : "log"; }

  matrices() { return this.binding ? multiply(this.pose, this.bindingShown, this.bound) : this.pose; }

  weights() {
    if (!this.displaced.size) return this.displacerWeights;
    const w = Float32Array.from(this.displacerWeights);
    for (const [d, value] of this.displaced) w[d] = value;
    return w;
  }

  upload() {
    const { position, normal } = this.geometry.attributes, p = position.array, n = normal.array, { source, positions, normals } = this;
    if (this.unsplit) { p.set(positions); n.set(normals); } // nothing was split
    else for (let i = 0, k = 0; i < source.length; i++, k += 3) {
      const s = 3 * source[i];
      p[k] = positions[s]; p[k + 1] = positions[s + 1]; p[k + 2] = positions[s + 2];
      n[k] = normals[s]; n[k + 1] = normals[s + 1]; n[k + 2] = normals[s + 2];
    }
    position.needsUpdate = normal.needsUpdate = true;
  }

  /** skin, weights (of joint `j`), segments or stripes. */
  paint(mode, j = 0) {
    this.look = [mode, j];
    for (const { geometry, source } of this.coarse ? [this, this.coarse] : [this]) this.mesh.material = this.dress(geometry, source, mode, j);
  }

  /** Give a geometry that draws the skin vertices `source` the colours of a mode; returns the material that goes with them. */
  dress(geometry, source, mode, j = 0) {
    if (mode === "heat" && this.heat) return heated(this, geometry, source);
    if (mode === "stripes" && this.isBody) {
      this.limbs ??= limbPlaces(this.skin);
      if (!geometry.attributes.place) geometry.setAttribute("place", new THREE.BufferAttribute(Float32Array.from({ length: 3 * source.length }, (_, i) => this.limbs[3 * source[(i / 3) | 0] + (i % 3)]), 3));
      return (this.stripes ??= this.parts.map((p, i) => striped(p, 1.75 / this.stature) ?? this.looks[i]));
    }
    if (mode === "skin" || mode === "heat" || !this.isBody) {
      if (geometry.userData.painted) geometry.setAttribute("color", geometry.userData.painted);
      return this.looks;
    }
    const value = mode === "weights" ? this.jointWeights(j) : this.owners().map((o) => this.kept[o]), c = new Float32Array(3 * source.length), linear = RAMP.map((rgb) => rgb.map(toLinear));
    const palette = mode === "weights" ? null : this.joints.map((_, i) => category(i).map(toLinear));
    for (let i = 0; i < source.length; i++) {
      const v = value[source[i]];
      c.set(palette ? palette[v] : linear[Math.round(255 * Math.min(1, Math.max(0, v)))], 3 * i);
    }
    geometry.setAttribute("color", new THREE.BufferAttribute(c, 3));
    return (this.flat ??= flat());
  }

  /** Draw with this figure's own surface again, after columns were drawn with theirs. */
  undress() {
    this.edges?.geometry.setAttribute("position", (this.edges.userData.of ?? this.geometry).attributes.position);
    if (this.edges) this.edges.visible = this.edges.userData.on;
  }

  jointWeights(j) {
    const out = new Float32Array(this.row.length - 1);
    for (let v = 0; v < out.length; v++) for (let k = this.row[v]; k < this.row[v + 1]; k++) if (this.kept[this.joint[k]] === j) out[v] += this.weight[k];
    return out;
  }

  /** Joint with the largest weight, of each vertex; it may be one that follows another now. */
  owners() {
    const out = new Uint16Array(this.row.length - 1);
    for (let v = 0; v < out.length; v++) {
      let best = -1;
      for (let k = this.row[v]; k < this.row[v + 1]; k++) if (this.weight[k] > best) { best = this.weight[k]; out[v] = this.joint[k]; }
    }
    return out;
  }

  /** The edges of what is drawn. */
  wireframe(on) {
    const { geometry, triangles, source } = this.coarse ?? this;
    if (on && !this.edges) {
      const look = new THREE.LineBasicMaterial({ color: "#0d3b4a", transparent: true, opacity: 0.35, toneMapped: false });
      this.edges = new THREE.LineSegments(new THREE.BufferGeometry(), look);
      this.edges.frustumCulled = false;
      this.space.add(this.edges);
      for (const look of [...this.looks, (this.flat ??= flat())]) Object.assign(look, { polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1, needsUpdate: true });
    }
    if (on && this.edges.userData.of !== geometry) {
      this.edges.geometry.dispose();
      this.edges.geometry = outline(triangles, source.length, geometry);
      this.edges.userData.of = geometry;
    }
    if (this.edges) this.edges.userData.on = this.edges.visible = on;
  }

  /** World position of joint j's centre. */
  jointPosition(j, out = new THREE.Vector3()) {
    return out.fromArray(center(this.pose, this.centers, j)).applyMatrix4(this.space.matrixWorld);
  }

  /** Direction v of the rest pose as it is turned with joint j, in the world. */
  turned(j, [x, y, z], out = new THREE.Vector3()) {
    const m = 12 * j, M = this.pose;
    return out.fromArray([0, 4, 8].map((r) => M[m + r] * x + M[m + r + 1] * y + M[m + r + 2] * z)).transformDirection(this.space.matrixWorld);
  }

  sitePosition(s, out = new THREE.Vector3()) {
    return this.moved(this.sites[s].joint, this.sitePoints.subarray(3 * s, 3 * s + 3), out);
  }

  /** World position of the point [x, y, z] of the rest pose that rides on joint j; j -1: on the humanoid itself. */
  moved(j, [x, y, z], out = new THREE.Vector3()) {
    if (j < 0) return out.set(x, y, z).applyMatrix4(this.space.matrixWorld);
    const m = 12 * j, M = this.pose;
    return out.fromArray([0, 4, 8].map((r) => M[m + r] * x + M[m + r + 1] * y + M[m + r + 2] * z + M[m + r + 3])).applyMatrix4(this.space.matrixWorld);
  }

  /** {joint, point}: the middle of displacer d's vertices at rest and the joint that most of them ride on. */
  region(d) {
    const { index } = this.skin.morphs[d], point = [0, 0, 0], votes = new Map(), owner = (this.owner ??= this.owners());
    for (const v of index) {
      for (let c = 0; c < 3; c++) point[c] += this.rest[3 * v + c] / index.length;
      votes.set(owner[v], (votes.get(owner[v]) ?? 0) + 1);
    }
    return { point, joint: [...votes].sort((a, b) => b[1] - a[1])[0]?.[0] ?? 0 };
  }

  /** [vertices that follow joint j at all, vertices that follow it most]. */
  skinOf(j) {
    let any = 0, most = 0;
    const owner = (this.owner ??= this.owners());
    for (let v = 0; v + 1 < this.row.length; v++) {
      for (let k = this.row[v]; k < this.row[v + 1]; k++) if (this.kept[this.joint[k]] === j && this.weight[k] > 0) { any++; break; }
      if (this.row[v + 1] > this.row[v] && this.kept[owner[v]] === j) most++;
    }
    return [any, most];
  }

  /** Unit normal of the drawn skin vertex nearest to a world point, or null when nothing is drawn. */
  outward(point) {
    const p = point.clone().applyMatrix4(this.space.matrixWorld.clone().invert()), { position, normal } = this.mesh.geometry.attributes;
    let best = Infinity, at = -1;
    for (let i = 0, a = position.array; i < a.length; i += 3) {
      const d = (a[i] - p.x) ** 2 + (a[i + 1] - p.y) ** 2 + (a[i + 2] - p.z) ** 2;
      if (d < best) { best = d; at = i; }
    }
    return at < 0 ? null : new THREE.Vector3().fromArray(normal.array, at).transformDirection(this.space.matrixWorld);
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

  /** [low, high] of the present surface, or of the joints where there is none. */
  box() {
    const low = [1e9, 1e9, 1e9], high = [-1e9, -1e9, -1e9], p = new THREE.Vector3();
    this.group.updateMatrixWorld(true);
    const points = this.whole();
    for (let i = 0; i < points.length; i += 3) {
      p.fromArray(points, i).applyMatrix4(this.space.matrixWorld);
      for (const [a, v] of [[0, p.x], [1, p.y], [2, p.z]]) { low[a] = Math.min(low[a], v); high[a] = Math.max(high[a], v); }
    }
    if (!points.length) this.joints.forEach((_, j) => { // a bare skeleton
      this.jointPosition(j, p);
      for (const [a, v] of [[0, p.x], [1, p.y], [2, p.z]]) { low[a] = Math.min(low[a], v); high[a] = Math.max(high[a], v); }
    });
    return [low, high];
  }
}

/** Largest side of the box about all points and centres; 1.75 when there is none. */
function extent(...arrays) {
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  for (const a of arrays) for (let i = 0; i < a.length; i++) { low[i % 3] = Math.min(low[i % 3], a[i]); high[i % 3] = Math.max(high[i % 3], a[i]); }
  const most = Math.max(...high.map((h, c) => h - low[c]));
  return most > 0 && Number.isFinite(most) ? most : 1.75;
}

function identity(J) {
  const out = new Float32Array(12 * J);
  for (let m = 0; m < out.length; m += 12) out[m] = out[m + 5] = out[m + 10] = 1;
  return out;
}

/** Lines along the edges of triangles (T*3), each once, on the positions of a geometry of N points. */
function outline(triangles, N, geometry) {
  const lines = new THREE.BufferGeometry(), seen = new Set(), index = [], t = triangles;
  for (let k = 0; k < t.length; k += 3) for (const [a, b] of [[t[k], t[k + 1]], [t[k + 1], t[k + 2]], [t[k + 2], t[k]]]) {
    const id = Math.min(a, b) * N + Math.max(a, b);
    if (!seen.has(id)) { seen.add(id); index.push(a, b); }
  }
  lines.setAttribute("position", geometry.attributes.position);
  return lines.setIndex(index);
}

/** Rows of 3x4 matrices: A B. */
function multiply(A, B, out) {
  for (let m = 0; m < A.length; m += 12) for (let r = 0; r < 12; r += 4) for (let c = 0; c < 4; c++) {
    out[m + r + c] = A[m + r] * B[m + c] + A[m + r + 1] * B[m + 4 + c] + A[m + r + 2] * B[m + 8 + c] + (c === 3 ? A[m + r + 3] : 0);
  }
  return out;
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
