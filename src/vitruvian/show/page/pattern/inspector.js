// The column beside the board: what is selected, with its numbers; seams; proposals; what the doctor says; the drape.

import { chip, el } from "../controls.js";
import { cm, seamColor } from "./drawing.js";
import { area, box, length } from "./geometry.js";
import { evaluate, named } from "./measures.js";
import { dimension, partnerOf, unfold } from "./pairs.js";
import { SEAMS, measured, said, seamsOf } from "./seams.js";
import { deletePanel, deleteVertex, dimensionOf, drawing, keepDimension, moveVertices, panelOf, renamePanel, setExtent, setKind } from "./shaping.js";
import { flip, standing } from "./dressing.js";

const $ = (id) => document.getElementById(id);
const KIND_NAMES = { line: "straight", quadratic: "curve, one control", cubic: "curve, two controls", arc: "arc", polyline: "many points" };
const LABELS = { "": "\u2013", lower_interface: "waist: it hangs by it", left_collar: "collar, left", right_collar: "collar, right", left_armhole: "armhole, left", right_armhole: "armhole, right", strapless_top: "strapless top" };

const REGIONS = ["", "torso", "skirt", "leg", "sleeve", "cuff", "collar", "hood", "band", "pocket"];

/** Where a panel seems to be worn by its name. */
function guess(name) {
  const words = name.toLowerCase().split(/[^a-z]+/), first = (list) => list.find((w) => w && words.includes(w)) ?? "";
  return [first(REGIONS), first(["front", "back"]), first(["left", "right"])];
}

export class Inspector {
  constructor(desk) {
    this.desk = desk;
    for (const what of ["drawn", "selected"]) desk.on(what, () => { this.old = true; });
    desk.on("findings", () => this.findings());
    desk.on("placed", (header) => desk.change((doc) => {
      const panel = panelOf(doc, header.panel);
      if (!panel) return;
      Object.assign(panel, { rotation: header.rotation, translation: header.translation });
      header.labels.forEach((l, i) => { if (l && panel.edges[i]) panel.edges[i].label = l; });
    }, `place ${this.placing}`));
    desk.on("proposals", (header) => { this.proposed = header.proposals; this.proposals(); });
    desk.on("changed", () => { if (this.proposed) this.proposals(); });
    desk.on("welcome", (header) => { this.fabrics = header.fabrics; });
  }

  draw() {
    if (!this.old || !this.desk.doc) return;
    if ($("chosen").contains(document.activeElement) && document.activeElement.matches("input")) return; // somebody writes there
    this.old = false;
    const { desk } = this, { selection: s } = desk, root = $("chosen");
    root.replaceChildren();
    if (s?.kind === "seam") this.seam(root, s.index);
    else if (s) {
      const panel = desk.panel(s.panel);
      if (s.kind === "edge" || s.kind === "control") this.edge(root, panel, s.index);
      else if (s.kind === "vertex") this.vertex(root, panel, s);
      this.panel(root, panel, s.kind === "panel");
    } else this.nothing(root);
    this.seams();
  }

  // Rows --------------------------------------------------------------------------------------------------------------

  row(root, name, ...things) {
    const row = el("label", "row"), label = el("span", "name", name);
    row.append(label, ...things);
    root.append(row);
    return row;
  }

  field(value, act, { id = "", tip = "", list = null, wide = true } = {}) {
    const input = el("input", wide ? "wide" : "");
    Object.assign(input, { type: "text", value, spellcheck: false, autocomplete: "off" });
    if (id) input.dataset.testid = id;
    if (tip) input.dataset.tip = tip;
    if (list) input.setAttribute("list", list);
    let was = value;
    const done = () => { if (input.value !== was) { was = input.value; act(input.value, input); } };
    input.addEventListener("keydown", (e) => {
      if (e.key === "Enter") { done(); input.blur(); }
      if (e.key === "Escape") { input.value = was; }
    });
    input.addEventListener("blur", () => { done(); this.old = true; });
    return input;
  }

  choice(options, value, act, id = "") {
    const box = el("span", "select"), select = el("select");
    for (const [key, text] of options) select.append(new Option(text, key, false, key === value));
    if (id) select.dataset.testid = id;
    select.onchange = () => { act(select.value); select.blur(); };
    box.append(select);
    return box;
  }

  buttons(root, ...made) { const row = el("div", "buttons"); row.append(...made.filter(Boolean)); root.append(row); }

