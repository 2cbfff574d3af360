// The page: puts frames from a source on stage and connects the controls.

import * as THREE from "three";
import { RAMP, css } from "./colors.js";
import { Compare, WORDS } from "./compare.js";
import { Figure } from "./figure.js";
import { Fineness } from "./fineness.js";
import { HeatMap } from "./heat.js";
import { heaviest, root } from "./level.js";
import { History, center, localRotation, toQuaternion } from "./pose.js";
import { Explorer } from "./explorer.js";
import { Handles } from "./handles.js";
import { LiveSource, RecordedSource } from "./source.js";
import { Marks } from "./marks.js";
import { Overlay, pick } from "./overlays.js";
import { Painting } from "./painting.js";
import { pictures } from "./pictures.js";
import { Picking, stand } from "./picking.js";
import { Studio } from "./studio.js";
import { Tuning } from "./tuning.js";
import { download, icons, keyList, keys, theme, tooltips } from "./controls.js";

const $ = (id) => document.getElementById(id);

/** Start the page on a live server ({token}) or on the bytes of a recording ({recording}). */
export async function start({ token, recording }) {
  const setIcon = icons();
  let studio;
  try {
    studio = new Studio($("canvas"));
  } catch (error) {
    $("notice").textContent = "This page needs WebGL 2, which this browser does not offer.";
    throw error;
  }
  const page = new Page(studio, setIcon);
  tooltips($("tip"));
  theme($("theme"), (name) => studio.theme(name));
  page.source = recording ? new RecordedSource(page, recording) : new LiveSource(page, token);
  page.bindControls();
  requestAnimationFrame((now) => page.loop(now));
}

class Page {
  constructor(studio, setIcon) {
    Object.assign(this, { studio, setIcon, figures: new Map(), overlays: new Map(), mode: "skin", selected: -1, hello: null });
    this.header = { frame: 0, round: 0, playing: false, speed: 1, loop: true }; // until the source says how it stands
    this.drawn = [];
    this.offset = new THREE.Vector3();
    this.history = new History(() => this.edited());
    this.explorer = new Explorer(this);
    this.tuning = new Tuning(this); this.handles = new Handles(this); this.marks = new Marks(this);
    this.picking = new Picking(this);
    this.painting = new Painting(this);
    this.heat = new HeatMap(this); this.fineness = new Fineness(this);
    this.compare = new Compare($("compare-view"), this);
    new ResizeObserver(() => this.compare.on && this.compare.place()).observe($("compare-view"));
    studio.canvas.classList.add("empty");
    Object.assign(pictures, { changed: () => { this.changed = true; } }); studio.head = () => this.face();
    $("legend-ramp").style.background = `linear-gradient(to right, ${RAMP.filter((_, i) => i % 15 === 0).map(css).join(", ")})`;
    this.publish();
  }

  /** window.vitruvian: what tests and scripts may read. */
  publish() {
    const page = this, read = (get) => ({ get, enumerable: true });
    const state = Object.defineProperties({}, {
      frame: read(() => Math.floor(page.header.frame + 1e-6)),
      frames: read(() => page.hello?.frames ?? 0),
      time: read(() => page.header.frame / (page.hello?.fps ?? 1)),
      fps: read(() => page.rate()),
      playing: read(() => Boolean(page.header.playing)),
      actors: read(() => [...page.figures.values()].map((f) => ({
        name: f.name, joints: f.joints.length, vertices: f.source.length, triangles: f.triangles.length / 3, deformer: f.deformer,
      }))),
      drawn: read(() => page.triangles()),
      hands: read(() => page.tuning.told),
      landmarks: read(() => page.picking.told), handles: read(() => page.handles.told), marks: read(() => page.marks.told),
      heat: read(() => page.heat.told), pictures: read(() => pictures.told),
      painting: read(() => page.painting.told),
      selected: read(() => page.figure?.joints[page.selected] ?? null),
      level: read(() => (page.figure ? Number($("loa").value) : null)),
      bones: read(() => page.figure?.overlay.shown.map((j) => page.figure.joints[j]) ?? []),
      angles: read(() => (page.selected >= 0 ? [...page.explorer.details.now] : null)),
      camera: read(() => ({ position: page.studio.camera.position.toArray(), target: page.studio.controls.target.toArray(), fov: page.studio.camera.fov, moving: Boolean(page.studio.flight) })),
      mode: read(() => page.mode),
      compared: read(() => page.compare.report),
      quality: read(() => page.studio.qualityName),
      software: read(() => page.studio.software),
      connected: read(() => Boolean(page.source?.connected)),
      recorded: read(() => page.source instanceof RecordedSource),
    });
    state.positions = (name) => Array.from((page.figures.get(name) ?? page.figure)?.whole() ?? []);
    state.screen = (joint) => page.screen(joint);
    state.pixel = (point) => { const f = page.figure; return page.studio.window(new THREE.Vector3(...point).applyMatrix4(f.mesh.matrixWorld).project(page.studio.camera)); };
    state.site = (name) => { const s = page.figure?.sites.findIndex((x) => x.name === name) ?? -1; return s < 0 ? null : page.figure.sitePosition(s).toArray(); };
    Object.defineProperty(window, "vitruvian", { value: Object.freeze(state), writable: false });
  }

