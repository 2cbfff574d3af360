// Markers of a capture: where they were measured, where they sit on the body, and the lines between, coloured by length.

import * as THREE from "three";
import { css, oklch } from "./colors.js";
import { keys } from "./controls.js";

const $ = (id) => document.getElementById(id);
const MOST = 40; // mm at the end of the colour bar
const RAMP = Array.from({ length: 64 }, (_, i) => oklch(0.84 - 0.26 * (i / 63), 0.17, 150 - 122 * (i / 63))); // green to red
const colorOf = (mm) => RAMP[Math.round(63 * Math.min(1, mm / MOST))];
const UP = new THREE.Vector3(0, 1, 0);

export class Marks {
  constructor(page) {
    Object.assign(this, { page, on: true, figure: null });
    $("marks").onclick = () => this.set(!this.on);
    keys({ "%": () => this.figure && this.set(!this.on) });
    $("marks-ramp").style.background = `linear-gradient(to right, ${RAMP.map(css).join(", ")})`;
  }

  /** The figure with markers among those that have arrived, if there is one. */
  arrive() {
    this.figure = [...this.page.figures.values()].find((f) => f.marks) ?? null;
    $("marks").hidden = !this.figure;
    if (this.figure) this.build(this.figure.marks.names.length);
    this.set(this.on);
  }

  build(count) {
    const look = (color, opacity = 1) => new THREE.MeshBasicMaterial({ color, transparent: true, opacity, depthTest: false, depthWrite: false, toneMapped: false });
    const many = (shape, material, order) => Object.assign(new THREE.InstancedMesh(shape, material, Math.max(1, count)), { frustumCulled: false, renderOrder: order });
    const ball = new THREE.SphereGeometry(1, 12, 9), rod = new THREE.CylinderGeometry(1, 1, 1, 6).translate(0, 0.5, 0);
    this.seats = many(ball, look("#17181a", 0.8), 6);
    this.lines = many(rod, look("#fff"), 7);
    this.balls = many(ball, look("#fff"), 8);
    this.group = new THREE.Group();
    this.group.add(this.seats, this.lines, this.balls);
    this.figure.space.add(this.group);
  }

  set(on) {
    this.on = on;
    $("marks").setAttribute("aria-pressed", String(on));
    $("marks-legend").hidden = !this.figure || !on;
    if (this.group) this.group.visible = on;
    this.page.changed = true;
  }

  /** [{name, at, seat, mm}] of the markers that are there now; places in humanoid space. */
  present() {
    const { names, joint, point, now } = this.figure.marks, M = this.figure.pose, out = [];
    if (!now) return out;
    names.forEach((name, k) => {
      const at = [now[3 * k], now[3 * k + 1], now[3 * k + 2]], m = 12 * joint[k];
      if (!at.every(Number.isFinite)) return;
      const seat = [0, 4, 8].map((r) => M[m + r] * point[3 * k] + M[m + r + 1] * point[3 * k + 1] + M[m + r + 2] * point[3 * k + 2] + M[m + r + 3]);
      out.push({ name, at, seat, mm: 1000 * Math.hypot(at[0] - seat[0], at[1] - seat[1], at[2] - seat[2]) });
    });
    return out;
  }

  update() {
    const { figure, page } = this;
    if (!figure || !this.on) return;
    const all = (this.all = this.present()), m = new THREE.Matrix4(), a = new THREE.Vector3(), b = new THREE.Vector3(), q = new THREE.Quaternion(), s = new THREE.Vector3(), c = new THREE.Color();
    const unit = figure.stature / 1.75, scale = 1 / (figure.space.matrixWorld.getMaxScaleOnAxis() || 1);
    all.forEach(({ at, seat, mm }, k) => {
      a.fromArray(at).applyMatrix4(figure.space.matrixWorld);
      const pixel = scale * page.studio.pixel(a), r = Math.max(3 * pixel, Math.min(0.01 * unit, 7 * pixel)), width = Math.max(0.9 * pixel, 0.3 * r);
      c.setRGB(...colorOf(mm), THREE.SRGBColorSpace);
      this.balls.setMatrixAt(k, m.makeScale(r, r, r).setPosition(...at));
      this.balls.setColorAt(k, c);
      this.seats.setMatrixAt(k, m.makeScale(0.6 * r, 0.6 * r, 0.6 * r).setPosition(...seat));
      b.fromArray(at).sub(a.fromArray(seat));
      const length = b.length();
      q.setFromUnitVectors(UP, length > 1e-9 ? b.divideScalar(length) : UP);
      this.lines.setMatrixAt(k, m.compose(a, q, s.set(width, Math.max(length, 1e-9), width)));
      this.lines.setColorAt(k, c);
    });
    for (const o of [this.balls, this.seats, this.lines]) {
      o.count = all.length;
      o.instanceMatrix.needsUpdate = true;
      if (o.instanceColor) o.instanceColor.needsUpdate = true;
    }
    this.say(all);
  }

  say(all) {
    const count = this.figure.marks.names.length, worst = all.reduce((x, y) => (x && x.mm > y.mm ? x : y), null), rms = Math.sqrt(all.reduce((sum, x) => sum + x.mm ** 2, 0) / (all.length || 1));
    const text = worst ? `${all.length} of ${count} there \u00b7 rms ${rms.toFixed(1)} mm \u00b7 most ${worst.name} ${worst.mm.toFixed(1)}` : `none of ${count} there in this frame`;
    if ($("marks-said").textContent !== text) $("marks-said").textContent = text;
  }

  /** The marker within 12 pixels of a point of the window, or null. */
  nearest(x, y) {
    if (!this.figure || !this.on || this.page.compare.on) return null;
    let best = null;
    for (const { name, at, mm } of this.all ?? []) {
      const p = new THREE.Vector3(...at).applyMatrix4(this.figure.space.matrixWorld).project(this.page.studio.camera), [u, v] = this.page.studio.window(p), distance = Math.hypot(u - x, v - y);
      if (p.z < 1 && distance < (best?.distance ?? 12)) best = { kind: "marker", name: `${name} \u00b7 ${mm.toFixed(1)} mm`, distance };
    }
    return best;
  }

  get told() { return this.figure && { on: this.on, there: this.present().map(({ name, mm }) => ({ name, mm })) }; }
}
