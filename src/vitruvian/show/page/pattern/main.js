// The page of the pattern editor: connects desk, board, body and column, and their keys.

import { chip, download, el, icons, keyList, keys, theme, tooltips } from "../controls.js";
import { RAMP, css } from "../colors.js";
import { Board } from "./board.js";
import { Desk } from "./desk.js";
import { Dressing, flip } from "./dressing.js";
import { cm } from "./drawing.js";
import { along, area, box, length } from "./geometry.js";
import { Inspector } from "./inspector.js";
import { evaluate, named } from "./measures.js";
import { dimension, mirrorPanel, unfold } from "./pairs.js";
import { copyDimensions, deletePanel, deleteVertex, dimensionOf, drawing, fresh, panelOf, setKind } from "./shaping.js";
import { Corner, Dart, Pen, Rectangle, Select, Sew } from "./tools.js";

const $ = (id) => document.getElementById(id);
const APART = 3; // mm between what was to be sewn above which a seam is called open, as `dress` does
const BENDS = { line: "quadratic", quadratic: "cubic", cubic: "arc", arc: "line", polyline: "line" };
const HINTS = {
  select: "", pen: "Click the corners; type a number for a length in cm. The first corner or Enter closes it, Backspace takes one back.",
  rectangle: "Drag from corner to corner.", corner: "Click an edge to cut it there.", dart: "Click an edge where the middle of the dart is.",
  sew: "Click an edge, then the edge that it is sewn to. Shift: one side has several edges; X turns a seam round.",
};

export function start(token) {
  const page = new Page(token);
  page.bind();
  requestAnimationFrame((now) => page.loop(now));
}

class Page {
  constructor(token) {
    icons();
    tooltips($("tip"));
    this.desk = new Desk(token);
    this.board = new Board($("board"), this.desk);
    try { this.dressing = new Dressing($("canvas"), this.desk); } catch (error) { this.notice("This page needs WebGL 2, which this browser does not offer.", "bad"); throw error; }
    this.inspector = new Inspector(this.desk);
    const { board } = this;
    Object.assign(board, { snapping: true, dart: { wide: 0.03, deep: 0.1 } });
    this.tools = { select: new Select(board), pen: new Pen(board), rectangle: new Rectangle(board), corner: new Corner(board), dart: new Dart(board), sew: new Sew(board) };
    this.use("select");
    theme($("theme"), (name) => { this.dressing.studio.theme(name); board.picture.theme = name; board.stale = true; });
    this.publish();
  }

  publish() {
    const page = this, read = (get) => ({ get, enumerable: true });
    const state = Object.defineProperties({}, {
      connected: read(() => page.desk.connected), document: read(() => page.desk.doc), selection: read(() => page.desk.selection),
      findings: read(() => page.desk.findings), unsaved: read(() => Boolean(page.desk.unsaved)), tool: read(() => page.tool),
      draping: read(() => page.draping?.state ?? null), report: read(() => page.report ?? null), shown: read(() => page.dressing.shown),
      fell: read(() => page.fell ?? 0), walking: read(() => Boolean(page.walking)), strides: read(() => page.strides ?? 0), hangs: read(() => page.dressing.hangs), proposed: read(() => page.inspector.proposed?.length ?? null), fps: read(() => page.drawn ?? 0), actors: read(() => (page.dressing.figure ? [1] : [])),
    });
    state.pixel = (name, p) => page.at($("board"), page.board.screen(page.desk.panel(name), p));
    state.middle = (name, i, t = 0.5) => { const panel = page.desk.panel(name); return page.at($("board"), page.board.screen(panel, along(panel, i, [t])[0])); };
    state.length = (name, i) => length(page.desk.panel(name), i);
    state.area = (name) => area(page.desk.panel(name));
    state.place = (name) => { const { dressing } = page, v = dressing.middle(page.desk.panel(name)).project(dressing.studio.camera), c = $("canvas"); return page.at(c, [((v.x + 1) / 2) * c.clientWidth, ((1 - v.y) / 2) * c.clientHeight]); };
    Object.defineProperty(window, "vitruvian", { value: Object.freeze(state) });
  }

