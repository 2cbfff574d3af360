// What the pointer does on the drawing board. A tool answers down(here) with true when it takes the gesture; what it leaves
// moves the board.

import { add, along, distance, ends, length, mix, sub, turned, unit } from "./geometry.js";
import { cm, seamColor } from "./drawing.js";
import { both } from "./pairs.js";
import { addDart, addPanel, addVertex, drawing, moveVertices, panelOf } from "./shaping.js";
import { sew } from "./seams.js";

const GRID = 0.005, CATCH = 7; // metres; pixels
const round = (x) => Math.round(x / GRID) * GRID;

/** A place drawn to what is near: `points` straight above, below or beside it, else the grid. Guides go to the board. */
export function snapped(board, p, points, free, lay = (q) => q) {
  board.lines = [];
  if (free || !board.snapping) return p;
  const reach = CATCH / board.view.k, out = [...p];
  for (const axis of [0, 1]) {
    let best = reach, to = null;
    for (const q of points) if (Math.abs(q[axis] - p[axis]) < best) { best = Math.abs(q[axis] - p[axis]); to = q; }
    out[axis] = to ? to[axis] : round(p[axis]);
    if (to) board.lines.push([axis, to]);
  }
  board.lines = board.lines.map(([, q]) => [lay(out), lay(q)]);
  return out;
}

class Tool {
  constructor(board) { this.board = board; this.desk = board.desk; }
  hover(here) { return this.board.hit(here.at); }
  cursor() { return "default"; }
  down() { return false; }
  move() {}
  up() { this.board.lines = []; }
}

/** Select, and drag what is selected: corners, controls, edges, panels. */
export class Select extends Tool {
  cursor(hit) { return { vertex: "move", control: "move", edge: "pointer", panel: "grab", turn: "alias", grain: "alias" }[hit?.kind] ?? "default"; }

  down(here) {
    const { desk, board } = this, hit = board.hit(here.at);
    if (!hit) {
      if (here.shift) { this.gesture = { kind: "box", from: here.at, to: here.at }; return true; }
      return false;
    }
    const { selection } = desk;
    if (hit.kind === "vertex" && here.shift && selection?.kind === "vertex" && selection.panel === hit.panel) {
      const more = new Set([...(selection.more ?? []), hit.index].filter((v) => v !== selection.index));
      desk.select({ ...selection, more: [...more] });
    } else if (!(hit.kind === "vertex" && selection?.kind === "vertex" && selection.panel === hit.panel && (selection.index === hit.index || selection.more?.includes(hit.index)))) {
      desk.select(hit.kind === "turn" || hit.kind === "grain" ? selection : { panel: hit.panel, kind: hit.kind, index: hit.index, point: hit.point, t: hit.t });
    }
    const panel = desk.panel(hit.panel);
    this.gesture = { ...hit, from: here.at, start: board.lift(panel, here.board), board: here.board, moved: false };
    return true;
  }

  move(here) {
    const { desk, board, gesture: g } = this;
    if (!g) return;
    if (g.kind === "box") { g.to = here.at; return; }
    if (!g.moved) {
      if (Math.hypot(...sub(here.at, g.from)) < 3) return;
      g.moved = true;
      desk.grasp();
    }
    desk.drag((doc) => this[g.kind](panelOf(doc, g.panel), here, g, doc));
    g.at = here.at;
  }

  up(here) {
    const { desk, board, gesture: g } = this;
    this.gesture = null;
    board.lines = [];
    this.said = null;
    if (!g) return;
    if (g.kind === "box") { this.enclose(g); return; }
    if (g.moved) desk.release();
  }

  cancel() {
    if (!this.gesture?.moved) return false;
    this.gesture = null;
    this.said = null;
    this.board.lines = [];
    this.desk.release(false);
    return true;
  }

  miss() { this.desk.select(null); }
  twice(here) { const hit = this.board.hit(here.at); if (hit?.kind === "edge") this.desk.tell("measure", hit); if (hit?.kind === "panel") this.desk.tell("rename", hit); }