  head(root, kind, name, color = "") {
    const h = el("h2", "", name), k = el("span", "kind", kind);
    if (color) k.style.color = color;
    h.prepend(k);
    root.append(h);
  }

  /** A field for a length, cm: a number, or an expression of the body's measures that is kept. */
  dimension(value, kept, apply, id) {
    const shown = kept && named(kept.length) ? kept.length : cm(value, 2);
    return this.field(shown, (text, input) => {
      const words = text.trim().replace(",", named(text) ? "," : ".");
      try {
        const wanted = evaluate(words, this.desk.measures) / 100;
        if (!(wanted > 0.0005 && wanted < 20)) throw new Error("expected a length of up to 20 m");
        this.desk.change((doc) => apply(doc, wanted, named(words) ? words : null));
      } catch (error) {
        input.value = shown;
        this.desk.tell("notice", `${text}: ${error.message}`, "bad");
      }
    }, { id, tip: "Centimetres, or an expression of the body\u2019s measures such as chest/4 + 2, which then holds for every body" });
  }

  // What is selected ----------------------------------------------------------------------------------------------------

  nothing(root) {
    const { doc, measures } = this.desk;
    this.head(root, "pattern", doc.name);
    this.row(root, "Name", this.field(doc.name, (name) => this.desk.change((d) => { d.name = name.trim() || d.name; })));
    const all = doc.panels.reduce((s, p) => s + Math.abs(area(p)), 0);
    root.append(el("p", "said", `${doc.panels.length} panels, ${doc.seams.length} seams, ${all.toFixed(2)} m\u00b2 of cloth`));
    if (!doc.panels.length) root.append(el("p", "said", "Draw the first panel: P and a click for each corner, or R and a rectangle."));
    const names = Object.keys(measures).sort();
    if (!names.length) return;
    const more = el("details"), list = el("div", "measures");
    more.append(el("summary", "", "Measures of the body"), list);
    for (const n of names) list.append(el("span", "", n), el("b", "", `${cm(measures[n])}`));
    root.append(more);
  }

  panel(root, panel, open) {
    const { desk } = this, [low, high] = box(panel), { name } = panel, change = (act) => desk.change((doc) => act(panelOf(doc, name), doc));
    const rooted = open ? root : el("details");
    if (open) this.head(root, "panel", name);
    else { const s = el("summary", "", `Panel ${name}`); rooted.append(s); root.append(rooted); rooted.open = this.open ?? false; rooted.ontoggle = () => { this.open = rooted.open; }; }
    const rename = this.field(name, (wish) => { const to = desk.change((doc) => renamePanel(doc, name, wish)); if (to) desk.select({ panel: to, kind: "panel" }); }, { id: "panel-name" });
    this.row(rooted, "Name", rename);
    ["Width", "Height"].forEach((word, axis) => {
      const kept = drawing(desk.doc).dimensions.find((d) => d.panel === name && d.axis === axis && d.edge === undefined);
      this.row(rooted, word, this.dimension(high[axis] - low[axis], kept, (doc, wanted, text) => { setExtent(panelOf(doc, name), axis, wanted); keepDimension(doc, { panel: name, axis }, text); }, axis ? "panel-height" : "panel-width"), el("i", "", "cm"));
    });
    this.row(rooted, "Part", this.choice([["body", "body"], ["arm", "arm"], ["leg", "leg"], ["", "\u2013"]], panel.label ?? "", (v) => change((p) => { p.label = v; })));
    this.row(rooted, "Fabric", this.choice([["", "the garment\u2019s"], ...(this.fabrics ?? []).map((f) => [f, f])], panel.fabric ?? "", (v) => change((p) => { p.fabric = v; }), "panel-fabric"));
    this.row(rooted, "Layer", this.field(String(panel.order ?? 0), (v) => change((p) => { const n = parseInt(v, 10); if (n >= 0 && n < 100) p.order = n; })));
    if (panel.translation) {
      const at = el("span", "three"), turn = el("span", "three");
      panel.translation.forEach((x, k) => at.append(this.field(cm(x), (v) => change((p) => { const n = parseFloat(v.replace(",", ".")); if (Number.isFinite(n) && Math.abs(n) < 1000) p.translation[k] = n / 100; }), { wide: false })));
      this.row(rooted, "Place", at, el("i", "", "cm"));
      angles(panel.rotation).forEach((x, k) => turn.append(this.field(((x * 180) / Math.PI).toFixed(1), (v) => change((p) => { const n = parseFloat(v.replace(",", ".")); if (!Number.isFinite(n)) return; const now = angles(p.rotation); now[k] = (n * Math.PI) / 180; p.rotation = rotation(now); }), { wide: false })));
      this.row(rooted, "Turned", turn, el("i", "", "\u00b0"));
    } else rooted.append(el("p", "said", "It has no place around the body yet."));
    this.worn(rooted, name);
    if (!panel.translation) this.buttons(rooted, chip("Place it before the chest the body", "Put the panel before the body; drag it from there", () => change((p) => Object.assign(p, structuredClone(standing)))));
    const partner = partnerOf(desk.doc, name);
    if (partner) this.row(rooted, "Mirror of", chip(partner, "Select its mirror image", () => desk.select({ panel: partner, kind: "panel" })), chip("Part them", "Edit the two apart from now on", () => desk.change((doc) => { drawing(doc).pairs = drawing(doc).pairs.filter((p) => !p.includes(name)); })));
    this.buttons(rooted,
      partner ? null : chip("Mirror", "Make a mirrored copy for the other side, with its seams (M)", () => desk.tell("command", "mirror"), "mirror"),
      panel.rotation ? chip("Flip", "Turn its other face outwards (L)", () => change((p) => flip(p))) : null,
      chip("Copy", "Make a copy beside it (Ctrl+D)", () => desk.tell("command", "copy")),
      chip("Delete", "Take the panel and its seams away (Delete)", () => desk.change((doc) => deletePanel(doc, name)), "danger"));
  }