  /** Pixel (x, y) of a joint in the window. */
  screen(joint) {
    const f = this.figure, j = f?.joints.indexOf(joint) ?? -1;
    return j < 0 ? null : this.studio.window(f.jointPosition(j).project(this.studio.camera));
  }

  /** Figure that the panels are about: the first with joints. */
  get figure() {
    const all = [...this.figures.values()];
    return all.find((f) => f.isBody) ?? all[0];
  }

  rate() {
    const d = this.drawn;
    return d.length < 2 ? 0 : Math.round((10000 * (d.length - 1)) / (d.at(-1) - d[0])) / 10;
  }

  // What the source calls -------------------------------------------------------------------------------------------

  welcome(header) {
    this.hello = header;
    const { playing, speed, loop } = header;
    this.header = { ...this.header, playing, speed, loop };
    document.title = `${header.title} \u2013 vitruvian`;
    $("title").textContent = header.title;
    $("timeline").max = Math.max(0, header.frames - 1);
    for (const f of this.figures.values()) this.studio.scene.remove(f.group);
    this.figures.clear();
    this.overlays.clear();
    this.arrived = false;
    this.compare.columns = []; // of figures that are gone
    this.again = Boolean(this.studio.box); // after a reconnection the camera stays
  }

  mesh(header, blocks) {
    const figure = new Figure(header, blocks[header.actor]);
    if (header.twin) { this.figures.get(header.twin).twin = figure; return; } // another surface of the same body, for comparing
    const overlay = new Overlay(figure);
    this.figures.set(figure.name, figure);
    this.overlays.set(figure.name, overlay);
    figure.overlay = overlay;
    if (figure === this.figure) this.present(figure);
  }

  present(figure) {
    $("deformer").replaceChildren(...this.hello.deformers.map((n) => new Option(WORDS[n] ?? n, n)));
    $("deformer").value = figure.deformer;
    $("deformer").disabled = !figure.isBody;
    this.explorer.present(figure, this.hello);
    this.tuning.show(figure); this.handles.show(figure);
    this.painting.show(figure);
    this.history.done.length = this.history.undone.length = 0;
    this.edited();
  }

  frame(header, blocks) {
    this.header = header;
    for (const figure of this.figures.values()) {
      const told = figure.isBody ? header.deformers?.[figure.name] : figure.deformer; // another page may have changed it
      if (told && this.source.live && told !== figure.deformer && performance.now() - (this.chosen ?? -1e9) > 1000) {
        figure.deformer = told;
        if (figure === this.figure) { $("deformer").value = told; this.tuning.update(true); }
      }
      const plain = this.mode === "skin" || (this.mode === "stripes" && this.compare.on);
      figure.detail(this.fineness.cell(figure, header.playing && plain && !pressed("wire") ? this.studio.grain() : 0));
      figure.update(told === figure.deformer ? blocks[figure.name] : without(blocks[figure.name]));
      if (figure.isBody || figure.on) {
        const t = figure.travel ?? [0, 0, 0];
        figure.group.position.set(t[0], t[1], t[2]).multiplyScalar(header.round).sub(this.offset);
      }
    }
    if (!this.arrived) this.arrive();
    this.changed = true;
  }

  state(text) { $("notice").textContent = text; }

  /** Triangles that are being drawn. */
  triangles() { return [...this.figures.values()].reduce((n, f) => n + f.mesh.geometry.index.count / 3, 0); }