  at(canvas, [x, y]) { const edge = canvas.getBoundingClientRect(); return [edge.left + x, edge.top + y]; }

  loop(now) {
    requestAnimationFrame((t) => this.loop(t));
    const dt = Math.min(0.1, (now - (this.last ?? now)) / 1000);
    this.last = now;
    if (!this.desk.doc) return;
    this.board.draw();
    this.inspector.draw();
    if (this.dressing.draw(dt)) this.drawn = (this.drawn ?? 0) + 1;
  }

  notice(text, kind = "") {
    $("notice").textContent = text;
    $("notice").className = `on ${kind}`;
    clearTimeout(this.fade);
    this.fade = setTimeout(() => { $("notice").className = ""; }, 4500);
  }

  use(name) {
    this.board.tool?.cancel?.();
    this.tool = name;
    this.board.tool = this.tools[name];
    this.board.hover = null;
    for (const b of document.querySelectorAll("[data-tool]")) b.setAttribute("aria-pressed", String(b.dataset.tool === name));
    $("hint").textContent = HINTS[name];
    this.options();
    this.board.stale = true;
  }

  /** Fields beside the tools: of the dart. */
  options() {
    const root = $("options");
    root.hidden = this.tool !== "dart";
    if (root.hidden) return;
    const field = (word, key) => {
      const input = Object.assign(el("input"), { type: "text", value: cm(this.board.dart[key]) }), label = el("label", "name", `${word} `);
      input.dataset.testid = `dart-${key}`;
      input.onchange = () => { try { const x = evaluate(input.value.replace(",", "."), this.desk.measures) / 100; if (x > 0 && x < 1) this.board.dart[key] = x; } catch { /* the old number stays */ } input.value = cm(this.board.dart[key]); };
      input.onkeydown = (e) => { if (e.key === "Enter") input.blur(); };
      label.append(input);
      return label;
    };
    root.replaceChildren(field("width", "wide"), field("depth", "deep"), el("span", "name", "cm"));
  }

