// Skeleton and Sites drawn over a figure, names at the pointer, picking.

import * as THREE from "three";
import { center } from "./pose.js";

const SIDES = { l: "#58c4b8", r: "#f0a35e", m: "#8b80e0" }; // seen on skin and in both themes
const SELECTED = "#ffe14a";
const KINDS = { "feature point": "#b78cf2", "end effector": "#ff9d5c", viewpoint: "#5cc8ff", other: "#c9c4bd" };
const side = (name) => (/^(l_|left)/i.test(name) ? "l" : /^(r_|right)/i.test(name) ? "r" : "m");

export class Overlay {
  constructor(figure) {
    this.figure = figure;
    const look = (opacity) => new THREE.MeshBasicMaterial({ transparent: true, opacity, depthTest: false, depthWrite: false, toneMapped: false });
    this.sticks = new THREE.InstancedMesh(bone(), look(0.62), Math.max(1, figure.joints.length));
    this.dots = new THREE.InstancedMesh(new THREE.SphereGeometry(1, 10, 8), look(0.95), Math.max(1, figure.joints.length));
    this.pins = new THREE.InstancedMesh(new THREE.OctahedronGeometry(1), look(0.95), Math.max(1, figure.sites.length));
    this.pins.count = figure.sites.length;
    this.skeleton = new THREE.Group();
    this.skeleton.add(this.sticks, this.dots);
    for (const o of [this.sticks, this.dots, this.pins]) { o.frustumCulled = false; o.renderOrder = 5; }
    this.skeleton.visible = this.pins.visible = false;
    this.group = new THREE.Group();
    this.group.add(this.skeleton, this.pins);
    figure.space.add(this.group);
    this.site = -1;
    this.selected = -1;
    this.relevel();
    this.colorSites(-1);
  }

  /** Joints and bones of the level that the figure shows. */
  relevel() {
    const { kept, above } = this.figure;
    this.shown = [...kept.keys()].filter((j) => kept[j] === j);
    this.bones = this.shown.filter((j) => above[j] >= 0).map((j) => [above[j], j]);
    this.dots.count = this.shown.length;
    this.sticks.count = this.bones.length;
    this.size = this.sizes();
    this.color(this.selected);
  }

  colorSites(selected) {
    const c = new THREE.Color();
    this.site = selected;
    this.figure.sites.forEach(({ kind }, s) => this.pins.setColorAt(s, c.set(s === selected ? SELECTED : KINDS[kind] ?? KINDS.other)));
    if (this.pins.instanceColor) this.pins.instanceColor.needsUpdate = true;
  }

  /** Radius of each dot: smaller where bones are short, as in hands and the face. */
  sizes() {
    const { centers, above, joints, stature } = this.figure, unit = (this.unit = stature / 1.75), out = joints.map(() => 0.009 * unit);
    this.bones.forEach(([p, j]) => {
      const length = Math.hypot(...[0, 1, 2].map((c) => centers[3 * p + c] - centers[3 * j + c]));
      out[j] = Math.min(0.009 * unit, Math.max(0.0022 * unit, 0.09 * length));
    });
    for (const j of this.shown) if (above[j] < 0) out[j] = 0.011 * unit;
    return out;
  }

  color(selected) {
    const c = new THREE.Color(), { joints } = this.figure;
    this.selected = selected;
    this.shown.forEach((j, i) => this.dots.setColorAt(i, c.set(j === selected ? SELECTED : SIDES[side(joints[j])])));
    this.bones.forEach(([p, j], i) => this.sticks.setColorAt(i, c.set(p === selected ? SELECTED : SIDES[side(joints[j])])));
    for (const m of [this.dots, this.sticks]) if (m.instanceColor) m.instanceColor.needsUpdate = true;
  }