  arrive() {
    this.arrived = true;
    if (this.figures.size === 1 && !this.figure.isBody) stand(this.figure);
    this.picking.show(); this.marks.arrive();
    this.heat.arrive();
    const boxes = [...this.figures.values()].map((f) => f.box());
    const low = [0, 1, 2].map((a) => Math.min(...boxes.map((b) => b[0][a]))), high = [0, 1, 2].map((a) => Math.max(...boxes.map((b) => b[1][a])));
    this.studio.followed = null;
    if (this.again) this.studio.box = { low, high };
    else this.studio.frame(low, high);
    for (const f of this.figures.values()) this.studio.scene.add(f.group);
    this.studio.canvas.classList.remove("empty");
    if (!this.again && [...this.figures.values()].every((f) => !f.triangles.length)) $("bones").setAttribute("aria-pressed", "true"); // else nothing would be seen
    this.looks();
    this.recall();
  }

  // Drawing ---------------------------------------------------------------------------------------------------------

  loop(now) {
    requestAnimationFrame((t) => this.loop(t));
    const began = performance.now(), dt = Math.min(0.5, (now - (this.before ?? now)) / 1000);
    this.before = now;
    this.source.tick(now);
    const figure = this.figure;
    if (figure && this.arrived) {
      figure.group.updateMatrixWorld(true);
      if (figure.isBody) this.studio.track(figure.jointPosition(root(figure)), dt, this.header.playing);
      this.rebase();
    }
    if (this.changed || this.studio.moving) for (const o of this.overlays.values()) o.update((p) => this.studio.pixel(p));
    if (this.changed || this.studio.moving) this.marks.update();
    if (this.changed) this.compare.update();
    this.compare.tick(now, this.header.playing);
    if (this.changed) {
      this.explorer.update();
      this.studio.shade([...this.figures.values()].flatMap((f) => f.spheres()));
      this.transport();
    }
    if (this.changed || this.header.playing || this.studio.moving) this.stillSince = now;
    this.studio.settle(now - (this.stillSince ?? now) > 300);
    if (this.studio.draw(dt, this.changed)) {
      this.explorer.beacon.update(this.studio);
      this.picking.draw(); this.handles.draw();
      this.drawn.push(now);
      while (this.drawn.length > 60 || now - this.drawn[0] > 3000) this.drawn.shift();
      if (this.header.playing && dt) this.studio.watch(Math.max(performance.now() - began, 1000 * dt));
    }
    this.changed = false;
  }

  /** Stay near the origin on long walks: go back by whole metres, which nobody sees on a grid of half metres. */
  rebase() {
    const { followed } = this.studio;
    if (!followed || Math.hypot(followed.x, followed.z) < 60) return;
    const back = new THREE.Vector3(Math.round(followed.x), 0, Math.round(followed.z));
    this.offset.add(back);
    for (const f of this.figures.values()) { f.group.position.sub(back); f.group.updateMatrixWorld(true); }
    followed.sub(back);
    this.studio.shift(back.negate());
  }

  transport() {
    const { frame, playing, speed, loop } = this.header, line = $("timeline"), fps = this.hello.fps;
    if (!this.scrubbing) line.value = Math.round(frame);
    line.style.setProperty("--fill", `${(100 * line.value) / (line.max || 1)}%`);
    const text = `${(frame / fps).toFixed(2)} / ${(this.hello.frames / fps).toFixed(2)} s`;
    if ($("clock").textContent !== text) $("clock").textContent = text;
    if (this.shownPlaying !== playing) {
      this.shownPlaying = playing;
      this.setIcon($("play"), playing ? "pause" : "play");
      $("play").setAttribute("aria-pressed", String(Boolean(playing)));
    }
    if (document.activeElement !== $("speed") && $("speed").value !== String(speed)) $("speed").value = String(speed);
    $("loop").setAttribute("aria-pressed", String(Boolean(loop)));
    if ($("shapes-panel").open) this.explorer.shapes.update();
    const now = performance.now();
    if (now - (this.rated ?? 0) > 500) {
      this.rated = now;
      const reduced = this.studio.qualityName !== "best" ? ` \u00b7 ${this.studio.qualityName}` : "";
      $("rate").textContent = playing ? `${Math.round(this.rate())} fps${reduced}` : "";
    }
  }