  /** Where a panel is worn: the server finds its place there. */
  worn(root, name) {
    const { desk } = this, now = () => drawing(desk.doc).worn?.[name] ?? guess(name), where = now(), row = el("span", "three");
    const place = (k, v) => {
      const words = [...now()];
      words[k] = v;
      if (!words[0]) words[0] = "torso";
      if (!words[1] && ["torso", "skirt", "leg"].includes(words[0])) words[1] = "front";
      desk.change((doc) => { (drawing(doc).worn ??= {})[name] = words; }, `place ${(this.placing = (this.placing ?? 0) + 1)}`);
      desk.request({ type: "place", panel: name, words: words.filter(Boolean).join(" ") });
    };
    row.append(this.choice(REGIONS.map((r) => [r, r || "\u2013"]), where[0], (v) => place(0, v), "worn-region"), this.choice([["front", "front"], ["back", "back"], ["", "\u2013"]], where[1], (v) => place(1, v), "worn-face"), this.choice([["", "middle"], ["left", "left"], ["right", "right"]], where[2], (v) => place(2, v), "worn-side"));
    this.row(root, "Worn", row).dataset.tip = "Puts the panel there; drag it in the picture of the body to correct it";
  }

  edge(root, panel, i) {
    const { desk } = this, { name } = panel, edge = panel.edges[i], kept = dimensionOf(desk.doc, name, i), options = { fix: kept?.fix ?? this.fix ?? "start", stretch: kept?.stretch ?? this.stretch ?? true };
    this.head(root, "edge", `${name} ${i}`);
    const keep = (text, own = options, wanted = null) => (doc) => dimension(doc, name, i, wanted, text, own, desk.symmetric);
    this.row(root, "Length", this.dimension(length(panel, i), kept, (doc, wanted, text) => keep(text, options, wanted)(doc), "edge-length"), el("i", "", "cm"));
    if (kept) this.buttons(root, el("span", "said", `${kept.length} = ${cm(length(panel, i), 2)} cm`), chip("Forget it", "Keep the length as a plain number", () => desk.change(keep(null))));
    this.row(root, "Stays", this.choice([["start", "its start"], ["middle", "its middle"], ["end", "its end"]], options.fix, (v) => { this.fix = options.fix = v; if (kept) desk.change(keep(kept.length, { ...options, fix: v })); }, "edge-fix"));
    const tick = el("input");
    Object.assign(tick, { type: "checkbox", checked: options.stretch });
    tick.dataset.tip = "All of the panel that lies beyond the end goes with it, so that a rectangle stays one";
    tick.onchange = () => { this.stretch = options.stretch = tick.checked; if (kept) desk.change(keep(kept.length, { ...options, stretch: tick.checked })); };
    this.row(root, "Stretch", tick);
    this.row(root, "Shape", this.choice(Object.entries(KIND_NAMES), edge.kind, (v) => desk.change((doc) => setKind(panelOf(doc, name), i, v)), "edge-kind"));
    this.row(root, "Label", this.choice(Object.entries({ [edge.label ?? ""]: edge.label ?? "", ...LABELS }), edge.label ?? "", (v) => desk.change((doc) => { const e = panelOf(doc, name).edges[i]; if (v) e.label = v; else delete e.label; }), "edge-label"));
    const seams = seamsOf(desk.doc, name, i);
    if (seams.length) { const list = el("div", "buttons"); for (const k of seams) { const c = chip(`seam ${k}`, "Select the seam", () => desk.select({ kind: "seam", index: k })); c.style.color = seamColor(k); list.append(c); } root.append(list); }
    if (edge.kind === "line") this.buttons(root, chip("Unfold", "It is cut on the fold here: mirror the panel across this edge, which is no edge any more (U)", () => desk.change((doc) => { if (!unfold(doc, name, i)) throw new Error("Only a panel without holes can be unfolded, at a straight edge."); }), "unfold"));
  }

