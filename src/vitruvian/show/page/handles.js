// Handles on a figure that stands still: dragged, the body follows, solved on the server; held ones stay where they are.

import * as THREE from "three";
import { el } from "./controls.js";
import { fromQuaternion, toQuaternion } from "./pose.js";

const $ = (id) => document.getElementById(id);
const SVG = "http://www.w3.org/2000/svg";
const CLOSE = 0.0022; // metres of a pixel from which on fingers and toes have handles, on a body of 1.75 m
const PATIENCE = 1000; // ms until an answer is given up
const SHORT = 0.005; // metres that may be missing before it is said, on a body of 1.75 m
const WORDS = { l_hand: "left hand", r_hand: "right hand", l_foot: "left foot", r_foot: "right foot" };

export class Handles {
  constructor(page) {
    Object.assign(this, { page, on: false, figure: null, list: [], pins: new Map(), short: {}, goals: {}, drag: null, frame: -1 });
    $("handles").onclick = () => this.toggle();
    document.addEventListener("keydown", (e) => this.key(e), true); // before the page's own
  }

  /** A figure has come: handles need a server that solves. */
  show(figure) {
    const can = figure.isBody && figure.handles.length > 0 && Boolean(this.page.source?.live);
    $("handles").hidden = !can;
    Object.assign(this, { figure: can ? figure : null, drag: null, short: {} });
    this.pins.clear();
    const lines = document.createElementNS(SVG, "svg");
    lines.setAttribute("aria-hidden", "true");
    this.list = can ? figure.handles.map((h) => ({ ...h, button: this.button(h) })) : [];
    $("grips").replaceChildren(lines, ...this.list.map((h) => h.button));
    this.lines = lines;
    this.set(can && this.on);
  }

  button({ name, main }) {
    const button = el("button", main ? "grip" : "grip small"), words = WORDS[name] ?? name.replace(/_tip$/, "").replaceAll("_", " ");
    button.dataset.testid = `grip-${name}`;
    button.dataset.tip = `${words}: drag it; a click holds it where it is`;
    button.dataset.key = "arrows";
    button.setAttribute("aria-label", `${words}: arrow keys move it, Enter holds it where it is`);
    button.append(el("i"), el("span"));
    button.onpointerdown = (e) => this.down(e, name);
    button.onpointermove = (e) => this.move(e);
    button.onpointerup = (e) => this.up(e);
    button.onpointercancel = () => this.cancel();
    button.onkeydown = (e) => this.nudge(e, name);
    return button;
  }

  toggle() {
    if (!this.figure) return;
    this.set(!this.on);
    if (this.on && this.page.header.playing) this.page.source.pause();
  }

  set(on) {
    this.on = on;
    $("handles").setAttribute("aria-pressed", String(on));
    if (!on) { this.pins.clear(); this.short = {}; if (this.drag) this.cancel(); }
    this.draw();
  }

  // Dragging --------------------------------------------------------------------------------------------------------

  /** Where a handle is, in the world. */
  place(name) {
    const { joint, point } = this.list.find((h) => h.name === name);
    return this.figure.moved(joint, point);
  }

  begin(name) {
    const { figure } = this;
    this.drag = { name, id: Math.floor(Math.random() * 2 ** 40), before: this.state(), from: this.place(name), moved: false, waiting: false, next: null, released: false };
    this.short = {};
    this.goals = {};
    figure.group.updateMatrixWorld(true);
  }

  down(e, name) {
    if (this.drag || e.button) return;
    this.begin(name);
    Object.assign(this.drag, { pointer: e.pointerId, start: [e.clientX, e.clientY] });
    e.currentTarget.setPointerCapture(e.pointerId);
    e.stopPropagation();
  }

  move(e) {
    const { drag } = this;
    if (!drag || drag.pointer !== e.pointerId || drag.released) return;
    if (!drag.moved && Math.hypot(e.clientX - drag.start[0], e.clientY - drag.start[1]) < 4) return;
    drag.moved = true;
    this.aim(this.across(drag.from, e.clientX - drag.start[0], e.clientY - drag.start[1]));
  }

  up(e) {
    const { drag } = this;
    if (!drag || drag.pointer !== e.pointerId) return;
    if (!drag.moved) { this.drag = null; this.pin(drag.name); return; }
    drag.released = true;
    this.finish();
  }

  /** The world point so many pixels across the picture from another, in the plane that faces the camera. */
  across(from, x, y) {
    const { camera } = this.page.studio, metres = this.page.studio.pixel(from) * (camera.getWorldDirection(new THREE.Vector3()).dot(from.clone().sub(camera.position)) / camera.position.distanceTo(from));
    const right = new THREE.Vector3().setFromMatrixColumn(camera.matrixWorld, 0), up = new THREE.Vector3().setFromMatrixColumn(camera.matrixWorld, 1);
    return from.clone().addScaledVector(right, x * metres).addScaledVector(up, -y * metres);
  }

  /** Bring the dragged handle to a world point: one request at a time, the newest next. */
  aim(world) {
    const { drag, figure } = this, local = figure.space.worldToLocal(world.clone()).toArray();
    this.goals = { ...Object.fromEntries(this.pins), [drag.name]: local };
    drag.next = this.goals;
    this.ask();
  }

  ask() {
    const { drag, figure, page } = this;
    if (!drag?.next || (drag.waiting && performance.now() - drag.sent < PATIENCE)) return;
    Object.assign(drag, { waiting: true, sent: performance.now() });
    page.source.reach(figure.name, drag.name, drag.next, drag.id, figure.level);
    drag.next = null;
  }

