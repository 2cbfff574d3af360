// Skeleton and Sites drawn over a figure, names at the pointer, picking.

import * as THREE from "three";
import { center } from "./pose.js";

const SIDES = { l: "#58c4b8", r: "#f0a35e", m: "#f4f1ea" };
const SELECTED = "#ffe14a";
const side = (name) => (/^(l_|left)/i.test(name) ? "l" : /^(r_|right)/i.test(name) ? "r" : "m");

export class Overlay {
  constructor(figure) {
    this.figure = figure;
    this.bones = [];
    figure.parents.forEach((p, j) => { if (p >= 0) this.bones.push([p, j]); });
    const look = (opacity) => new THREE.MeshBasicMaterial({ transparent: true, opacity, depthTest: false, depthWrite: false, toneMapped: false });
    this.sticks = new THREE.InstancedMesh(bone(), look(0.62), Math.max(1, this.bones.length));
    this.dots = new THREE.InstancedMesh(new THREE.SphereGeometry(1, 10, 8), look(0.95), Math.max(1, figure.joints.length));
    this.pins = new THREE.InstancedMesh(new THREE.OctahedronGeometry(1), look(0.95), Math.max(1, figure.sites.length));
    this.sticks.count = this.bones.length;
    this.dots.count = figure.joints.length;
    this.pins.count = figure.sites.length;
    this.skeleton = new THREE.Group();
    this.skeleton.add(this.sticks, this.dots);
    for (const o of [this.sticks, this.dots, this.pins]) { o.frustumCulled = false; o.renderOrder = 5; }
    this.skeleton.visible = this.pins.visible = false;
    this.group = new THREE.Group();
    this.group.add(this.skeleton, this.pins);
    figure.space.add(this.group);
    this.size = this.sizes();
    this.color(-1);
    const pin = new THREE.Color("#b78cf2");
    for (let s = 0; s < this.pins.count; s++) this.pins.setColorAt(s, pin);
  }

  /** Radius of each dot: smaller where bones are short, as in hands and the face. */
  sizes() {
    const { centers, parents, joints } = this.figure, out = joints.map(() => 0.009);
    this.bones.forEach(([p, j]) => {
      const length = Math.hypot(...[0, 1, 2].map((c) => centers[3 * p + c] - centers[3 * j + c]));
      out[j] = Math.min(0.009, Math.max(0.0022, 0.09 * length));
    });
    const roots = joints.map((_, j) => j).filter((j) => parents[j] < 0);
    for (const j of roots) out[j] = 0.011;
    return out;
  }

  color(selected) {
    const c = new THREE.Color(), { joints } = this.figure;
    this.selected = selected;
    joints.forEach((name, j) => this.dots.setColorAt(j, c.set(j === selected ? SELECTED : SIDES[side(name)])));
    this.bones.forEach(([p, j], i) => this.sticks.setColorAt(i, c.set(p === selected ? SELECTED : SIDES[side(joints[j])])));
    for (const m of [this.dots, this.sticks]) if (m.instanceColor) m.instanceColor.needsUpdate = true;
  }

  update() {
    const { figure } = this, m = new THREE.Matrix4(), a = new THREE.Vector3(), b = new THREE.Vector3(), q = new THREE.Quaternion(), up = new THREE.Vector3(0, 1, 0), s = new THREE.Vector3();
    if (this.skeleton.visible) {
      const at = figure.joints.map((_, j) => center(figure.pose, figure.centers, j));
      at.forEach((x, j) => {
        const r = this.size[j] * (j === this.selected ? 1.6 : 1);
        this.dots.setMatrixAt(j, m.makeScale(r, r, r).setPosition(...x));
      });
      this.bones.forEach(([p, j], i) => {
        a.fromArray(at[p]);
        b.fromArray(at[j]).sub(a);
        const length = b.length();
        const width = Math.min(0.1 * length, 0.022);
        q.setFromUnitVectors(up, length > 1e-6 ? b.divideScalar(length) : up);
        this.sticks.setMatrixAt(i, m.compose(a, q, s.set(width, Math.max(length, 1e-6), width)));
      });
      this.dots.instanceMatrix.needsUpdate = this.sticks.instanceMatrix.needsUpdate = true;
    }
    if (this.pins.visible) {
      const inverse = new THREE.Matrix4().copy(figure.space.matrixWorld).invert();
      figure.sites.forEach((_, i) => {
        figure.sitePosition(i, a).applyMatrix4(inverse);
        this.pins.setMatrixAt(i, m.makeScale(0.006, 0.006, 0.006).setPosition(a));
      });
      this.pins.instanceMatrix.needsUpdate = true;
    }
  }

  /** {kind, index, name, distance} of the nearest joint or site within 14 pixels of (x, y), or null. */
  nearest(x, y, camera, width, height) {
    const { figure } = this, p = new THREE.Vector3();
    let best = null;
    const look = (kind, names, place) => names.forEach((name, index) => {
      place(index, p).project(camera);
      if (p.z > 1) return;
      const distance = Math.hypot(((p.x + 1) / 2) * width - x, ((1 - p.y) / 2) * height - y);
      if (distance < 14 && distance < (best?.distance ?? 1e9)) best = { kind, index, name, distance };
    });
    if (this.skeleton.visible) look("joint", figure.joints, (j, out) => figure.jointPosition(j, out));
    if (this.pins.visible) look("site", figure.sites.map((s) => s.name), (s, out) => figure.sitePosition(s, out));
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
  return owner[figure.drawn[hit.face.a]];
}