  /** Corners inside a box: of the panel that has most of them there. */
  enclose({ from, to }) {
    const { board, desk } = this, low = [0, 1].map((k) => Math.min(from[k], to[k])), high = [0, 1].map((k) => Math.max(from[k], to[k]));
    let best = null;
    for (const panel of desk.doc.panels) {
      const found = panel.vertices.flatMap((p, v) => { const [x, y] = board.screen(panel, p); return x >= low[0] && x <= high[0] && y >= low[1] && y <= high[1] ? [v] : []; });
      if (found.length > (best?.found.length ?? 0)) best = { panel: panel.name, found };
    }
    desk.select(best && { panel: best.panel, kind: "vertex", index: best.found[0], more: best.found.slice(1) });
  }

  // Drags: `panel` is of a fresh copy of the document each time ---------------------------------------------------------

  vertex(panel, here, g) {
    const { board, desk } = this, { selection } = desk, moving = [selection.index, ...(selection.more ?? [])];
    const others = panel.vertices.filter((_, v) => !moving.includes(v));
    const to = add(panel.vertices[g.index], sub(board.lift(panel, here.board), g.start));
    const at = snapped(board, to, others, here.free, (q) => board.lay(panel, q)), by = sub(at, panel.vertices[g.index]);
    moveVertices(panel, Object.fromEntries(moving.map((v) => [v, add(panel.vertices[v], by)])));
    this.said = panel.edges.map((e, i) => [e, i]).filter(([e]) => e.ends.includes(g.index)).map(([, i]) => `${cm(length(panel, i), 2)} cm`).join("\n");
  }

  control(panel, here, g) {
    const { board } = this, edge = panel.edges[g.index], [a, b] = ends(panel, g.index);
    const to = add(edge.points[g.point], sub(board.lift(panel, here.board), g.start));
    edge.points[g.point] = snapped(board, to, [a, b, ...edge.points.filter((_, n) => n !== g.point)], here.free, (q) => board.lay(panel, q));
    this.said = `${cm(length(panel, g.index), 2)} cm`;
  }

  edge(panel, here, g) {
    const { board } = this, [v, w] = panel.edges[g.index].ends, [a, b] = ends(panel, g.index);
    let by = sub(board.lift(panel, here.board), g.start);
    if (here.shift) { const out = board.outward(panel, g.index), s = by[0] * out[0] + by[1] * out[1]; by = [s * out[0], s * out[1]]; } // straight out
    else {
      const others = panel.vertices.filter((_, n) => n !== v && n !== w);
      by = sub(snapped(board, add(a, by), others, here.free, (q) => board.lay(panel, q)), a);
    }
    moveVertices(panel, { [v]: add(a, by), [w]: add(b, by) });
    this.said = `${cm(Math.hypot(...by), 2)} cm`;
  }

  panel(panel, here, g, doc) {
    const { board } = this, kept = drawing(doc).board, was = kept[panel.name] ?? [0, 0, 0];
    const to = add(was, sub(here.board, g.board));
    kept[panel.name] = [...(here.free || !board.snapping ? to : to.map(round)), was[2]];
  }

  turn(panel, here, g, doc) {
    const { board } = this, kept = drawing(doc).board, was = kept[panel.name] ?? [0, 0, 0], { middle } = board.grips(panel);
    const angle = ([x, y]) => Math.atan2(-(y - middle[1]), x - middle[0]);
    let turn = was[2] + angle(here.at) - angle(g.from);
    if (!here.free) turn = (Math.round(turn / (Math.PI / 12)) * Math.PI) / 12;
    const [low, high] = board.bounds(panel), centre = mix(low, high, 0.5), at = board.lay(panel, centre);
    kept[panel.name] = [...sub(at, turned(centre, turn)), turn];
    this.said = `${((turn * 180) / Math.PI).toFixed(0)}\u00b0`;
  }