  // Editing ---------------------------------------------------------------------------------------------------------

  turn(j, R, key) {
    const { figure } = this, before = figure.turns.get(j) ?? null;
    this.put(figure, j, R);
    this.history.push({ key, undo: () => this.put(figure, j, before), redo: () => this.put(figure, j, R) });
  }

  put(figure, j, R) {
    if (R) figure.turns.set(j, R);
    else figure.turns.delete(j);
    this.source.rotation(figure.name, figure.joints[j], R ? toQuaternion(R) : [0, 0, 0, 1]);
    this.refresh(figure);
  }

  displace(d, weight, key) {
    const { figure } = this, before = figure.displaced.get(d) ?? null;
    this.putShape(figure, d, weight);
    this.history.push({ key, undo: () => this.putShape(figure, d, before), redo: () => this.putShape(figure, d, weight) });
  }

  putShape(figure, d, weight) {
    if (weight === null) figure.displaced.delete(d);
    else figure.displaced.set(d, weight);
    this.source.displacer(figure.name, figure.displacers[d].name, weight);
    this.refresh(figure);
  }

  refresh(figure) {
    figure.refresh();
    this.changed = true;
  }

  reset() {
    const { figure } = this, turns = new Map(figure.turns), shapes = new Map(figure.displaced), { shift } = figure;
    if (!turns.size && !shapes.size && !shift) return;
    const put = (t, s, by) => {
      this.source.clear(figure.name);
      figure.displaced = new Map(s);
      for (const [d, w] of s) this.source.displacer(figure.name, figure.displacers[d].name, w);
      this.handles.put({ turns: t, shift: by });
    };
    put([], [], null);
    this.history.push({ undo: () => put(turns, shapes, shift), redo: () => put([], [], null) });
  }

  /** All displacers back to what the clip gives, in one step. */
  resetShapes() {
    const { figure } = this, shapes = new Map(figure.displaced);
    if (!shapes.size) return;
    const put = (all) => { for (const d of shapes.keys()) this.putShape(figure, d, all?.get(d) ?? null); };
    put(null);
    this.history.push({ undo: () => put(shapes), redo: () => put(null) });
  }

  edited() {
    $("undo").disabled = !this.history.done.length;
    $("redo").disabled = !this.history.undone.length;
    if (this.figure) this.explorer.edited();
  }

  // Looks -----------------------------------------------------------------------------------------------------------

  looks() {
    for (const figure of this.figures.values()) {
      const own = this.mode === "heat" ? figure.heat : figure === this.figure;
      figure.paint(own || this.mode === "segments" ? this.mode : "skin", Math.max(0, this.selected));
      figure.wireframe(pressed("wire"));
      figure.overlay.skeleton.visible = pressed("bones");
      figure.overlay.pins.visible = pressed("sites");
    }
    this.explorer.showRanges();
    this.heat.update();
    $("legend").hidden = this.mode !== "weights" || !this.figure?.isBody;
    $("details").classList.toggle("short", !$("legend").hidden); // room for the legend
    $("legend-name").textContent = `Weight of ${this.figure?.joints[Math.max(0, this.selected)] ?? ""}`;
    this.changed = true;
  }

  setMode(mode) {
    this.mode = this.mode === mode ? "skin" : mode;
    if (this.mode === "weights" && this.selected < 0 && this.figure?.isBody) this.explorer.select(heaviest(this.figure));
    for (const m of MODES) $(m).setAttribute("aria-pressed", String(this.mode === m));
    this.looks();
    this.remember();
  }

  toggleCompare(names) {
    if (this.compare.on) this.compare.close();
    else this.compare.open(names);
    $("compare").setAttribute("aria-pressed", String(this.compare.on));
    if (!this.compare.on && this.figure) this.figure.undress();
    this.fineness.apply();
    this.refresh(this.figure);
  }

  /** What is compared, and stripes, in the fragment of the address: it opens the same view again. */
  remember() {
    const state = new URLSearchParams(location.hash.slice(1)), put = (name, value) => (value ? state.set(name, value) : state.delete(name));
    put("compare", this.compare.on ? this.compare.names.join(",") : "");
    put("stripes", this.mode === "stripes" ? "1" : "");
    history.replaceState(null, "", `#${state}`);
  }

