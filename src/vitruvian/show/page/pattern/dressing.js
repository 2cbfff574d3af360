// The body with the panels around it, and the garment as it falls. Metres, H-Anim's axes.

import * as THREE from "three";
import { RAMP, oklch, toLinear } from "../colors.js";
import { meshNormals, welded } from "../mesh.js";
import { Studio } from "../studio.js";
import { positions } from "../wire.js";
import { seamRgb } from "./drawing.js";
import { area, box, loops, mix, outline, sidePoints } from "./geometry.js";
import { panelOf } from "./shaping.js";

const SKIN = "#a79c92", THREADS = 9, TIGHT = 0.1; // threads of a seam; strain at the end of the colours
const linear = (rgb) => rgb.map(toLinear);
const dyed = (k) => linear(oklch(0.72, 0.085, (85 + k * 137.508) % 360)); // the colour of a panel under the lights of the studio

export class Dressing {
  constructor(canvas, desk) {
    Object.assign(this, { canvas, desk, panels: new Map(), mode: "move", shown: "panels", map: false, stale: true });
    this.studio = new Studio(canvas);
    this.group = new THREE.Group();
    this.cloth = null;
    this.studio.scene.add(this.group);
    this.threads = new THREE.LineSegments(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ vertexColors: true, transparent: true, opacity: 0.9 }));
    this.threads.frustumCulled = false;
    this.group.add(this.threads);
    this.ray = new THREE.Raycaster();
    desk.on("drawn", () => { this.old = true; });
    desk.on("selected", () => { this.old = true; });
    desk.on("body", (_, arrays) => this.body(arrays));
    desk.on("fall", (header, arrays) => this.fall(header, arrays));
    desk.on("stride", (_, arrays) => this.stride(arrays));
    desk.on("drape", (header, arrays) => { if (header.state === "done") this.fall(header, arrays); });
    canvas.addEventListener("pointerdown", (e) => this.down(e), { capture: true });
    canvas.addEventListener("pointermove", (e) => this.move(e));
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => this.up());
  }

  body(arrays) {
    const points = arrays.vertices.array, triangles = arrays.triangles.array, geometry = new THREE.BufferGeometry(), normals = new Float32Array(points.length);
    meshNormals(points, triangles, welded(points, 0), normals);
    geometry.setAttribute("position", new THREE.BufferAttribute(points.slice(), 3));
    geometry.setAttribute("normal", new THREE.BufferAttribute(normals, 3));
    geometry.setIndex(new THREE.BufferAttribute(triangles.slice(), 1));
    if (this.figure) this.studio.scene.remove(this.figure);
    this.same = null;
    this.figure = new THREE.Mesh(geometry, new THREE.MeshStandardMaterial({ color: SKIN, roughness: 0.62, metalness: 0 }));
    Object.assign(this.figure, { castShadow: true, receiveShadow: true });
    this.studio.scene.add(this.figure);
    geometry.computeBoundingBox();
    const { min, max } = geometry.boundingBox;
    if (!this.studio.box) this.studio.frame(min.toArray(), max.toArray());
    this.studio.shade([0.05, 0.35, 0.65, 0.9].flatMap((s) => [-0.1, 0.1].map((x) => [x, s * max.y + 0.02, 0, 0.1])));
    this.stale = true;
  }

  // Panels ------------------------------------------------------------------------------------------------------------

  /** Make the panels anew whose shape or place has changed. */
  update() {
    this.old = false;
    this.stale = true;
    const { desk } = this, { doc, selection } = desk, kept = new Set();
    const flat = this.shown === "panels" || !this.cloth;
    this.group.visible = flat;
    if (this.cloth) this.cloth.visible = !flat;
    doc.panels.forEach((panel, k) => {
      if (!panel.rotation) return;
      kept.add(panel.name);
      const key = JSON.stringify([panel.vertices, panel.edges, k]), had = this.panels.get(panel.name);
      let mesh = had;
      if (had?.userData.key !== key) {
        if (had) this.drop(panel.name);
        mesh = this.cut(panel, k);
        mesh.userData = { key, name: panel.name };
        this.panels.set(panel.name, mesh);
        this.group.add(mesh);
      }
      const r = panel.rotation, t = panel.translation;
      mesh.matrix.set(...r[0], t[0], ...r[1], t[1], ...r[2], t[2], 0, 0, 0, 1);
      mesh.matrixAutoUpdate = false;
      const chosen = selection?.panel === panel.name;
      mesh.material.emissive.setRGB(...(chosen ? [0.015, 0.06, 0.05] : [0, 0, 0]));
      mesh.children[0].material.color.set(chosen ? "#8fd0c8" : "#3a3632");
    });
    for (const name of [...this.panels.keys()]) if (!kept.has(name)) this.drop(name);
    this.sew(doc);
  }

  drop(name) {
    const mesh = this.panels.get(name);
    this.group.remove(mesh);
    mesh.geometry.dispose();
    mesh.material.dispose();
    this.panels.delete(name);
  }

  cut(panel, k) {
    const [first = [], ...holes] = loops(panel).map((loop) => outline(panel, loop, 0.012).map((p) => new THREE.Vector2(...p)));
    const all = [first, ...holes].flat(), faces = first.length > 2 ? THREE.ShapeUtils.triangulateShape(first, holes) : [];
    const geometry = new THREE.BufferGeometry(), out = Math.sign(area(panel)) || 1;
    geometry.setAttribute("position", new THREE.Float32BufferAttribute(all.flatMap((p) => [p.x, p.y, 0]), 3));
    geometry.setAttribute("normal", new THREE.Float32BufferAttribute(all.flatMap(() => [0, 0, out]), 3));
    const up = (a, b, c) => (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x);
    geometry.setIndex(faces.flatMap(([a, b, c]) => (up(all[a], all[b], all[c]) * out > 0 ? [a, b, c] : [a, c, b])));
    const mesh = new THREE.Mesh(geometry, new THREE.MeshStandardMaterial({ roughness: 0.8, side: THREE.DoubleSide, transparent: true, opacity: 0.96 }));
    mesh.material.color.setRGB(...dyed(k));
    const rim = [first, ...holes].flatMap((loop) => loop.flatMap((p, n) => { const q = loop[(n + 1) % loop.length]; return [p.x, p.y, 0, q.x, q.y, 0]; }));
    const lines = new THREE.BufferGeometry();
    lines.setAttribute("position", new THREE.Float32BufferAttribute(rim, 3));
    mesh.add(new THREE.LineSegments(lines, new THREE.LineBasicMaterial({ color: "#3a3632" })));
    mesh.castShadow = true;
    return mesh;
  }

  /** A point of a panel in the world. */
  world(panel, [u, v]) { const { rotation: r, translation: t } = panel; return [0, 1, 2].map((k) => r[k][0] * u + r[k][1] * v + t[k]); }

  sew(doc) {
    const { selection } = this.desk, at = [], colors = [], ts = Array.from({ length: THREADS }, (_, k) => k / (THREADS - 1));
    doc.seams.forEach((seam, k) => {
      const a = sidePoints(doc.panels, seam.a, ts), b = sidePoints(doc.panels, seam.b, seam.reversed ? ts.map((t) => 1 - t) : ts);
      const c = linear(seamRgb(k)), dim = selection?.kind === "seam" && selection.index !== k ? 0.35 : 1;
      a.forEach((p, n) => {
        if (!p?.panel.rotation || !b[n]?.panel.rotation) return;
        at.push(...this.world(p.panel, p.point), ...this.world(b[n].panel, b[n].point));
        for (let m = 0; m < 2; m++) colors.push(...c.map((x) => x * dim));
      });
    });
    const g = new THREE.BufferGeometry();
    g.setAttribute("position", new THREE.Float32BufferAttribute(at, 3));
    g.setAttribute("color", new THREE.Float32BufferAttribute(colors, 3));
    this.threads.geometry.dispose();
    this.threads.geometry = g;
  }

  // The garment -------------------------------------------------------------------------------------------------------

  /** Cloth that moves, or hangs. */
  fall(header, arrays) {
    const count = arrays.vertices.shape[0], triangles = arrays.triangles.array;
    if (!this.cloth) {
      this.cloth = new THREE.Mesh(new THREE.BufferGeometry(), new THREE.MeshStandardMaterial({ vertexColors: true, roughness: 0.85, side: THREE.DoubleSide }));
      Object.assign(this.cloth, { frustumCulled: false, castShadow: true, receiveShadow: true });
      this.studio.scene.add(this.cloth);
    }
    this.count = count;
    this.lay(arrays.vertices, triangles);
    this.worn = { triangles: triangles.slice(), panel: arrays.panel.array.slice(), strain: arrays.strain?.array.slice() };
    this.paint();
    this.show("worn");
  }

  /** Put the cloth where its vertices are: corners of their own, as panels have colours of their own. */
  lay(vertices, triangles) {
    const { geometry } = this.cloth, count = vertices.shape[0], points = new Float32Array(3 * count), normals = new Float32Array(3 * count);
    positions(vertices, points);
    meshNormals(points, triangles, Uint32Array.from({ length: count }, (_, v) => v), normals);
    if (geometry.attributes.position?.count !== triangles.length) {
      for (const name of ["position", "normal", "color"]) geometry.setAttribute(name, new THREE.BufferAttribute(new Float32Array(3 * triangles.length).fill(0.72), 3));
    }
    for (const [name, of] of [["position", points], ["normal", normals]]) {
      const attribute = geometry.attributes[name], to = attribute.array;
      triangles.forEach((v, k) => { for (let j = 0; j < 3; j++) to[3 * k + j] = of[3 * v + j]; });
      attribute.needsUpdate = true;
    }
  }

  /** For scripts: a point of the body, and the middle of the cloth. */
  get hangs() {
    const of = this.figure?.geometry.attributes.position, cloth = this.cloth?.geometry.attributes.position, at = of && of.count >> 1;
    const middle = (a, k) => { let sum = 0; for (let i = k; i < a.length; i += 3) sum += a[i]; return (3 * sum) / a.length; };
    return { body: of && [of.getX(at), of.getY(at), of.getZ(at)], cloth: cloth && [0, 1, 2].map((k) => middle(cloth.array, k)) };
  }

  /** The body walks, and the garment with it. */
  stride(arrays) {
    if (!this.figure || !this.cloth || arrays.vertices.shape[0] !== this.count) return;
    const { geometry } = this.figure, { position, normal } = geometry.attributes;
    positions(arrays.body, position.array);
    meshNormals(position.array, geometry.index.array, (this.same ??= welded(position.array, 0)), normal.array);
    this.lay(arrays.vertices, this.worn.triangles);
    position.needsUpdate = normal.needsUpdate = true;
    this.stale = true;
  }

  /** Colours of the garment: its panels', or how much it is stretched. */
  paint() {
    if (!this.cloth) return;
    const { worn } = this, color = this.cloth.geometry.attributes.color.array;
    if (this.map && worn.strain) {
      const ramp = RAMP.map(linear);
      worn.triangles.forEach((v, n) => color.set(ramp[Math.min(255, Math.round((255 * worn.strain[v]) / TIGHT))], 3 * n));
    } else {
      const of = this.desk.doc.panels.map((_, k) => dyed(k));
      worn.panel.forEach((p, t) => { for (let j = 0; j < 3; j++) color.set(of[p] ?? [0.7, 0.7, 0.7], 9 * t + 3 * j); });
    }
    this.cloth.geometry.attributes.color.needsUpdate = true;
    this.stale = true;
  }

  show(what) {
    if (what === "worn" && !this.cloth) return;
    const changed = this.shown !== what;
    this.shown = what;
    this.old = true;
    if (changed) this.desk.tell("shown", what);
  }

  // The pointer -------------------------------------------------------------------------------------------------------

  aim(e) {
    const edge = this.canvas.getBoundingClientRect(), x = ((e.clientX - edge.left) / edge.width) * 2 - 1, y = 1 - ((e.clientY - edge.top) / edge.height) * 2;
    this.ray.setFromCamera(new THREE.Vector2(x, y), this.studio.camera);
    return this.ray.ray;
  }

  /** The panel under the pointer that is nearest, unless the body is before it. */
  under(e) {
    this.aim(e);
    if (this.shown !== "panels") return null;
    const hit = this.ray.intersectObjects([...this.panels.values()], false)[0];
    return hit ? { name: hit.object.userData.name, point: hit.point } : null;
  }

  down(e) {
    if (e.button !== 0) return;
    const hit = this.under(e);
    if (!hit) { this.click = { x: e.clientX, y: e.clientY }; return; }
    e.stopImmediatePropagation(); // the camera stays
    this.canvas.setPointerCapture(e.pointerId);
    this.desk.select({ panel: hit.name, kind: "panel" });
    const mode = e.shiftKey ? "around" : e.altKey ? "turn" : this.mode, way = this.studio.camera.getWorldDirection(new THREE.Vector3());
    this.gesture = { name: hit.name, mode, start: hit.point, x: e.clientX, y: e.clientY, plane: new THREE.Plane().setFromNormalAndCoplanarPoint(way, hit.point), way, moved: false };
  }

  move(e) {
    const g = this.gesture;
    if (!g) { this.canvas.style.cursor = e.buttons ? "" : this.under(e) ? "move" : ""; return; }
    if (!g.moved) {
      if (Math.hypot(e.clientX - g.x, e.clientY - g.y) < 3) return;
      g.moved = true;
      this.desk.grasp();
    }
    const to = this.aim(e).intersectPlane(g.plane, new THREE.Vector3());
    if (!to) return;
    this.desk.drag((doc) => {
      const panel = panelOf(doc, g.name);
      if (g.mode === "move") panel.translation = panel.translation.map((x, k) => x + to.getComponent(k) - g.start.getComponent(k));
      else if (g.mode === "around") {
        const angle = (e.clientX - g.x) / 120, up = to.y - g.start.y;
        swing(panel, new THREE.Vector3(0, 1, 0), new THREE.Vector3(), angle);
        panel.translation[1] += up;
      } else swing(panel, g.way.clone().negate(), this.middle(panel), -(e.clientX - g.x) / 150);
    });
  }

  up() {
    if (this.gesture?.moved) this.desk.release();
    this.gesture = null;
  }

  cancel() {
    if (!this.gesture?.moved) return false;
    this.gesture = null;
    this.desk.release(false);
    return true;
  }

  /** Middle of a panel in the world. */
  middle(panel) { return new THREE.Vector3(...this.world(panel, mix(...box(panel), 0.5))); }

  draw(dt) {
    if (this.old && this.desk.doc) this.update();
    const drew = this.studio.draw(dt, this.stale);
    this.stale = false;
    return drew;
  }
}

/** Turn a panel in the world about an axis through a point. */
export function swing(panel, axis, point, angle) {
  const turn = new THREE.Matrix4().makeRotationAxis(axis.normalize(), angle);
  const columns = [0, 1, 2].map((j) => new THREE.Vector3(...[0, 1, 2].map((i) => panel.rotation[i][j])).applyMatrix4(turn));
  panel.rotation = [0, 1, 2].map((i) => columns.map((c) => c.getComponent(i)));
  panel.translation = new THREE.Vector3(...panel.translation).sub(point).applyMatrix4(turn).add(point).toArray();
}

/** Turn a panel's other face outwards, about the vertical through its middle. */
export function flip(panel) {
  const [low, high] = box(panel), [u, v] = mix(low, high, 0.5), { rotation: r, translation: t } = panel;
  const middle = new THREE.Vector3(...[0, 1, 2].map((k) => r[k][0] * u + r[k][1] * v + t[k]));
  swing(panel, new THREE.Vector3(...[0, 1, 2].map((k) => r[k][1])), middle, Math.PI);
}

/** A place around the body for a panel that has none: before its chest. */
export const standing = { rotation: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], translation: [0, 1.15, 0.25] };