  grain(panel, here) {
    const { board } = this, { middle } = board.grips(panel), [, , turn] = board.where(panel);
    let angle = Math.atan2(-(here.at[1] - middle[1]), here.at[0] - middle[0]) - turn;
    if (!here.free) angle = (Math.round(angle / (Math.PI / 12)) * Math.PI) / 12;
    panel.grain = [Math.cos(angle), Math.sin(angle)].map((x) => (Math.abs(x) < 1e-12 ? 0 : x));
    this.said = `grain ${((angle * 180) / Math.PI).toFixed(0)}\u00b0`;
  }

  draw(picture) {
    const { gesture: g } = this, { context: c } = picture;
    if (g?.kind === "box") {
      c.beginPath();
      c.rect(...g.from, ...sub(g.to, g.from));
      Object.assign(c, { strokeStyle: picture.ink.on, lineWidth: 1, fillStyle: "rgb(143 208 200 / 0.12)" });
      c.fill();
      c.stroke();
    }
    if (g?.moved && this.said) picture.tag(g.at, this.said);
    else if (!g && this.board.hover?.kind === "edge" && this.board.pointer) {
      const { panel, index } = this.board.hover, found = this.desk.panel(panel);
      if (found?.edges[index]) picture.tag(this.board.pointer.at, `${cm(length(found, index), 2)} cm`);
    }
  }
}

/** Draw a new panel: a click for each corner, on the first one to close it. Typing a number makes the line so long. */
export class Pen extends Tool {
  constructor(board) { super(board); this.corners = []; this.typed = ""; }
  cursor() { return "crosshair"; }
  hover() { return null; }
  get corner() { return this.corners.at(-1); }

  next(here) {
    const { board, corners } = this, near = corners.length > 2 && distance(board.pixel(corners[0]), here.at) < 10;
    board.lines = [];
    if (near) return corners[0];
    const others = this.desk.doc.panels.flatMap((p) => p.vertices.map((q) => board.lay(p, q)));
    const to = snapped(board, here.board, [...corners, ...others], here.free);
    const long = parseFloat(this.typed);
    return this.corner && long > 0 ? add(this.corner, unit(sub(to, this.corner)).map((x) => (x * long) / 100)) : to;
  }

  down(here) {
    if (here.button !== 0) return false;
    const to = this.next(here);
    this.typed = "";
    if (this.corners.length > 2 && distance(to, this.corners[0]) < 1e-9) { this.close(); return true; }
    if (!this.corner || distance(to, this.corner) > 1e-4) this.corners.push(to);
    return true;
  }

  close() {
    const { corners } = this;
    this.corners = [];
    this.board.lines = [];
    if (corners.length < 3) return;
    const name = this.desk.change((doc) => addPanel(doc, corners));
    this.desk.tell("tool", "select");
    this.desk.select({ panel: name, kind: "panel" });
  }

  cancel() { const some = this.corners.length > 0; this.corners = []; this.typed = ""; this.board.lines = []; this.board.stale = true; return some; }

  key(e) {
    if (/^[\d.,]$/.test(e.key) && this.corner) this.typed += e.key.replace(",", ".");
    else if (e.key === "Backspace") { if (this.typed) this.typed = this.typed.slice(0, -1); else this.corners.pop(); }
    else if (e.key === "Enter") { if (this.typed && this.board.pointer) this.down({ ...this.board.pointer, button: 0 }); else this.close(); }
    else return false;
    this.board.stale = true;
    return true;
  }

