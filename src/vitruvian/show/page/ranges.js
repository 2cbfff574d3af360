// The limits of the selected joint drawn around it: one fan per axis, a needle at the present angle.
// Angles are those of the sliders: R = Rx Ry Rz in the frame of the limit orientation, so that the y axis is drawn turned
// by x, and the z axis by x and y.

import * as THREE from "three";
import { apply3, multiply3 } from "./deform.js";
import { center, fromAngles, rotationOf } from "./pose.js";

export const AXIS = ["#ff6f61", "#7fd17f", "#64a8ff"];
const OVER = "#ff3b30";
const STEPS = 48;

/** A flat ring sector whose points are moved when it changes. */
class Sector {
  constructor(color, opacity, order) {
    const geometry = new THREE.BufferGeometry(), index = [];
    geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(6 * (STEPS + 1)), 3).setUsage(THREE.DynamicDrawUsage));
    for (let i = 0; i < STEPS; i++) index.push(2 * i, 2 * i + 1, 2 * i + 2, 2 * i + 1, 2 * i + 3, 2 * i + 2);
    geometry.setIndex(index);
    const look = { color, opacity, transparent: true, depthTest: false, depthWrite: false, toneMapped: false, side: THREE.DoubleSide };
    this.mesh = new THREE.Mesh(geometry, new THREE.MeshBasicMaterial(look));
    Object.assign(this.mesh, { frustumCulled: false, renderOrder: order });
  }

  /** Angles `from` to `to` (radians) from u towards v, radii r0 to r1, about c. */
  set(c, u, v, from, to, r0, r1) {
    const { array } = this.mesh.geometry.attributes.position;
    for (let i = 0, k = 0; i <= STEPS; i++) {
      const t = from + ((to - from) * i) / STEPS, x = Math.cos(t), y = Math.sin(t);
      for (const r of [r0, r1]) for (let a = 0; a < 3; a++) array[k++] = c[a] + r * (x * u[a] + y * v[a]);
    }
    this.mesh.geometry.attributes.position.needsUpdate = true;
    this.mesh.visible = true;
  }
}

export class Ranges {
  constructor() {
    this.group = new THREE.Group();
    this.axes = AXIS.map((color) => ({
      fan: new Sector(color, 0.27, 6), rim: new Sector(color, 0.9, 7), over: new Sector(OVER, 0.55, 8), needle: new Sector(color, 1, 9),
    }));
    for (const axis of this.axes) this.group.add(...Object.values(axis).map((s) => s.mesh));
    this.group.visible = false;
  }

  /** Draw for joint j of `figure`: `angles` in degrees, `limit(a)` in degrees or null, F its limit orientation (9). */
  draw(figure, j, angles, limit, F) {
    if (this.group.parent !== figure.space) figure.space.add(this.group);
    const { pose, centers, above, stature } = figure, c = center(pose, centers, j), r = radius(figure, j), bone = boneOf(figure, j);
    const x = angles.map((d) => (d * Math.PI) / 180), G = multiply3(rotationOf(pose, above[j]), F);
    const frames = [G, multiply3(G, fromAngles([x[0], 0, 0])), multiply3(G, fromAngles([x[0], x[1], 0]))];
    this.axes.forEach((axis, a) => {
      const e = [0, 1, 2].map((i) => Number(i === a)), zero = reference(bone, F, a), turned = cross(e, zero);
      const u = apply3(frames[a], zero), v = apply3(frames[a], turned), range = limit(a)?.map((d) => (d * Math.PI) / 180), size = r * (1 - 0.08 * a);
      const width = Math.max(0.05 * size, 0.0012 * (stature / 1.75)), t = x[a], half = 0.6 * width / size;
      axis.fan.mesh.visible = axis.over.mesh.visible = false;
      axis.rim.mesh.material.opacity = range ? 0.9 : 0.35;
      const wide = range && range[1] - range[0] > 2 * Math.PI ? [-Math.PI, Math.PI] : range;
      axis.rim.set(c, u, v, ...(wide ?? [-Math.PI, Math.PI]), size - width, size);
      const low = range && t < range[0] - 1e-3, high = range && t > range[1] + 1e-3;
      if (wide) axis.fan.set(c, u, v, ...wide, 0, size - width);
      if (low || high) axis.over.set(c, u, v, low ? t : range[1], low ? range[0] : t, 0, size);
      axis.needle.mesh.material.color.set(low || high ? OVER : AXIS[a]);
      axis.needle.set(c, u, v, t - half, t + half, 0, 1.12 * size);
    });
  }
}

const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

/** From the joint's centre at rest to the first one below it, or on from the one above. */
function boneOf({ centers, above, kept, stature }, j) {
  const at = (i) => [0, 1, 2].map((c) => centers[3 * i + c]), minus = (a, b) => a.map((x, c) => x - b[c]), long = (d) => Math.hypot(...d) > 1e-3 * stature;
  for (let k = 0; k < above.length; k++) if (kept[k] === k && above[k] === j && long(minus(at(k), at(j)))) return minus(at(k), at(j));
  const on = above[j] >= 0 ? minus(at(j), at(above[j])) : [0, 0, 0];
  return long(on) ? on : [0, 0.05 * stature, 0];
}

/** Radius of the fans: most of the bone, neither tiny nor huge. */
function radius(figure, j) {
  return Math.min(0.09 * figure.stature, Math.max(0.012 * figure.stature, 0.62 * Math.hypot(...boneOf(figure, j))));
}

/** Unit direction at angle 0 in the plane about axis `a`: the bone's, or forwards where the bone lies along the axis. */
function reference(bone, F, a) {
  const back = (d) => [0, 1, 2].map((i) => F[i] * d[0] + F[3 + i] * d[1] + F[6 + i] * d[2]), least = 0.3 * Math.hypot(...bone);
  for (const [d, need] of [[back(bone), least], [back([0, 0, 1]), 0.3], [back([1, 0, 0]), 0.3]]) {
    const flat = d.map((x, i) => (i === a ? 0 : x)), n = Math.hypot(...flat);
    if (n > need) return flat.map((x) => x / n);
  }
  return [0, 1, 2].map((i) => Number(i === (a + 1) % 3));
}
