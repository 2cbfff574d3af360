// What the drawing board looks like: mat, cloth, edges with their lengths, seams in matching colours.

import { css, oklch } from "../colors.js";
import { along, area, box, controls, ends, length, mix, sidePoints, sub, unit } from "./geometry.js";
import { named } from "./measures.js";
import { halves } from "./pairs.js";
import { dimensionOf } from "./shaping.js";

export const cm = (metres, digits = 1) => (100 * metres).toFixed(digits);
export const seamRgb = (k) => oklch(0.6, 0.17, (40 + k * 137.508) % 360);
export const seamColor = (k) => css(seamRgb(k));
export const clothColor = (k) => oklch(0.87, 0.045, (85 + k * 137.508) % 360);

const INK = { dark: { mat: "#232b2c", fine: "rgb(255 255 255 / 0.035)", thick: "rgb(255 255 255 / 0.075)", soft: "rgb(255 255 255 / 0.4)", on: "#8fd0c8", rim: "rgb(0 0 0 / 0.45)" },
  light: { mat: "#d4dad7", fine: "rgb(0 0 0 / 0.045)", thick: "rgb(0 0 0 / 0.1)", soft: "rgb(0 0 0 / 0.45)", on: "#0f766b", rim: "rgb(0 0 0 / 0.25)" } };
const CLOTH = { ink: "#33302c", soft: "#7a746c", chosen: "#0b6b62", error: "#c2261b", warning: "#a86400" };
const FONT = "system-ui, 'Segoe UI', Roboto, sans-serif";

export class Drawing {
  constructor(board) { this.board = board; this.theme = "dark"; this.context = board.canvas.getContext("2d"); }