  draw(picture) {
    const { board, corners } = this, { context: c, ink } = picture, here = board.pointer, to = here && this.next(here);
    c.beginPath();
    [...corners, ...(to && corners.length ? [to] : [])].forEach((p, n) => { const [x, y] = board.pixel(p); if (n) c.lineTo(x, y); else c.moveTo(x, y); });
    Object.assign(c, { strokeStyle: ink.on, lineWidth: 2, fillStyle: "rgb(143 208 200 / 0.12)" });
    if (corners.length > 1) c.fill();
    c.stroke();
    corners.forEach((p, n) => picture.dot(board.pixel(p), n ? 3.5 : 5, n ? "#ffffff" : ink.on, ink.mat));
    if (!to) return;
    picture.dot(board.pixel(to), 3, ink.on, ink.mat);
    if (this.corner) picture.tag(board.pixel(to), this.typed ? `${this.typed} cm \u23ce` : `${cm(distance(to, this.corner))} cm`);
  }
}

/** A rectangle from corner to corner. */
export class Rectangle extends Tool {
  cursor() { return "crosshair"; }
  hover() { return null; }
  place(here) { return snapped(this.board, here.board, this.desk.doc.panels.flatMap((p) => p.vertices.map((q) => this.board.lay(p, q))), here.free); }
  down(here) { this.from = this.to = this.place(here); return true; }
  move(here) { if (this.from) this.to = this.place(here); }

  up() {
    const { from, to } = this;
    this.from = null;
    this.board.lines = [];
    if (!from || Math.min(...sub(to, from).map(Math.abs)) < 0.01) return;
    const name = this.desk.change((doc) => addPanel(doc, [from, [to[0], from[1]], to, [from[0], to[1]]]));
    this.desk.tell("tool", "select");
    this.desk.select({ panel: name, kind: "panel" });
  }

  cancel() { const some = Boolean(this.from); this.from = null; return some; }

  draw(picture) {
    if (!this.from) return;
    const { context: c, ink } = picture, a = this.board.pixel(this.from), b = this.board.pixel(this.to), size = sub(this.to, this.from).map((x) => cm(Math.abs(x)));
    c.beginPath();
    c.rect(...a, ...sub(b, a));
    Object.assign(c, { strokeStyle: ink.on, lineWidth: 2, fillStyle: "rgb(143 208 200 / 0.12)" });
    c.fill();
    c.stroke();
    picture.tag(b, `${size[0]} \u00d7 ${size[1]} cm`);
  }
}

/** A click on an edge cuts it there. */
export class Corner extends Tool {
  cursor() { return "copy"; }
  hover(here) { return this.board.hit(here.at, { kinds: ["edge"], near: 12 }); }

  down(here) {
    const { desk, board } = this, hit = this.hover(here);
    if (!hit) return false;
    const t = this.at(hit, here);
    const v = desk.change((doc) => both(doc, hit.panel, hit.index, t, desk.symmetric, (name, i, s) => addVertex(doc, name, i, s)));
    desk.select({ panel: hit.panel, kind: "vertex", index: v });
    return true;
  }

  /** The middle and whole centimetres from the start catch it. */
  at({ panel, index, t }, here) {
    const long = length(this.desk.panel(panel), index), reach = CATCH / this.board.view.k / long;
    if (here.free || !this.board.snapping) return Math.min(1 - 1e-3, Math.max(1e-3, t));
    if (Math.abs(t - 0.5) < reach) return 0.5;
    const near = round(t * long) / long;
    return near > 1e-3 && near < 1 - 1e-3 ? near : t;
  }

  draw(picture) {
    const { hover, pointer } = this.board, panel = hover && this.desk.panel(hover.panel);
    if (!panel?.edges[hover.index] || !pointer) return;
    const t = this.at(hover, pointer), long = length(panel, hover.index);
    picture.dot(this.board.screen(panel, along(panel, hover.index, [t])[0]), 4.5, "#ffffff", "#0b6b62");
    picture.tag(pointer.at, `${cm(t * long, 2)} | ${cm((1 - t) * long, 2)} cm`);
  }
}