  recall() {
    const state = new URLSearchParams(location.hash.slice(1)), names = state.get("compare")?.split(",");
    if (state.get("stripes") && this.mode !== "stripes") this.setMode("stripes");
    if (this.compare.on) this.compare.open();
    else if (names) this.toggleCompare(names);
  }

  face() {
    const f = this.figure, j = f?.joints?.findIndex((n) => /skullbase|^head$/i.test(n)) ?? -1;
    if (j < 0) return null;
    const p = f.jointPosition(j), high = this.studio.box.high[1], low = this.studio.box.low[1];
    return p.add(new THREE.Vector3(0, 0.022 * (high - low), 0.04));
  }

  setDeformer(name) {
    const { figure } = this;
    figure.deformer = name;
    this.chosen = performance.now();
    $("deformer").value = name;
    this.source.deformer(figure.name, name);
    figure.served = null; // by itself, until the server's surface of this deformer arrives, if it has one
    this.tuning.update(true);
    this.refresh(figure);
  }

  async savePicture() { download(await this.studio.picture(), `${this.fileName()}.png`); this.changed = true; }

  /** {joint: [x, y, z, angle]} of every joint that is turned, and where a shifted body is: what `vitruvian pose --joints` reads. */
  savePose() {
    const f = this.figure, out = {};
    f?.joints.forEach((name, j) => {
      const [x, y, z, w] = toQuaternion(localRotation(f.pose, f.parents, j)), s = Math.hypot(x, y, z), angle = 2 * Math.atan2(s, w);
      if (s > 1e-5) out[name] = [x / s, y / s, z / s, angle > Math.PI ? angle - 2 * Math.PI : angle].map((n) => Number(n.toFixed(7)));
    });
    if (f?.shift) out[`${f.joints[0]}.translation`] = center(f.pose, f.centers, 0).map((x, c) => Number((x - f.centers[c]).toFixed(7)));
    download(new Blob([JSON.stringify(out, null, 1)], { type: "application/json" }), `${this.fileName()}.json`);
  }

  fileName() { return `${(this.hello?.title ?? "vitruvian").replace(/[^\w.-]+/g, "-")}-${Math.floor(this.header.frame)}`; }

  // Controls --------------------------------------------------------------------------------------------------------

