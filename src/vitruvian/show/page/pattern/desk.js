// The document of a pattern and what happens to it: changes that can be undone, the connection to the server, what is
// selected. Who wants to know listens by `on`.

import { VERSION, decode } from "../wire.js";
import { clean, follow } from "./pairs.js";
import { applyDimensions } from "./shaping.js";

const PIECE = 24000; // characters of a message at most
const PAUSE = 200; // milliseconds after a change until the server hears of it
const KEPT = 200; // steps that can be undone

export class Desk {
  constructor(token) {
    Object.assign(this, { token, doc: null, measures: {}, seq: 0, findings: [], problem: "", symmetric: true, connected: false });
    this.done = [];
    this.undone = [];
    this.selection = null; // {panel, kind: "panel" | "edge" | "vertex" | "control" | "seam", index, more: vertices too}
    this.listeners = {};
    this.retry = 0;
    this.connect();
  }

  on(what, heard) { (this.listeners[what] ??= []).push(heard); }
  tell(what, ...words) { for (const heard of this.listeners[what] ?? []) heard(...words); }

  // Changes -----------------------------------------------------------------------------------------------------------

  /** Change the document by `act(doc)`; several with the same key, one after the other, are undone together. */
  change(act, key = null) {
    const before = JSON.stringify(this.doc), doc = JSON.parse(before);
    let answer;
    try { answer = act(doc); } catch (error) { this.tell("notice", error.message); return undefined; }
    if (this.symmetric) follow(doc, JSON.parse(before));
    this.broken = applyDimensions(doc, this.measures);
    this.settle(before, doc, key);
    return answer;
  }

  settle(before, doc, key = null) {
    if (JSON.stringify(doc) === before) return;
    if (!key || this.key !== key) this.done.push({ before, selection: this.selection });
    if (this.done.length > KEPT) this.done.shift();
    this.key = key;
    this.undone.length = 0;
    this.put(doc);
  }

  /** Start a drag: `act(doc)` is done anew for each place of the pointer, on the document as it was. */
  grasp() { this.held = JSON.stringify(this.doc); this.key = null; }

  drag(act) {
    if (!this.held) return;
    const doc = JSON.parse(this.held);
    act(doc);
    if (this.symmetric) follow(doc, JSON.parse(this.held));
    this.doc = doc;
    this.tell("drawn");
  }

  release(keep = true) {
    const { held } = this;
    if (!held) return;
    this.held = null;
    const doc = this.doc;
    this.doc = JSON.parse(held);
    if (keep) { this.broken = applyDimensions(doc, this.measures); this.settle(held, doc); }
    if (!keep || JSON.stringify(doc) === held) this.tell("drawn");
  }

  undo() { this.swap(this.done, this.undone); }
  redo() { this.swap(this.undone, this.done); }

  swap(from, to) {
    if (this.held) return;
    const step = from.pop();
    if (!step) return;
    to.push({ before: JSON.stringify(this.doc), selection: this.selection });
    this.key = null;
    this.selection = step.selection;
    this.put(JSON.parse(step.before));
  }

  put(doc) {
    this.doc = doc;
    if (!this.valid(this.selection)) this.selection = null;
    this.seq++;
    this.unsaved = true;
    this.tell("drawn");
    this.tell("changed");
    this.tell("selected");
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this.send(), PAUSE);
  }

  // Selection ---------------------------------------------------------------------------------------------------------

  select(selection) {
    this.selection = this.valid(selection) ? selection : null;
    this.tell("selected");
  }

  valid(s) {
    if (!s) return false;
    if (s.kind === "seam") return Boolean(this.doc.seams[s.index]);
    const panel = this.panel(s.panel);
    if (!panel) return false;
    if (s.kind === "edge") return Boolean(panel.edges[s.index]);
    if (s.kind === "vertex") return Boolean(panel.vertices[s.index]) && (s.more ?? []).every((v) => panel.vertices[v]);
    return s.kind !== "control" || Boolean(panel.edges[s.index]?.points?.[s.point]);
  }

  panel(name) { return this.doc?.panels.find((p) => p.name === name); }

  // The server ----------------------------------------------------------------------------------------------------------

  connect() {
    const socket = new WebSocket(`ws://${location.host}/stream`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => socket.send(JSON.stringify({ type: "hello", token: this.token, version: VERSION }));
    socket.onmessage = ({ data }) => this.receive(decode(data));
    socket.onclose = ({ code, reason }) => {
      this.connected = false;
      if (code === 1008) { this.tell("state", `The server refused this page${reason ? `: ${reason}` : ""}. Open the address that it printed.`); return; }
      if (code === 4001) { this.tell("state", "The pattern was opened in another page. Reload this one to take it back."); return; }
      this.tell("state", "Connection lost. Nothing is lost here: download the pattern, or wait\u2026");
      setTimeout(() => this.connect(), Math.min(8000, 250 * 2 ** this.retry++));
    };
    this.socket = socket;
  }

  receive({ header, blocks }) {
    const arrays = blocks[""] ?? {};
    if (header.type === "hello") {
      this.connected = true;
      this.retry = 0;
      Object.assign(this, { measures: header.measures, rules: header.rules });
      this.tell("state", "");
      if (!this.doc) {
        this.doc = clean(header.document);
        Object.assign(this, { unsaved: !header.saved, seq: header.seq });
        this.tell("welcome", header);
        this.tell("drawn");
        this.tell("changed");
        this.tell("selected");
        if (header.recovered) this.tell("notice", "These are your changes that were not saved last time.");
      } else this.send(); // what was drawn while the server was away
    } else if (header.type === "findings") {
      Object.assign(this, { findings: header.findings, problem: header.problem });
      this.tell("findings");
    } else if (header.type === "saved") {
      this.unsaved = header.seq !== this.seq;
      this.tell("saved", header);
    } else if (header.type === "refused" || header.type === "error") this.tell("notice", header.message, "bad");
    else this.tell(header.type, header, arrays);
  }

  /** Let the server know how the document stands. */
  send() {
    clearTimeout(this.timer);
    this.timer = 0;
    const text = JSON.stringify(this.doc);
    for (let at = 0; at === 0 || at < text.length; at += PIECE) {
      this.ask({ type: "pattern", seq: this.seq, text: text.slice(at, at + PIECE), last: at + PIECE >= text.length });
    }
  }

  /** Ask the server for something about the document as it is now. */
  request(request) {
    if (this.timer) this.send();
    this.ask(request);
  }

  ask(request) { if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(request)); }
}