  vertex(root, panel, s) {
    const { desk } = this, { name } = panel, v = s.index, p = panel.vertices[v];
    this.head(root, s.more?.length ? `${s.more.length + 1} corners` : "corner", `${name} ${v}`);
    const at = el("span", "three");
    p.forEach((x, k) => at.append(this.field(cm(x, 2), (text) => { const n = parseFloat(text.replace(",", ".")); if (Number.isFinite(n) && Math.abs(n) < 2000) desk.change((doc) => { const q = panelOf(doc, name), to = [...q.vertices[v]]; to[k] = n / 100; moveVertices(q, { [v]: to }); }); }, { wide: false, id: k ? "vertex-v" : "vertex-u" })));
    this.row(root, "u, v", at, el("i", "", "cm"));
    this.buttons(root, chip("Delete", "Take the corner away: its two edges become one (Delete)", () => desk.change((doc) => { if (!deleteVertex(doc, name, v)) throw new Error("A panel needs three corners."); }), "danger"));
  }

  seam(root, k) {
    const { desk } = this, seam = desk.doc.seams[k], { a, b, differ } = measured(desk.doc, seam), change = (act) => desk.change((doc) => act(doc.seams[k], doc));
    this.head(root, "seam", String(k), seamColor(k));
    const table = el("div", "sides");
    for (const [side, long] of [[seam.a, a], [seam.b, b]]) {
      const c = chip(said(side), "Select the edge", () => desk.select({ panel: side[0][0], kind: "edge", index: side[0][1] }));
      table.append(c, el("b", "", `${cm(long, 2)} cm`));
    }
    const far = Math.abs(differ) > 0.003 + 0.012 * Math.max(a, b), d = el("b", far && !["gather", "ease"].includes(seam.kind) ? "bad" : "", `${differ >= 0 ? "+" : "\u2212"}${cm(Math.abs(differ), 2)} cm`);
    d.dataset.testid = "seam-difference";
    table.append(el("span", "", "difference"), d);
    root.append(table);
    this.row(root, "Kind", this.choice(SEAMS.map((s) => [s, s]), seam.kind, (v) => change((s) => { s.kind = v; }), "seam-kind"));
    const open = el("input");
    Object.assign(open, { type: "checkbox", checked: seam.open });
    open.onchange = () => change((s) => { s.open = open.checked; });
    open.dataset.tip = "A slit that may be closed, not sewn";
    this.row(root, "Left open", open);
    this.buttons(root,
      chip("Reverse", "Sew the other end to the start (X)", () => change((s) => { s.reversed = !s.reversed; }), "reverse"),
      chip("Match lengths", "Make the first edge as long as the other side", () => desk.change((doc) => { const s = doc.seams[k], [name, edge] = s.a[0]; if (s.a.length > 1) throw new Error("The first side has several edges: set one of them."); dimension(doc, name, edge, measured(doc, s).b / (s.a[0][3] - s.a[0][2]), null, { fix: "start", stretch: true }, desk.symmetric); }), "match"),
      chip("Delete", "Take the seam away (Delete)", () => desk.change((doc) => { doc.seams.splice(k, 1); }), "danger"));
  }

  // Lists -------------------------------------------------------------------------------------------------------------