  bind() {
    const { desk, board, dressing } = this, press = (id, on) => $(id).setAttribute("aria-pressed", String(on));
    desk.on("welcome", (header) => this.welcome(header));
    desk.on("changed", () => this.changed());
    desk.on("notice", (text, kind) => this.notice(text, kind));
    desk.on("state", (text) => { $("state").textContent = text; });
    desk.on("tool", (name) => this.use(name));
    desk.on("measure", (hit) => this.measure(hit.panel, hit.index));
    desk.on("rename", (hit) => { desk.select({ panel: hit.panel, kind: "panel" }); setTimeout(() => document.querySelector("[data-testid=panel-name]")?.select(), 60); });
    desk.on("command", (name) => this[name]());
    desk.on("hint", (seam) => { board.hinted = seam; board.stale = true; });
    desk.on("saved", (header) => { this.changed(); this.notice(`Saved in ${header.where}.`); });
    desk.on("file", (header, arrays) => download(new Blob([arrays.data.array]), `${desk.doc.name}.${header.format}`));
    desk.on("fall", () => { this.fell = (this.fell ?? 0) + 1; });
    desk.on("fall", (header) => this.progress(header));
    desk.on("drape", (header) => this.draped(header));
    desk.on("walk", (header) => this.walked(header));
    desk.on("stride", () => { this.strides = (this.strides ?? 0) + 1; });
    desk.on("shown", (what) => { press("worn", what === "worn"); $("report").hidden = what !== "worn" || !$("report").childElementCount; });
    for (const b of document.querySelectorAll("[data-tool]")) b.onclick = () => this.use(b.dataset.tool);
    for (const b of document.querySelectorAll("[data-mode]")) b.onclick = () => { dressing.mode = b.dataset.mode; for (const o of document.querySelectorAll("[data-mode]")) o.setAttribute("aria-pressed", String(o === b)); };
    const click = { undo: () => desk.undo(), redo: () => desk.redo(), save: () => this.save(), drape: () => this.drape(), walk: () => this.walk(), curve: () => this.bend(), mirror: () => this.mirror(), flip: () => this.flip(),
      fit: () => board.fit(), propose: () => desk.request({ type: "propose" }), "proposals-all": () => this.inspector.acceptAll(), worn: () => dressing.show(dressing.shown === "worn" ? "panels" : "worn"),
      snapping: () => { board.snapping = !board.snapping; press("snapping", board.snapping); }, symmetric: () => { desk.symmetric = !desk.symmetric; press("symmetric", desk.symmetric); },
      strain: () => { dressing.map = !dressing.map; press("strain", dressing.map); dressing.paint(); this.told(); }, help: () => { $("keys").hidden = !$("keys").hidden; if (!$("keys").hidden) this.keyList(); } };
    for (const [view, name] of [["front", "front"], ["side", "side"], ["back", "back"]]) click[`view-${view}`] = () => dressing.studio.fly(name);
    for (const [id, act] of Object.entries(click)) $(id).onclick = () => { act(); if (document.activeElement === $(id)) $(id).blur(); };
    $("export").onchange = () => { const format = $("export").value; $("export").value = ""; if (format) desk.request({ type: "export", format }); };
    $("proposals-panel").ontoggle = () => { if ($("proposals-panel").open && !this.inspector.proposed) desk.request({ type: "propose" }); };
    keys({ V: () => this.use("select"), P: () => this.use("pen"), R: () => this.use("rectangle"), A: () => this.use("corner"), T: () => this.use("dart"), S: () => this.use("sew"),
      C: click.curve, M: click.mirror, G: click.snapping, Y: click.symmetric, F: click.fit, L: click.flip, D: click.drape, H: click.walk, W: click.worn, E: click.strain, "1": click["view-front"], "2": click["view-side"], "3": click["view-back"],
      X: () => this.reverse(), U: () => this.unfold(), K: () => $("theme").click(), "?": click.help, Delete: () => this.remove(), Backspace: () => this.remove(), Enter: () => this.enter(), Escape: () => this.escape(),
      "Ctrl+Z": click.undo, "Ctrl+Shift+Z": click.redo, "Ctrl+Y": click.redo, "Ctrl+S": click.save, "Ctrl+D": () => this.copy(),
      ArrowLeft: () => this.nudge(-1, 0), ArrowRight: () => this.nudge(1, 0), ArrowUp: () => this.nudge(0, 1), ArrowDown: () => this.nudge(0, -1) });
    document.addEventListener("keydown", (e) => { // a tool may want what is typed
      if (e.ctrlKey || e.metaKey || e.target.matches?.("input, select")) return;
      if (e.key === " " && !board.spaced) { board.spaced = true; e.preventDefault(); }
      if (board.tool.key?.(e)) { e.preventDefault(); e.stopImmediatePropagation(); }
    }, { capture: true });
    document.addEventListener("keyup", (e) => { if (e.key === " ") board.spaced = false; });
    addEventListener("beforeunload", () => { if (desk.timer) desk.send(); });
    this.splitter();
    this.measuring();
  }

  keyList() {
    keyList($("keys"));
    const rows = [["Delete", "Delete what is selected"], ["X", "Reverse the selected seam"], ["U", "Unfold the panel at the selected edge"], ["Ctrl+D", "Copy the panel"], ["Enter", "Type the length of the selected edge"], ["arrows", "Nudge corners by 1 mm"], ["Shift drag", "On the board: select corners in a box"], ["Space drag", "Move the board"]];
    for (const [key, text] of rows) $("keys").append(el("kbd", "", key), el("span", "", text));
  }