  /** `pixel` (world point) -> metres of a pixel there: dots and pins stay small near by. */
  update(pixel) {
    const { figure } = this, m = new THREE.Matrix4(), a = new THREE.Vector3(), b = new THREE.Vector3(), q = new THREE.Quaternion(), up = new THREE.Vector3(0, 1, 0), s = new THREE.Vector3();
    if (!this.skeleton.visible && !this.pins.visible) return;
    this.scale = 1 / (figure.space.matrixWorld.getMaxScaleOnAxis() || 1);
    if (this.skeleton.visible) {
      const at = figure.joints.map((_, j) => center(figure.pose, figure.centers, j));
      this.shown.forEach((j, i) => {
        const dot = this.scale * pixel(figure.jointPosition(j, a)), r = Math.max(1.5 * dot, Math.min(this.size[j], 7 * dot)) * (j === this.selected ? 1.6 : 1);
        this.dots.setMatrixAt(i, m.makeScale(r, r, r).setPosition(...at[j]));
      });
      this.bones.forEach(([p, j], i) => {
        a.fromArray(at[p]);
        b.fromArray(at[j]).sub(a);
        const length = b.length();
        const width = Math.min(0.1 * length, 0.022 * this.unit);
        q.setFromUnitVectors(up, length > 1e-6 ? b.divideScalar(length) : up);
        this.sticks.setMatrixAt(i, m.compose(a, q, s.set(width, Math.max(length, 1e-6), width)));
      });
      this.dots.instanceMatrix.needsUpdate = this.sticks.instanceMatrix.needsUpdate = true;
    }
    if (this.pins.visible) {
      const inverse = new THREE.Matrix4().copy(figure.space.matrixWorld).invert();
      figure.sites.forEach((_, i) => {
        const most = 5 * this.scale * pixel(figure.sitePosition(i, a)), r = Math.min(0.006 * this.unit, most) * (i === this.site ? 1.7 : 1);
        a.applyMatrix4(inverse);
        this.pins.setMatrixAt(i, m.makeScale(r, r, r).setPosition(a));
      });
      this.pins.instanceMatrix.needsUpdate = true;
    }
  }

  /** {kind, index, name, distance} of the nearest joint or site within 14 pixels of (x, y), or null. */
  nearest(x, y, camera, width, height) {
    const { figure } = this, p = new THREE.Vector3();
    let best = null;
    const look = (kind, indices, name, place) => indices.forEach((index) => {
      place(index, p).project(camera);
      if (p.z > 1) return;
      const distance = Math.hypot(((p.x + 1) / 2) * width - x, ((1 - p.y) / 2) * height - y);
      if (distance < 14 && distance < (best?.distance ?? 1e9)) best = { kind, index, name: name(index), distance };
    });
    if (this.skeleton.visible) look("joint", this.shown, (j) => figure.joints[j], (j, out) => figure.jointPosition(j, out));
    if (this.pins.visible) look("site", [...figure.sites.keys()], (s) => figure.sites[s].name, (s, out) => figure.sitePosition(s, out));
    return best;
  }
}

/** A bone from (0,0,0) to (0,1,0), thick near its head. */
function bone() {
  const g = new THREE.BufferGeometry(), y = 0.16;
  const p = [[0, 0, 0], [1, y, 0], [0, y, 1], [-1, y, 0], [0, y, -1], [0, 1, 0]];
  const t = [0, 1, 2, 0, 2, 3, 0, 3, 4, 0, 4, 1, 5, 2, 1, 5, 3, 2, 5, 4, 3, 5, 1, 4];
  g.setAttribute("position", new THREE.Float32BufferAttribute(p.flat(), 3));
  g.setIndex(t);
  g.computeVertexNormals();
  return g;
}

/** Joint with the largest weight where the ray through (x, y) meets the figure's skin, or -1. */
export function pick(figure, x, y, camera, width, height) {
  const ray = new THREE.Raycaster();
  ray.setFromCamera(new THREE.Vector2((x / width) * 2 - 1, 1 - (y / height) * 2), camera);
  const hit = ray.intersectObject(figure.mesh, false)[0];
  if (!hit || !figure.isBody) return -1;
  const owner = (figure.owner ??= figure.owners());
  return figure.kept[owner[figure.drawn[hit.face.a]]];
}