  bindControls() {
    const { source, studio } = this, click = (id, act) => { $(id).onclick = act; };
    const toggle = (id, act) => click(id, () => { $(id).setAttribute("aria-pressed", String(!pressed(id))); act(pressed(id)); });
    const play = () => (this.header.playing ? source.pause() : source.play());
    const panel = (id) => () => { $(id).open = !$(id).open; };
    click("play", play);
    click("step-back", () => source.step(-1));
    click("step-next", () => source.step(1));
    toggle("loop", (on) => source.loop(on));
    $("speed").onchange = () => source.speed(Number($("speed").value));
    const line = $("timeline");
    line.oninput = () => {
      if (!this.scrubbing) source.pause(); // even if it seems to stand: what was asked a moment ago may not show yet
      this.scrubbing = true;
      source.seek(Number(line.value));
      line.style.setProperty("--fill", `${(100 * line.value) / (line.max || 1)}%`);
    };
    line.onchange = () => { this.scrubbing = false; };
    for (const id of ["bones", "sites"]) toggle(id, () => this.looks());
    toggle("wire", () => this.fineness.apply());
    for (const id of MODES) click(id, () => this.setMode(id));
    for (const view of ["front", "side", "back", "face"]) click(`view-${view}`, () => studio.fly(view));
    toggle("follow", (on) => { studio.follow = on; });
    click("undo", () => this.history.undo());
    click("redo", () => this.history.redo());
    click("export", () => this.savePicture());
    click("export-pose", () => this.savePose());
    click("reset-pose", () => this.reset());
    toggle("help", (on) => { keyList($("keys")); $("keys").hidden = !on; });
    $("deformer").onchange = () => this.setDeformer($("deformer").value);
    $("shapes-panel").ontoggle = () => this.explorer.shapes.update();
    click("compare", () => this.figure && this.toggleCompare());
    for (const p of document.querySelectorAll(".panel")) p.addEventListener("toggle", () => { if (p.open && narrow()) closePanels(p); });
    const { explorer } = this;
    $("loa").onchange = () => explorer.chooseLevel(Number($("loa").value));
    toggle("arcs", () => explorer.showRanges());
    click("fly", () => explorer.flyTo(this.selected));
    click("unselect", () => explorer.select(-1));
    click("reset-shapes", () => this.resetShapes());
    const cycle = () => { const all = [...$("deformer").options].map((o) => o.value); this.setDeformer(all[(all.indexOf($("deformer").value) + 1) % all.length]); };
    const speed = (d) => () => { const s = $("speed"); s.selectedIndex = Math.min(s.length - 1, Math.max(0, s.selectedIndex + d)); source.speed(Number(s.value)); };
    const seek = (panel, filter) => () => { $(panel).open = true; $(filter).focus(); };
    const press = (id) => () => $(id).click();
    keys({
      Space: play, ArrowLeft: () => source.step(-1), ArrowRight: () => source.step(1), "[": speed(-1), "]": speed(1), L: press("loop"),
      Home: () => source.seek(0), End: () => source.seek(this.hello.frames - 1),
      B: press("bones"), W: press("weights"), C: press("segments"), M: press("wire"), P: press("sites"), D: cycle, K: press("follow"),
      1: press("view-front"), 2: press("view-side"), 3: press("view-back"), 4: press("view-face"), S: press("export"), E: press("export-pose"),
      T: press("theme"), "?": press("help"), J: panel("joints-panel"), F: panel("shapes-panel"), I: panel("findings-panel"), 0: press("reset-pose"),
      N: panel("sites-panel"), A: () => explorer.nextLevel(), G: press("fly"), R: press("arcs"), U: press("ignore-limits"), V: () => explorer.nextCamera(),
      Q: press("compare"), "*": press("heat"), $: press("fineness"), ":": () => this.heat.next(), Z: press("stripes"), X: press("reset-shapes"), H: panel("hands-panel"), O: press("hands-second"), Y: press("look-hand"), 8: press("reset-hands"), 9: press("save-hands"), Backspace: press("unselect"),
      "/": seek("joints-panel", "joint-filter"), ",": seek("sites-panel", "site-filter"), ".": seek("shapes-panel", "shape-filter"),
      "Ctrl+Z": press("undo"), "Ctrl+Shift+Z": press("redo"), "Ctrl+Y": press("redo"),
      Escape: () => { closePanels(); if (pressed("help")) $("help").click(); },
    });
    this.bindPointer();
  }

  bindPointer() {
    const { canvas, camera } = this.studio, label = $("label");
    let down = null;
    canvas.addEventListener("pointerdown", (e) => { down = [e.clientX, e.clientY]; label.hidden = true; });
    canvas.addEventListener("pointerleave", () => { label.hidden = true; });
    canvas.addEventListener("pointermove", (e) => {
      if (e.buttons || !this.figure) return;
      const hit = this.at(e);
      label.hidden = !hit;
      if (hit) { label.textContent = hit.name; label.style.left = `${e.clientX}px`; label.style.top = `${e.clientY}px`; }
    });
    canvas.addEventListener("click", (e) => {
      if (!this.figure || !down || Math.hypot(e.clientX - down[0], e.clientY - down[1]) > 4) return;
      const hit = this.at(e);
      let j = hit?.kind === "joint" ? hit.index : -1;
      if (j < 0 && (this.mode !== "skin" || $("joints-panel").open)) j = pick(this.figure, ...this.studio.local(e.clientX, e.clientY).slice(0, 2), camera, ...this.studio.local(e.clientX, e.clientY).slice(2));
      if (hit?.kind === "site") this.explorer.site(hit.index);
      else if (j >= 0) this.explorer.select(j);
    });
  }

  at(e) {
    const [x, y, w, h] = this.studio.local(e.clientX, e.clientY);
    return this.marks.nearest(e.clientX, e.clientY) ?? this.figure.overlay.nearest(x, y, this.studio.camera, w, h);
  }
}

const narrow = () => innerWidth <= 480; // a telephone: room for one panel
const closePanels = (but = null) => { for (const p of document.querySelectorAll(".panel")) if (p !== but) p.open = false; };
const MODES = ["weights", "segments", "stripes", "heat"];
const pressed = (id) => $(id).getAttribute("aria-pressed") === "true";
const without = (blocks) => (blocks?.vertices ? { pose: blocks.pose, displacers: blocks.displacers, markers: blocks.markers } : blocks);