  welcome(header) {
    const { doc } = this.desk;
    $("fabric").replaceChildren(...header.fabrics.map((f) => new Option(f, f, f === "cotton", f === "cotton")));
    $("export").append(...header.formats.map((f) => new Option(`.${f}`, f)));
    this.where = header.where;
    $("save").dataset.tip = header.where ? `Save in ${header.where}` : "Download the pattern (start with --save FILE to save it in place)";
    this.board.fit();
    if (!doc.panels.length) this.use("rectangle");
  }

  changed() {
    const { desk } = this;
    $("title").textContent = desk.doc.name;
    document.title = `${desk.unsaved ? "\u25cf " : ""}${desk.doc.name} \u2013 vitruvian`;
    $("unsaved").hidden = !desk.unsaved;
    $("undo").disabled = !desk.done.length;
    $("redo").disabled = !desk.undone.length;
    if (this.report && this.draping?.seq !== desk.seq) this.told();
  }

  // Commands ------------------------------------------------------------------------------------------------------------

  get selection() { return this.desk.selection; }

  save() {
    if (this.where) this.desk.request({ type: "save" });
    else this.desk.request({ type: "export", format: "pattern.json" });
  }

  bend() {
    const s = this.selection;
    if (s?.kind !== "edge" && s?.kind !== "control") { this.notice("Select an edge first."); return; }
    this.desk.change((doc) => { const panel = panelOf(doc, s.panel); setKind(panel, s.index, BENDS[panel.edges[s.index].kind]); });
  }

  mirror() {
    if (!this.selection?.panel) { this.notice("Select a panel first."); return; }
    const name = this.desk.change((doc) => mirrorPanel(doc, this.selection.panel));
    this.desk.select({ panel: name, kind: "panel" });
  }

  copy() {
    const s = this.selection;
    if (!s?.panel) return;
    const name = this.desk.change((doc) => {
      const panel = structuredClone(panelOf(doc, s.panel)), [low, high] = box(panel), { board } = drawing(doc), place = board[s.panel] ?? [0, 0, 0];
      panel.name = fresh(doc, s.panel);
      if (panel.translation) panel.translation[2] += 0.04;
      doc.panels.push(panel);
      copyDimensions(doc, s.panel, panel.name);
      board[panel.name] = [place[0] + high[0] - low[0] + 0.06, place[1], place[2]];
      return panel.name;
    });
    this.desk.select({ panel: name, kind: "panel" });
  }

  flip() {
    if (!this.selection?.panel || !this.desk.panel(this.selection.panel).rotation) { this.notice("Select a panel first."); return; }
    this.desk.change((doc) => flip(panelOf(doc, this.selection.panel)));
  }

  reverse() {
    const s = this.selection;
    if (s?.kind === "seam") this.desk.change((doc) => { doc.seams[s.index].reversed = !doc.seams[s.index].reversed; });
  }

  unfold() {
    const s = this.selection;
    if (s?.kind === "edge") this.desk.change((doc) => { if (!unfold(doc, s.panel, s.index)) throw new Error("Only a panel without holes can be unfolded, at a straight edge."); });
  }

  remove() {
    const s = this.selection, { desk } = this;
    if (!s) return;
    if (s.kind === "seam") desk.change((doc) => { doc.seams.splice(s.index, 1); });
    else if (s.kind === "panel") desk.change((doc) => deletePanel(doc, s.panel));
    else if (s.kind === "vertex") desk.change((doc) => { for (const v of [s.index, ...(s.more ?? [])].sort((a, b) => b - a)) if (!deleteVertex(doc, s.panel, v)) throw new Error("A panel needs three corners."); });
    else desk.change((doc) => setKind(panelOf(doc, s.panel), s.index, "line"));
  }