  /** The server's answer. */
  reached({ gesture, actor, turns, shift, short }) {
    const { drag, figure, page } = this;
    if (!drag || drag.id !== gesture || figure.name !== actor) return;
    for (const name in turns) figure.turns.set(figure.joints.indexOf(name), fromQuaternion(turns[name]));
    if (shift) figure.shift = shift;
    this.short = short;
    this.took = performance.now() - drag.sent;
    drag.waiting = false;
    drag.done = true;
    page.refresh(figure);
    this.ask();
    this.finish();
  }

  /** When let go and nothing is on its way any more: one step that can be taken back. */
  finish() {
    const { drag, page } = this, late = drag?.waiting && performance.now() - drag.sent > PATIENCE;
    if (!drag?.released || drag.next || (drag.waiting && !late)) return;
    this.drag = null;
    if (!drag.done) return;
    const { before } = drag, after = this.state();
    if (this.pins.has(drag.name)) this.pins.set(drag.name, this.local(drag.name));
    page.history.push({ drag: true, undo: () => this.put(before), redo: () => this.put(after) });
  }

  cancel() {
    const { drag } = this;
    this.drag = null;
    if (drag?.done || drag?.waiting) this.put(drag.before);
    this.draw();
  }

  /** Turns by hand and the shift of the whole figure. */
  state() { return { turns: new Map(this.figure.turns), shift: this.figure.shift }; }

  put({ turns, shift }) {
    const { page } = this, { figure } = page, number = (x) => Number(x.toFixed(8));
    figure.turns = new Map(turns);
    figure.shift = shift;
    this.short = {};
    page.source.pose(figure.name, Object.fromEntries([...turns].map(([j, R]) => [figure.joints[j], toQuaternion(R).map(number)])), shift ?? [0, 0, 0]);
    page.refresh(figure);
    for (const name of this.pins.keys()) this.pins.set(name, this.local(name)); // stay held, where they are now
  }

  local(name) {
    this.figure.group.updateMatrixWorld(true);
    return this.figure.space.worldToLocal(this.place(name)).toArray();
  }

  /** Hold a handle where it is, or let it go. */
  pin(name) {
    if (!this.pins.delete(name)) this.pins.set(name, this.local(name));
    this.draw();
  }

  // Keys ------------------------------------------------------------------------------------------------------------

  key(e) {
    if (e.target.matches?.("input[type=search], input[type=text], input[type=number], textarea") || e.ctrlKey || e.metaKey || e.altKey) return;
    if (e.key === "@") this.toggle();
    else if (e.key !== "Escape" || !this.on) return;
    else if (this.drag) this.cancel();
    else if (this.page.history.done.at(-1)?.drag) this.page.history.undo();
    else return;
    e.preventDefault();
    e.stopPropagation();
  }

  /** Arrow keys move the handle across the picture by a centimetre, with Shift by five. */
  nudge(e, name) {
    const by = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[e.key];
    if (e.key === "Enter" || e.key === " ") this.pin(name);
    else if (!by) return;
    else if (!this.drag) {
      this.begin(name);
      const from = this.drag.from, step = (0.01 * (e.shiftKey ? 5 : 1) * this.unit) / this.page.studio.pixel(from);
      Object.assign(this.drag, { moved: true, released: true });
      this.aim(this.across(from, by[0] * step, by[1] * step));
    }
    e.preventDefault();
    e.stopPropagation();
  }

  // What is seen ----------------------------------------------------------------------------------------------------

  /** World metres of a metre on a body of 1.75 m. */
  get unit() { return (this.figure.stature / 1.75) * this.figure.space.matrixWorld.getMaxScaleOnAxis(); }

  get visible() { return this.on && Boolean(this.figure) && !this.page.header.playing && !this.page.compare.on; }

  draw() {
    const root = $("grips"), { figure, page, drag } = this, { studio, header } = page;
    root.hidden = !this.visible;
    if (root.hidden) return;
    if (drag?.released || drag?.next) { this.ask(); this.finish(); }
    if (header.frame !== this.frame) { this.frame = header.frame; this.pins.clear(); this.short = {}; } // they are of a moment
    const p = new THREE.Vector3(), scale = figure.stature / 1.75, mm = (1000 * this.unit) / scale, lines = [];
    for (const { name, joint, point, main, button } of this.list) {
      figure.moved(joint, point, p);
      const far = studio.pixel(p), [x, y] = studio.window(p.clone().project(studio.camera)), ahead = p.clone().project(studio.camera).z < 1;
      button.hidden = !ahead || (!main && far > CLOSE * this.unit && drag?.name !== name && !this.pins.has(name));
      if (button.hidden) continue;
      button.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px)`;
      const missing = this.short[name] > SHORT * scale ? this.short[name] : 0;
      button.setAttribute("aria-pressed", String(this.pins.has(name)));
      button.classList.toggle("short", missing > 0);
      button.classList.toggle("dragged", drag?.name === name);
      button.lastChild.textContent = missing ? `${Math.round(mm * missing)} mm short` : "";
      if (missing && this.goals[name]) {
        const goal = figure.space.localToWorld(p.fromArray(this.goals[name])).project(studio.camera), line = document.createElementNS(SVG, "line");
        [["x1", x], ["y1", y], ["x2", studio.window(goal)[0]], ["y2", studio.window(goal)[1]]].forEach(([k, v]) => line.setAttribute(k, v.toFixed(1)));
        lines.push(line);
      }
    }
    this.lines.replaceChildren(...lines);
  }

  get told() {
    if (!this.figure) return null;
    return {
      on: this.on, shown: this.visible ? this.list.filter((h) => !h.button.hidden).map((h) => h.name) : [], held: [...this.pins.keys()],
      dragging: this.drag?.name ?? null, short: { ...this.short }, took: this.took ?? null, shift: this.figure.shift,
      places: Object.fromEntries(this.list.map((h) => [h.name, this.local(h.name)])),
    };
  }
}
