// The drawing board: where panels lie on it, what is under the pointer, pan and zoom. What the pointer does is up to the
// tool in hand, see tools.js; what it looks like is drawn by drawing.js.

import { add, along, area, box, controls, inside, loops, mix, nearest, outline, sub, turned } from "./geometry.js";
import { Drawing } from "./drawing.js";
import { drawing } from "./shaping.js";

const NEAR = 8; // pixels
const CLOSEST = 20000, FARTHEST = 60; // pixels a metre

export class Board {
  constructor(canvas, desk) {
    Object.assign(this, { canvas, desk, view: { x: 0.4, y: 0, k: 500 }, hover: null, tool: null, stale: true });
    this.picture = new Drawing(this);
    this.shapes = new Map(); // panel -> {key, outlines}: polygons of its loops, made once for each shape
    new ResizeObserver(() => { this.stale = true; }).observe(canvas);
    const on = (name, act) => canvas.addEventListener(name, act);
    on("pointerdown", (e) => this.down(e));
    on("pointermove", (e) => this.move(e));
    on("pointerup", (e) => this.up(e));
    on("pointercancel", (e) => this.up(e));
    on("pointerleave", () => { this.hover = null; this.pointer = null; this.stale = true; });
    on("dblclick", (e) => this.tool?.twice?.(this.event(e)));
    on("wheel", (e) => this.wheel(e), { passive: false });
    on("contextmenu", (e) => e.preventDefault());
    canvas.addEventListener("wheel", (e) => e.preventDefault(), { passive: false });
    for (const what of ["drawn", "selected", "findings"]) desk.on(what, () => { this.stale = true; });
  }

  // Places ------------------------------------------------------------------------------------------------------------

  get width() { return this.canvas.clientWidth; }
  get height() { return this.canvas.clientHeight; }

  /** Pixels of a place on the board, metres. */
  pixel([x, y]) { const { view } = this; return [this.width / 2 + (x - view.x) * view.k, this.height / 2 - (y - view.y) * view.k]; }

  place([px, py]) { const { view } = this; return [view.x + (px - this.width / 2) / view.k, view.y - (py - this.height / 2) / view.k]; }

  where(panel) { return drawing(this.desk.doc).board[panel.name] ?? [0, 0, 0]; }

  /** A point of a panel on the board, and back. */
  lay(panel, p) { const [x, y, turn] = this.where(panel); return add(turned(p, turn), [x, y]); }
  lift(panel, q) { const [x, y, turn] = this.where(panel); return turned(sub(q, [x, y]), -turn); }

  /** Where a point of a panel is on the screen. */
  screen(panel, p) { return this.pixel(this.lay(panel, p)); }

  /** Polygons of a panel's loops in its own plane. */
  outlines(panel) {
    const key = JSON.stringify([panel.vertices, panel.edges]), kept = this.shapes.get(panel.name);
    if (kept?.key === key) return kept.outlines;
    const outlines = loops(panel).map((loop) => outline(panel, loop, 0.004));
    this.shapes.set(panel.name, { key, outlines });
    return outlines;
  }

  /** Box of everything on the board. */
  extent() {
    const points = this.desk.doc.panels.flatMap((p) => this.outlines(p).flat().map((q) => this.lay(p, q)));
    if (!points.length) return [[-0.3, -0.3], [0.7, 0.5]];
    return [[0, 1].map((k) => Math.min(...points.map((p) => p[k]))), [0, 1].map((k) => Math.max(...points.map((p) => p[k])))];
  }

  fit(panels = null) {
    const points = panels?.flatMap((p) => this.outlines(p).flat().map((q) => this.lay(p, q)));
    const [low, high] = points?.length ? [[0, 1].map((k) => Math.min(...points.map((p) => p[k]))), [0, 1].map((k) => Math.max(...points.map((p) => p[k])))] : this.extent();
    const middle = mix(low, high, 0.5), k = Math.min((this.width - 110) / Math.max(high[0] - low[0], 0.05), (this.height - 130) / Math.max(high[1] - low[1], 0.05));
    this.view = { x: middle[0] - 12 / k, y: middle[1], k: Math.min(3000, Math.max(FARTHEST, k)) };
    this.stale = true;
  }

  // What is there -----------------------------------------------------------------------------------------------------

  /** What is under a pixel: {kind, panel, index, t...}, or null. The selected panel comes first. */
  hit(at, { kinds = ["control", "vertex", "edge", "panel"], near = NEAR } = {}) {
    const { doc, selection } = this.desk, chosen = selection?.panel;
    const order = [...doc.panels].reverse().sort((p, q) => (q.name === chosen) - (p.name === chosen));
    const reach = near / this.view.k, board = this.place(at);
    const close = (panel, p) => Math.hypot(...sub(this.screen(panel, p), at));
    let best = null;
    const better = (far, found) => { if (far < near && (!best || far < best.far - 0.01)) best = { ...found, far }; };
    if (kinds.includes("control")) {
      const grip = this.turnGrip(at);
      if (grip) return grip;
      for (const panel of order.filter((p) => p.name === chosen)) panel.edges.forEach((e, index) => controls(e).forEach((p, point) => better(close(panel, p), { kind: "control", panel: panel.name, index, point })));
      if (best) return best;
    }
    if (kinds.includes("vertex")) {
      for (const panel of order) panel.vertices.forEach((p, index) => better(close(panel, p) + (panel.name === chosen ? 0 : 2), { kind: "vertex", panel: panel.name, index }));
      if (best) return best;
    }
    if (kinds.includes("edge")) {
      for (const panel of order) {
        const p = this.lift(panel, board), [low, high] = this.bounds(panel);
        if (p[0] < low[0] - reach || p[0] > high[0] + reach || p[1] < low[1] - reach || p[1] > high[1] + reach) continue;
        panel.edges.forEach((_, index) => {
          const found = nearest(panel, index, p);
          better(found.distance * this.view.k, { kind: "edge", panel: panel.name, index, t: found.t, point: found.point });
        });
      }
      if (best) return best;
    }
    if (kinds.includes("panel")) {
      for (const panel of order) if (this.holds(panel, this.lift(panel, board))) return { kind: "panel", panel: panel.name };
    }
    return null;
  }