  nudge(x, y) {
    const s = this.selection;
    if (s?.kind !== "vertex") return;
    this.desk.change((doc) => { const panel = panelOf(doc, s.panel); moveBy(panel, [s.index, ...(s.more ?? [])], [x / 1000, y / 1000]); }, `nudge ${s.panel} ${s.index}`);
  }

  enter() { const s = this.selection; if (s?.kind === "edge") this.measure(s.panel, s.index); }

  escape() {
    const { board, desk, dressing } = this;
    if (!$("keys").hidden) { $("keys").hidden = true; return; }
    if (this.walking) { this.walk(); return; }
    if (board.tool.cancel?.()) { board.working = false; board.stale = true; return; }
    if (dressing.cancel()) return;
    if (this.draping?.state === "falling") { desk.ask({ type: "stop" }); return; }
    if (this.tool !== "select") this.use("select");
    else desk.select(null);
  }

  // Typing a length on the board ------------------------------------------------------------------------------------------

  measure(name, i) {
    const panel = this.desk.panel(name), kept = dimensionOf(this.desk.doc, name, i), [x, y] = this.board.screen(panel, along(panel, i, [0.5])[0]), input = $("measure");
    this.measured = { name, i, kept };
    Object.assign(input, { hidden: false, value: kept && named(kept.length) ? kept.length : cm(length(panel, i), 2) });
    Object.assign(input.style, { left: `${x}px`, top: `${y}px` });
    input.select();
  }

  measuring() {
    const input = $("measure"), done = (take) => {
      const { measured, desk } = this;
      if (!measured) return;
      this.measured = null;
      input.hidden = true;
      if (!take) return;
      const { name, i, kept } = measured, text = input.value.trim();
      try {
        const wanted = evaluate(named(text) ? text : text.replace(",", "."), desk.measures) / 100, options = { fix: kept?.fix ?? "start", stretch: kept?.stretch ?? true };
        if (!(wanted > 0.0005 && wanted < 20)) throw new Error("expected a length of up to 20 m");
        desk.change((doc) => dimension(doc, name, i, wanted, named(text) ? text : null, options, desk.symmetric));
      } catch (error) { this.notice(`${text}: ${error.message}`, "bad"); }
    };
    input.addEventListener("keydown", (e) => { if (e.key === "Enter") { done(true); $("board").focus(); } else if (e.key === "Escape") { done(false); $("board").focus(); } });
    input.addEventListener("blur", () => done(false));
  }

  // Draping -------------------------------------------------------------------------------------------------------------

  drape() {
    if (this.draping?.state === "falling") { this.desk.ask({ type: "stop" }); return; }
    if (!this.desk.doc.panels.length) { this.notice("Draw a panel first."); return; }
    this.draping = { state: "falling" };
    this.fell = 0;
    this.desk.request({ type: "drape", fabric: $("fabric").value, size: Number($("size").value) });
    this.falling(true);
  }

  falling(on) {
    $("falling").hidden = !on;
    $("drape").textContent = on ? "Stop" : "Drape";
    $("drape").classList.toggle("stop", on);
    if (on) this.progress({ what: "meshing", share: 0 });
  }

  progress({ what, share }) {
    $("falling").children[0].value = what === "sewing" ? 0.3 * share : what === "draping" ? 0.3 + 0.7 * Math.min(1, 3 * share) : 0;
    $("falling").children[1].textContent = `${what}\u2026`;
  }

  draped(header) {
    this.draping = header;
    if (header.state === "falling") return;
    this.falling(false);
    if (header.state === "failed") { this.notice(header.message, "bad"); return; }
    if (header.state === "stopped") { this.notice("Stopped."); this.dressing.show("panels"); return; }
    this.report = header.report;
    $("worn").disabled = $("strain").disabled = $("walk").disabled = false;
    this.told();
    $("report").hidden = false;
  }