  seams() {
    const { desk } = this, root = $("seams"), { selection } = desk;
    $("seam-count").textContent = desk.doc.seams.length || "";
    root.replaceChildren(...desk.doc.seams.map((seam, k) => {
      const row = el("button", "line"), { a, b, differ } = measured(desk.doc, seam), mark = el("i", "swatch");
      mark.style.background = seamColor(k);
      row.append(mark, el("span", "", `${k}  ${said(seam.a)} \u2013 ${said(seam.b)}`), el("b", Math.abs(differ) > 0.003 + 0.012 * Math.max(a, b) ? "far" : "", cm(Math.max(a, b))));
      row.setAttribute("aria-pressed", String(selection?.kind === "seam" && selection.index === k));
      row.onclick = () => desk.select({ kind: "seam", index: k });
      return row;
    }));
  }

  proposals() {
    const { desk } = this, root = $("proposals"), sewn = new Set(desk.doc.seams.flatMap((s) => [...s.a, ...s.b].map((r) => `${r[0]} ${r[1]}`)));
    const free = (p) => [...p.seam.a, ...p.seam.b].every((r) => desk.panel(r[0])?.edges[r[1]] && !sewn.has(`${r[0]} ${r[1]}`));
    this.proposed = this.proposed.filter(free);
    $("proposal-count").textContent = this.proposed.length || "";
    $("proposals-all").disabled = !this.proposed.length;
    root.replaceChildren(...this.proposed.map((p) => {
      const row = el("div", "line proposal"), text = el("span", "", `${said(p.seam.a)} \u2013 ${said(p.seam.b)}`), why = el("small", "", `${Math.round(100 * p.score)} %, ${p.reason}`);
      text.append(why);
      row.onpointerenter = () => { desk.tell("hint", p.seam); };
      row.onpointerleave = () => { desk.tell("hint", null); };
      row.append(text,
        chip("\u2713", "Sew it", () => { desk.tell("hint", null); desk.change((doc) => { doc.seams.push(p.seam); }); }, "yes"),
        chip("\u2715", "Not this one", () => { desk.tell("hint", null); this.proposed = this.proposed.filter((q) => q !== p); this.proposals(); }, "no"));
      return row;
    }));
    if (!this.proposed.length) root.append(el("p", "said", "No two free edges look as if they belong together."));
  }

  acceptAll() {
    const all = this.proposed ?? [];
    this.desk.change((doc) => { doc.seams.push(...all.map((p) => p.seam)); });
  }

  findings() {
    const { desk } = this, root = $("findings"), said = desk.problem ? [{ rule: "", severity: "error", message: desk.problem, panel: "", edge: -1 }] : desk.findings;
    const list = [...(desk.broken ?? []), ...said];
    $("finding-count").textContent = list.filter((f) => f.severity !== "note").length || "";
    $("findings-panel").classList.toggle("bad", list.some((f) => f.severity === "error"));
    root.replaceChildren(...list.map((f) => {
      const row = el("button", `line ${f.severity}`), where = `${f.panel}${f.edge >= 0 ? ` ${f.edge}` : ""}`;
      row.append(el("i", "badge", f.severity === "note" ? "i" : "!"), el("span", "", `${where ? `${where}: ` : ""}${f.message}`), el("b", "", f.rule));
      if (desk.rules?.[f.rule]) row.dataset.tip = desk.rules[f.rule];
      row.onclick = () => { if (f.panel) desk.select(f.edge >= 0 ? { panel: f.panel, kind: "edge", index: f.edge } : { panel: f.panel, kind: "panel" }); };
      return row;
    }));
    if (!list.length) root.append(el("p", "said fine", desk.doc?.panels.length ? "Nothing is wrong with it." : ""));
  }
}

/** Angles about x, y and z of a rotation Rz Ry Rx, and back. */
export function angles(r) {
  const y = Math.asin(Math.max(-1, Math.min(1, -r[2][0])));
  if (Math.abs(r[2][0]) > 1 - 1e-9) return [Math.atan2(-r[1][2], r[1][1]), y, 0];
  return [Math.atan2(r[2][1], r[2][2]), y, Math.atan2(r[1][0], r[0][0])];
}

export function rotation([x, y, z]) {
  const [cx, sx, cy, sy, cz, sz] = [Math.cos(x), Math.sin(x), Math.cos(y), Math.sin(y), Math.cos(z), Math.sin(z)];
  return [[cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx], [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx], [-sy, cy * sx, cy * cx]];
}