  draw() {
    const { board, context: c } = this, { canvas, desk } = board, ratio = devicePixelRatio || 1;
    const [w, h] = [board.width, board.height];
    if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) Object.assign(canvas, { width: Math.round(w * ratio), height: Math.round(h * ratio) });
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.ink = INK[this.theme];
    this.mat(w, h);
    const { doc, selection } = desk, order = doc.panels.map((p, k) => ({ p, k })).sort((a, b) => (a.p.name === selection?.panel) - (b.p.name === selection?.panel));
    for (const { p, k } of order) this.cloth(p, k);
    for (const { p } of order) this.edges(p);
    doc.seams.forEach((seam, k) => this.seam(seam, k));
    for (const { p } of order) this.words(p);
    this.findings();
    const chosen = selection && desk.panel(selection.panel);
    if (chosen) this.handles(chosen);
    this.hovered();
    if (board.hinted) for (const [name, i, t0, t1] of [...board.hinted.a, ...board.hinted.b]) if (desk.panel(name)?.edges[i]) this.line(desk.panel(name), this.curve(desk.panel(name), i, t0, t1), "#ff5fa2", 5);
    board.tool?.draw?.(this);
    this.guides();
    this.rulers(w, h);
  }

  // The mat -----------------------------------------------------------------------------------------------------------

  mat(w, h) {
    const { context: c, ink, board } = this, { k } = board.view;
    c.fillStyle = ink.mat;
    c.fillRect(0, 0, w, h);
    const lines = (step, style) => {
      const [x0, y1] = board.place([0, 0]), [x1, y0] = board.place([w, h]);
      c.beginPath();
      for (let n = Math.ceil(x0 / step); n * step <= x1; n++) { const x = Math.round(board.pixel([n * step, 0])[0]) + 0.5; c.moveTo(x, 0); c.lineTo(x, h); }
      for (let n = Math.ceil(y0 / step); n * step <= y1; n++) { const y = Math.round(board.pixel([0, n * step])[1]) + 0.5; c.moveTo(0, y); c.lineTo(w, y); }
      Object.assign(c, { strokeStyle: style, lineWidth: 1 });
      c.stroke();
    };
    if (k > 700) lines(0.01, ink.fine);
    if (k > 150) lines(0.05, k > 700 ? ink.thick : ink.fine);
    lines(k > 700 ? 0.5 : 0.1 * (k > 150 ? 1 : 5), ink.thick);
  }

  rulers(w, h) {
    const { context: c, ink, board } = this, { k } = board.view, step = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1].find((s) => s * k > 46) ?? 2;
    Object.assign(c, { font: `10px ${FONT}`, fillStyle: ink.soft, textAlign: "center", textBaseline: "top" });
    const [x0] = board.place([0, 0]), [x1, y0] = board.place([w, h]), y1 = board.place([0, 0])[1];
    for (let n = Math.ceil(x0 / step); n * step <= x1; n++) { const x = board.pixel([n * step, 0])[0]; if (x > 56) c.fillText(cm(n * step, 0), x, h - 14); }
    c.textAlign = "right";
    c.textBaseline = "middle";
    for (let n = Math.ceil(y0 / step); n * step <= y1; n++) { const y = board.pixel([0, n * step])[1]; if (y > 56 && y < h - 24) c.fillText(cm(n * step, 0), w - 6, y); }
  }

  // Panels ------------------------------------------------------------------------------------------------------------

  trace(panel, points, close = false) {
    const { context: c, board } = this;
    points.forEach((p, n) => { const [x, y] = board.screen(panel, p); if (n) c.lineTo(x, y); else c.moveTo(x, y); });
    if (close) c.closePath();
  }

  cloth(panel, k) {
    const { context: c, board } = this, chosen = board.desk.selection?.panel === panel.name, over = board.hover?.panel === panel.name;
    c.save();
    c.beginPath();
    for (const o of board.outlines(panel)) this.trace(panel, o, true);
    Object.assign(c, { shadowColor: this.ink.rim, shadowBlur: chosen ? 18 : 8, shadowOffsetY: chosen ? 5 : 2 });
    const [r, g, b] = clothColor(k).map((x) => Math.round(255 * x * (chosen ? 1.02 : over ? 1 : 0.96)));
    c.fillStyle = `rgb(${Math.min(255, r)} ${Math.min(255, g)} ${Math.min(255, b)})`;
    c.fill("evenodd");
    c.restore();
  }

  /** Points of part of an edge, enough for a smooth line. */
  curve(panel, i, t0 = 0, t1 = 1) {
    const straight = panel.edges[i].kind === "line", n = straight ? 1 : Math.max(8, Math.min(64, Math.ceil(length(panel, i) * this.board.view.k / 8)));
    return along(panel, i, Array.from({ length: n + 1 }, (_, k) => t0 + ((t1 - t0) * k) / n));
  }

  line(panel, points, style, width) {
    const { context: c } = this;
    c.beginPath();
    this.trace(panel, points);
    Object.assign(c, { strokeStyle: style, lineWidth: width, lineCap: "round", lineJoin: "round" });
    c.stroke();
  }

  edges(panel) {
    const { selection } = this.board.desk;
    panel.edges.forEach((_, i) => {
      const chosen = selection?.panel === panel.name && selection.kind === "edge" && selection.index === i;
      this.line(panel, this.curve(panel, i), chosen ? CLOTH.chosen : CLOTH.ink, chosen ? 3 : 1.4);
    });
  }

  words(panel) {
    const { context: c, board } = this, { k } = board.view, { desk } = board, chosen = desk.selection?.panel === panel.name;
    const [low, high] = box(panel), middle = mix(low, high, 0.5), [x, y] = board.screen(panel, middle);
    const wide = (high[0] - low[0]) * k, tall = (high[1] - low[1]) * k;
    this.grain(panel, [x, y], Math.min(34, tall * 0.22), chosen);
    if (Math.max(wide, tall) > 46) {
      Object.assign(c, { font: `600 ${chosen ? 13 : 12}px ${FONT}`, fillStyle: CLOTH.ink, textAlign: "center", textBaseline: "middle" });
      c.save();
      c.translate(x, y);
      if (wide < 0.7 * tall && c.measureText(panel.name).width > wide - 16) c.rotate(-Math.PI / 2);
      const room = wide < 0.7 * tall ? tall : 0.8 * wide;
      let name = panel.name;
      while (name.length > 4 && c.measureText(name).width > room - 14) name = name.endsWith("\u2026") ? `${name.slice(0, -2)}\u2026` : `${name.slice(0, -1)}\u2026`;
      c.fillText(name, 0, -10);
      c.font = `10px ${FONT}`;
      c.fillStyle = CLOTH.soft;
      const said = [panel.label, panel.fabric, `${(1e4 * Math.abs(area(panel))).toFixed(0)} cm\u00b2`].filter(Boolean).join(" \u00b7 ");
      if (c.measureText(said).width < room - 40) c.fillText(said, 0, 6);
      c.restore();
    }
    panel.edges.forEach((_, i) => this.lengthOf(panel, i, chosen));
  }

  /** The length beside the middle of an edge, inside; with the expression that it is kept by. */
  lengthOf(panel, i, always = false) {
    const { context: c, board } = this, long = length(panel, i), px = long * board.view.k;
    if (px < (always ? 26 : 40)) return;
    const kept = dimensionOf(board.desk.doc, panel.name, i), said = `${cm(long)}${kept && named(kept.length) ? ` = ${kept.length}` : ""}`;
    const [p, q] = along(panel, i, [0.49, 0.51]), out = board.outward(panel, i), at = along(panel, i, [0.5])[0];
    const [x, y] = board.screen(panel, [at[0] - (10 / board.view.k) * out[0], at[1] - (10 / board.view.k) * out[1]]);
    const [a, b] = [board.screen(panel, p), board.screen(panel, q)];
    let turn = Math.atan2(b[1] - a[1], b[0] - a[0]);
    if (turn > Math.PI / 2) turn -= Math.PI;
    if (turn < -Math.PI / 2) turn += Math.PI;
    c.save();
    c.translate(x, y);
    c.rotate(turn);
    Object.assign(c, { font: `${kept ? "600 " : ""}10px ${FONT}`, textAlign: "center", textBaseline: "middle", fillStyle: kept ? CLOTH.chosen : CLOTH.soft });
    if (c.measureText(said).width < px + 24) c.fillText(said, 0, 0);
    c.restore();
  }

  grain(panel, [x, y], l, chosen) {
    const { context: c, board } = this, { middle, grain } = board.grips(panel), way = unit(sub(grain, middle)), across = [-way[1], way[0]];
    if (chosen) l = 34;
    c.beginPath();
    c.moveTo(x - l * way[0], y - l * way[1]);
    c.lineTo(x + l * way[0], y + l * way[1]);
    for (const s of [-1, 1]) { c.moveTo(x + l * way[0], y + l * way[1]); c.lineTo(x + (l - 6) * way[0] + s * 3.5 * across[0], y + (l - 6) * way[1] + s * 3.5 * across[1]); }
    Object.assign(c, { strokeStyle: chosen ? CLOTH.soft : "rgb(51 48 44 / 0.22)", lineWidth: 1 });
    c.stroke();
  }

  // Seams -------------------------------------------------------------------------------------------------------------

  seam(seam, k) {
    const { context: c, board } = this, { panels } = board.desk.doc, { selection } = board.desk, chosen = selection?.kind === "seam" && selection.index === k;
    const color = seamColor(k);
    for (const [side, forward] of [[seam.a, true], [seam.b, !seam.reversed]]) {
      for (const [name, edge, t0, t1] of side) {
        const panel = panels.find((p) => p.name === name);
        if (!panel?.edges[edge]) continue;
        const points = this.curve(panel, edge, t0, t1);
        if (chosen) this.line(panel, points, "rgb(255 255 255 / 0.9)", 7);
        this.line(panel, points, color, chosen ? 4.5 : 2.6);
      }
      const found = sidePoints(panels, side, forward ? [0.46, 0.5, 0.54] : [0.54, 0.5, 0.46]);
      if (!found[1]) continue;
      const [a, at, b] = found.map(({ panel, point }) => board.screen(panel, point)), way = unit(sub(b, a)), across = [-way[1], way[0]], r = chosen ? 8 : 5.5;
      c.beginPath();
      c.moveTo(at[0] + r * way[0], at[1] + r * way[1]);
      for (const s of [-1, 1]) c.lineTo(at[0] - 0.6 * r * way[0] + s * 0.65 * r * across[0], at[1] - 0.6 * r * way[1] + s * 0.65 * r * across[1]);
      c.closePath();
      c.fillStyle = color;
      c.fill();
      if (board.view.k < 220 && !chosen) continue;
      const { panel, point } = found[1], edge = side.find((s) => s[0] === panel.name)?.[1] ?? 0, out = board.outward(panel, edge), [x, y] = board.screen(panel, [point[0] + (13 / board.view.k) * out[0], point[1] + (13 / board.view.k) * out[1]]);
      Object.assign(c, { font: `700 10px ${FONT}`, textAlign: "center", textBaseline: "middle", fillStyle: color });
      c.fillText(String(k), x, y);
    }
  }

  // Handles, hints ------------------------------------------------------------------------------------------------------

  handles(panel) {
    const { context: c, board, ink } = this, { selection } = board.desk;
    panel.edges.forEach((e, i) => {
      const [a, b] = ends(panel, i), p = controls(e);
      if (!p.length) return;
      const joins = e.kind === "cubic" ? [[a, p[0]], [b, p[1]]] : e.kind === "quadratic" ? [[a, p[0]], [p[0], b]] : [];
      for (const pair of joins) { c.setLineDash([3, 3]); this.line(panel, pair, "rgb(11 107 98 / 0.6)", 1); c.setLineDash([]); }
      p.forEach((q, n) => this.dot(board.screen(panel, q), 4.2, selection?.kind === "control" && selection.index === i && selection.point === n ? CLOTH.chosen : "#ffffff", CLOTH.chosen));
    });
    panel.vertices.forEach((p, v) => {
      const chosen = selection.kind === "vertex" && (selection.index === v || selection.more?.includes(v)), [x, y] = board.screen(panel, p), r = chosen ? 4.5 : 3.5;
      c.beginPath();
      c.rect(x - r, y - r, 2 * r, 2 * r);
      Object.assign(c, { fillStyle: chosen ? CLOTH.chosen : "#ffffff", strokeStyle: chosen ? "#ffffff" : CLOTH.ink, lineWidth: 1.2 });
      c.fill();
      c.stroke();
    });
    const half = board.desk.symmetric && halves(panel);
    if (half) { // it is its own mirror image: the middle line
      const [low, high] = box(panel);
      c.setLineDash([8, 3, 2, 3]);
      this.line(panel, [[half.middle, low[1] - 0.015], [half.middle, high[1] + 0.015]], "rgb(20 150 137 / 0.8)", 1);
      c.setLineDash([]);
    }
    if (selection.kind !== "panel") return;
    const { turn, grain } = board.grips(panel), [low, high] = box(panel), [x, y] = board.screen(panel, [(low[0] + high[0]) / 2, high[1]]);
    c.beginPath();
    c.moveTo(x, y);
    c.lineTo(...turn);
    Object.assign(c, { strokeStyle: ink.on, lineWidth: 1 });
    c.stroke();
    this.dot(turn, 5, ink.on, ink.mat);
    this.dot(grain, 3.4, "#ffffff", CLOTH.soft);
  }

  dot([x, y], r, fill, rim) {
    const { context: c } = this;
    c.beginPath();
    c.arc(x, y, r, 0, 2 * Math.PI);
    Object.assign(c, { fillStyle: fill, strokeStyle: rim, lineWidth: 1.4 });
    c.fill();
    c.stroke();
  }

  hovered() {
    const { hover, desk } = this.board, panel = hover && desk.panel(hover.panel);
    if (!panel || !hover) return;
    if (hover.kind === "edge" && panel.edges[hover.index]) this.line(panel, this.curve(panel, hover.index), "rgb(20 150 137 / 0.55)", 5);
    if (hover.kind === "vertex" && panel.vertices[hover.index]) this.dot(this.board.screen(panel, panel.vertices[hover.index]), 6.5, "rgb(20 150 137 / 0.35)", CLOTH.chosen);
    if (hover.kind === "control" && panel.edges[hover.index]?.points?.[hover.point]) this.dot(this.board.screen(panel, panel.edges[hover.index].points[hover.point]), 6.5, "rgb(20 150 137 / 0.35)", CLOTH.chosen);
  }

  /** What the doctor finds, as a mark on the panel or edge. */
  findings() {
    const { context: c, board } = this, seen = new Set();
    for (const f of [...(board.desk.broken ?? []), ...board.desk.findings]) {
      const panel = f.severity !== "note" && board.desk.panel(f.panel), key = `${f.panel} ${f.edge}`;
      if (!panel || seen.has(key)) continue;
      seen.add(key);
      const edge = f.edge >= 0 && panel.edges[f.edge] ? f.edge : -1, [low, high] = box(panel);
      const out = edge >= 0 ? board.outward(panel, edge, 0.3) : [0, 0], at = edge >= 0 ? along(panel, edge, [0.3])[0] : [mix(low, high, 0.5)[0], high[1]];
      const [x, y] = board.screen(panel, [at[0] + (14 / board.view.k) * out[0], at[1] + (14 / board.view.k) * out[1]]);
      this.dot([x, y], 7.5, f.severity === "error" ? CLOTH.error : CLOTH.warning, "#ffffff");
      Object.assign(c, { font: `700 11px ${FONT}`, fillStyle: "#ffffff", textAlign: "center", textBaseline: "middle" });
      c.fillText("!", x, y + 0.5);
    }
  }

  guides() {
    const { context: c, board } = this;
    for (const [a, b] of board.lines ?? []) {
      c.beginPath();
      c.moveTo(...board.pixel(a));
      c.lineTo(...board.pixel(b));
      Object.assign(c, { strokeStyle: "#ff5fa2", lineWidth: 1 });
      c.setLineDash([4, 4]);
      c.stroke();
      c.setLineDash([]);
    }
  }

  /** A label beside a pixel. */
  tag([x, y], said) {
    const { context: c } = this, lines = said.split("\n");
    c.font = `600 11px ${FONT}`;
    const wide = Math.max(...lines.map((l) => c.measureText(l).width)) + 14, high = 16 * lines.length + 6, left = Math.min(x + 14, this.board.width - wide - 4), top = Math.max(4, y - high - 10);
    c.beginPath();
    c.roundRect(left, top, wide, high, 6);
    c.fillStyle = "rgb(16 17 19 / 0.9)";
    c.fill();
    Object.assign(c, { fillStyle: "#f3f1ee", textAlign: "left", textBaseline: "middle" });
    lines.forEach((l, n) => c.fillText(l, left + 7, top + 11.5 + 16 * n));
  }
}