  /** The body walks in what was draped, or stands again. */
  walk() {
    if (!this.report || this.draping?.state === "falling") { this.notice("Drape the pattern first (D)."); return; }
    if (this.walking) this.desk.ask({ type: "stop" });
    else { this.dressing.show("worn"); this.desk.request({ type: "walk" }); }
  }

  walked({ state, message }) {
    this.walking = state === "dressing" || state === "walking";
    $("walk").setAttribute("aria-pressed", String(this.walking));
    $("falling").hidden = state !== "dressing";
    if (state === "dressing") { $("falling").children[0].removeAttribute("value"); $("falling").children[1].textContent = "dressing\u2026"; }
    if (state === "failed") this.notice(message, "bad");
  }

  /** The report of the drape that is shown. */
  told() {
    const r = this.report, root = $("report"), { desk } = this;
    if (!r) return;
    const bad = [];
    if (r.seam_gap_max_mm > APART) bad.push([`Seams stay up to ${r.seam_gap_max_mm.toFixed(0)} mm apart: too small?`, r.open_seams]);
    if (r.strain_p99 > 0.05) bad.push([`Tight: the most stretched hundredth is ${(100 * r.strain_p99).toFixed(0)} % longer or more`]);
    if (r.penetrating_vertices) bad.push([`${r.penetrating_vertices} points are inside the body`]);
    if (r.self_intersections) bad.push([`It cuts itself ${r.self_intersections} times`]);
    if (!r.settled) bad.push([`It still moves by ${(1000 * r.speed).toFixed(0)} mm/s`]);
    const stale = this.draping.seq !== desk.seq;
    const head = el("h3", bad.length ? "bad" : "fine", bad.length ? "It does not fit" : "It can be worn");
    if (stale) head.append(el("span", "said", "  \u2013 of the pattern before your last change (D)"));
    const figures = el("div", "figures");
    for (const [word, value] of [["triangles", r.faces], ["seam gap", `${r.seam_gap_max_mm.toFixed(2)} mm`], ["stretch, 99 %", `${(100 * r.strain_p99).toFixed(1)} %`], ["cuts", r.self_intersections], ["openings", r.boundary_loops], ["seconds", Object.values(r.seconds).reduce((a, b) => a + b, 0).toFixed(1)]]) {
      const s = el("span", "", `${word} `);
      s.append(el("b", "", String(value)));
      figures.append(s);
    }
    const lines = bad.map(([text, seams]) => {
      const p = el("p", "bad", text);
      for (const k of (seams ?? []).slice(0, 12)) p.append(" ", chip(`seam ${k}`, "Select the seam", () => desk.select({ kind: "seam", index: k })));
      return p;
    });
    root.replaceChildren(head, ...lines, figures);
    if (this.dressing.map) {
      const scale = el("div", "scale"), ramp = el("i");
      ramp.style.background = `linear-gradient(to right, ${RAMP.filter((_, k) => k % 15 === 0).map(css).join(", ")})`;
      scale.append(el("span", "", "0 %"), ramp, el("span", "", "stretched by 10 % and more"));
      root.append(scale);
    }
  }

  splitter() {
    const bar = $("split"), set = (x) => { const wide = $("desk").clientWidth - 288; $("desk").style.setProperty("--board", `${Math.min(wide - 240, Math.max(240, x))}px`); };
    bar.onpointerdown = (e) => { bar.setPointerCapture(e.pointerId); bar.onpointermove = (m) => set(m.clientX); };
    bar.onpointerup = bar.onpointercancel = () => { bar.onpointermove = null; };
    bar.onkeydown = (e) => { if (e.key === "ArrowLeft" || e.key === "ArrowRight") { set(bar.offsetLeft + (e.key === "ArrowLeft" ? -40 : 40)); e.stopPropagation(); } };
  }
}

function moveBy(panel, vertices, [x, y]) {
  for (const v of vertices) panel.vertices[v] = [panel.vertices[v][0] + x, panel.vertices[v][1] + y];
}