/** A click on an edge makes a dart there, as wide and deep as the fields beside the tool say. */
export class Dart extends Corner {
  down(here) {
    const { desk, board } = this, hit = this.hover(here);
    if (!hit) return false;
    const { wide, deep } = board.dart, t = this.at(hit, here);
    const made = desk.change((doc) => both(doc, hit.panel, hit.index, t, desk.symmetric, (name, i, s) => addDart(doc, name, i, s, wide, deep)));
    if (!made) desk.tell("notice", "The edge is too short for such a dart.", "bad");
    else desk.select({ kind: "seam", index: desk.doc.seams.findIndex((s) => s.kind === "dart" && s.a[0][0] === hit.panel && s.a[0][1] === hit.index + 1) });
    return true;
  }

  draw(picture) {
    const { board } = this, { hover, pointer } = board, panel = hover && this.desk.panel(hover.panel);
    if (!panel?.edges[hover.index] || !pointer) return;
    const { wide, deep } = board.dart, long = length(panel, hover.index), t = this.at(hover, pointer), half = wide / 2 / long, out = board.outward(panel, hover.index, t);
    const [a, m, b] = along(panel, hover.index, [t - half, t, t + half]);
    picture.line(panel, [a, sub(m, out.map((x) => x * deep)), b], "#0b6b62", 2);
    picture.tag(pointer.at, `dart ${cm(wide)} \u00d7 ${cm(deep)} cm\nat ${cm(t * long)} cm`);
  }
}

/** Pick the edges of one side (Shift: more of them), then those of the other. */
export class Sew extends Tool {
  constructor(board) { super(board); this.side = []; this.other = []; }
  cursor() { return "crosshair"; }
  hover(here) { return this.board.hit(here.at, { kinds: ["edge"], near: 12 }); }

  down(here) {
    const hit = this.hover(here);
    if (!hit) return false;
    const span = [hit.panel, hit.index, 0, 1], now = this.ready ? this.other : this.side;
    if (now.some((s) => s[0] === span[0] && s[1] === span[1])) return true;
    now.push(span);
    if (here.shift) return true;
    if (this.ready) this.finish();
    else this.ready = true;
    return true;
  }

  finish() {
    const { side, other, desk } = this;
    this.cancel();
    const index = desk.change((doc) => sew(doc, side, other));
    if (index >= 0) desk.select({ kind: "seam", index });
  }

  cancel() { const some = this.side.length > 0; Object.assign(this, { side: [], other: [], ready: false }); this.board.stale = true; return some; }

  key(e) {
    if (e.key !== "Enter" || !this.side.length) return false;
    if (!this.ready) this.ready = true; else if (this.other.length) this.finish();
    this.board.stale = true;
    return true;
  }

  draw(picture) {
    const { board, desk } = this, color = seamColor(desk.doc.seams.length), sum = (side) => side.reduce((x, [n, i]) => x + (desk.panel(n)?.edges[i] ? length(desk.panel(n), i) : 0), 0);
    for (const [name, i] of [...this.side, ...this.other]) if (desk.panel(name)?.edges[i]) picture.line(desk.panel(name), picture.curve(desk.panel(name), i), color, 5);
    const { hover, pointer } = board, panel = hover && desk.panel(hover.panel);
    if (!pointer) return;
    if (this.ready && this.side.length) { // a thread from the first side to the pointer
      const [name, i] = this.side[0], c = picture.context;
      c.beginPath();
      c.moveTo(...board.screen(desk.panel(name), along(desk.panel(name), i, [0.5])[0]));
      c.lineTo(...pointer.at);
      Object.assign(c, { strokeStyle: color, lineWidth: 1.5 });
      c.setLineDash([5, 4]);
      c.stroke();
      c.setLineDash([]);
    }
    if (!panel?.edges[hover.index]) return;
    const long = length(panel, hover.index), one = sum(this.side), two = sum(this.other) + long;
    picture.tag(pointer.at, this.ready ? `${cm(one)} and ${cm(two)} cm\n${two >= one ? "+" : "\u2212"}${cm(Math.abs(two - one), 2)} cm` : `${cm(one + long)} cm`);
  }
}