  bounds(panel) {
    const all = this.outlines(panel).flat();
    return [[0, 1].map((k) => Math.min(...all.map((p) => p[k]))), [0, 1].map((k) => Math.max(...all.map((p) => p[k])))];
  }

  holds(panel, p) { return this.outlines(panel).reduce((odd, o) => odd !== inside(o, p), false); }

  /** The knob by which the selected panel is turned, and the end of its grain. */
  grips(panel) {
    const [low, high] = box(panel), middle = mix(low, high, 0.5), [x, y] = this.screen(panel, middle);
    const [, , turn] = this.where(panel), up = this.reach(panel) + 26;
    const grain = panel.grain ?? [0, 1], way = turned(grain, turn), l = Math.hypot(...grain);
    return { middle: [x, y], turn: [x - Math.sin(turn) * up, y - Math.cos(turn) * up], grain: [x + (34 * way[0]) / l, y - (34 * way[1]) / l] };
  }

  reach(panel) { const [low, high] = box(panel); return ((high[1] - low[1]) / 2) * this.view.k; }

  turnGrip(at) {
    const { selection } = this.desk, panel = selection?.kind === "panel" && this.desk.panel(selection.panel);
    if (!panel) return null;
    const { turn, grain } = this.grips(panel), close = (p) => Math.hypot(...sub(p, at)) < NEAR + 2;
    return close(turn) ? { kind: "turn", panel: panel.name } : close(grain) ? { kind: "grain", panel: panel.name } : null;
  }

  /** Which way is out of a panel at an edge's t: a unit vector of its plane. */
  outward(panel, i, t = 0.5) {
    const [p, q] = along(panel, i, [Math.max(0, t - 0.01), Math.min(1, t + 0.01)]), way = sub(q, p), l = Math.hypot(...way) || 1;
    const s = Math.sign(area(panel)) || 1;
    return [(s * way[1]) / l, (-s * way[0]) / l];
  }

  // The pointer -------------------------------------------------------------------------------------------------------

  event(e) {
    const edge = this.canvas.getBoundingClientRect(), at = [e.clientX - edge.left, e.clientY - edge.top];
    return { at, board: this.place(at), shift: e.shiftKey, free: e.altKey, ctrl: e.ctrlKey || e.metaKey, button: e.button };
  }

  down(e) {
    const here = this.event(e);
    this.canvas.focus({ preventScroll: true });
    this.canvas.setPointerCapture(e.pointerId);
    if (e.button === 0 && !this.spaced && this.tool?.down(here)) { this.working = true; this.stale = true; return; }
    if (e.button !== 2 || !this.tool?.cancel?.()) this.panning = { at: here.at, x: this.view.x, y: this.view.y, moved: false, left: e.button === 0 && !this.spaced };
    this.stale = true;
  }

  move(e) {
    const here = this.event(e);
    this.pointer = here;
    if (this.panning) {
      const { at, x, y } = this.panning, by = sub(here.at, at);
      if (Math.hypot(...by) > 3) this.panning.moved = true;
      Object.assign(this.view, { x: x - by[0] / this.view.k, y: y + by[1] / this.view.k });
    } else if (this.working) this.tool.move(here);
    else { this.hover = this.tool?.hover(here) ?? null; this.canvas.style.cursor = this.tool?.cursor?.(this.hover) ?? "default"; }
    this.stale = true;
  }

  up(e) {
    const here = this.event(e);
    if (this.panning) {
      if (this.panning.left && !this.panning.moved) this.tool?.miss?.(here);
      this.panning = null;
    } else if (this.working) this.tool.up(here);
    this.working = false;
    this.stale = true;
  }

  wheel(e) {
    const { at, board } = this.event(e);
    if (e.shiftKey) { this.view.x += (e.deltaX || e.deltaY) / this.view.k; this.stale = true; return; }
    const k = Math.min(CLOSEST, Math.max(FARTHEST, this.view.k * Math.exp(-e.deltaY * (e.deltaMode ? 0.05 : 0.0016))));
    this.view.k = k;
    const moved = sub(board, this.place(at));
    this.view.x += moved[0];
    this.view.y += moved[1];
    this.stale = true;
  }

  /** Draw if anything changed. */
  draw() {
    if (!this.stale || !this.desk.doc) return;
    this.stale = false;
    this.picture.draw();
  }
}
