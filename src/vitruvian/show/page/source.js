// Where frames come from: a live server, or a recording in the page. Both have the same controls.
// on.welcome(header), on.mesh(header, blocks), on.frame(header, blocks), on.state(text): called as things arrive.

import { pictures } from "./pictures.js";
import { VERSION, decode, messages } from "./wire.js";

/** Frames over a WebSocket. The server keeps the clock; every frame drawn is acknowledged. */
export class LiveSource {
  constructor(on, token) {
    this.on = on;
    this.token = token;
    this.live = true;
    this.connected = false;
    this.state = { playing: false, speed: 1, loop: true };
    this.retry = 0;
    this.pending = null;
    this.connect();
  }

  connect() {
    const socket = new WebSocket(`ws://${location.host}/stream`);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => socket.send(JSON.stringify({ type: "hello", token: this.token, version: VERSION }));
    socket.onmessage = ({ data }) => this.receive(decode(data));
    socket.onclose = ({ code, reason }) => {
      this.connected = false;
      this.pending = null;
      if (code === 1008) {
        this.on.state(`The server refused this page${reason ? ": " + reason : ""}. Open the address that it printed.`);
        return;
      }
      const wait = Math.min(8000, 250 * 2 ** this.retry++);
      this.on.state("Connection lost. Trying again\u2026");
      setTimeout(() => this.connect(), wait);
    };
    this.socket = socket;
  }

  receive(message) {
    const { header } = message;
    if (header.type === "hello") {
      this.connected = true;
      this.retry = 0;
      this.on.state("");
      this.on.welcome(header);
    } else if (header.type === "picture") pictures.take(header, message.blocks);
    else if (header.type === "mesh") this.on.mesh(header, message.blocks);
    else if (header.type === "search") this.on.picking.searching.heard(header);
    else if (header.type === "reached") this.on.handles.reached(header);
    else if (header.type === "error") this.on.state(header.message);
    else if (header.type === "frame") {
      this.state = { playing: header.playing, speed: header.speed, loop: header.loop };
      if (this.pending) this.ack(this.pending.header.seq); // replaced before it was drawn
      this.pending = message;
    }
  }

  /** Hand over the newest frame, once per drawn frame. */
  tick() {
    const message = this.pending;
    if (!message) return;
    this.pending = null;
    this.on.frame(message.header, message.blocks);
    this.ack(message.header.seq);
  }

  ack(seq) { this.send({ type: "ack", seq }); }

  send(request) { if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(request)); }

  play() { this.send({ type: "play" }); }
  pause() { this.send({ type: "pause" }); }
  seek(frame) { this.send({ type: "seek", frame }); }
  step(frames) { this.send({ type: "step", frames }); }
  speed(value) { this.send({ type: "speed", value }); }
  loop(value) { this.send({ type: "loop", value }); }
  deformer(actor, name) { this.send({ type: "deformer", actor, name }); }
  rotation(actor, joint, rotation) { this.send({ type: "set_rotation", actor, joint, rotation }); }
  /** `weight` null: what the clip gives. */
  displacer(actor, name, weight) { this.send(weight === null ? { type: "clear_displacer", actor, name } : { type: "set_displacer", actor, name, weight }); }
  clear(actor) { this.send({ type: "clear_pose", actor }); }
  /** Have these turns {joint: xyzw} and this shift of the first joint on top of the clip, and no others. */
  pose(actor, turns, shift) { this.send({ type: "set_pose", actor, turns, shift }); }
  /** Bring the handle `name` to its place among `places` {handle: [x, y, z]}, which hold the others; answered by `reached`. */
  reach(actor, name, places, gesture, level) { this.send({ type: "reach", actor, name, places, gesture, level }); }
  /** `roundings`: {joint: words} of those that differ from the body's own; `rounded`: with the second pass. */
  hands(actor, roundings, rounded) { this.send({ type: "set_hands", actor, roundings, rounded }); }
  /** `points`: {feature point: [x, y, z]} of a scan, to be saved. */
  landmarks(actor, points) { this.send({ type: "set_landmarks", actor, points }); }
  /** Look for the feature points of a scan. */
  find(actor) { this.send({ type: "find_landmarks", actor }); }
  /** Take the girths that `points` allow. */
  girths(actor, points) { this.send({ type: "take_girths", actor, points }); }
  stopSearch(actor) { this.send({ type: "stop_search", actor }); }
  /** A piece of the CSV of all weights of a body, to be saved with the last one. */
  weights(actor, text, last) { this.send({ type: "set_weights", actor, text, last }); }
}

/** Frames out of a recording, with a clock of its own; between frames poses are mixed in proportion. */
export class RecordedSource {
  constructor(on, bytes) {
    this.on = on;
    this.live = false;
    this.connected = false;
    this.frames = [];
    this.state = { playing: true, speed: 1, loop: true };
    this.frame = 0;
    this.round = 0;
    this.last = null;
    this.dirty = true;
    this.travel = {};
    this.mixed = {};
    for (const { header, blocks } of messages(bytes)) {
      if (header.type === "hello") on.welcome((this.hello = header));
      else if (header.type === "picture") pictures.take(header, blocks);
      else if (header.type === "mesh") { this.travel[header.actor] = header.travel; on.mesh(header, blocks); }
      else this.frames.push({ header, blocks });
    }
    this.state.playing = this.frames.length > 1;
  }

  tick(now) {
    const n = this.frames.length, { state } = this;
    if (state.playing && this.last !== null) {
      this.frame += Math.min((now - this.last) / 1000, 0.25) * state.speed * this.hello.fps;
      if (this.frame >= n && state.loop) { this.round += Math.floor(this.frame / n); this.frame %= n; }
      else if (!state.loop && this.frame >= n - 1) { this.frame = n - 1; state.playing = false; this.dirty = true; }
    }
    this.last = now;
    if (!state.playing && !this.dirty) return;
    this.dirty = false;
    const i = Math.min(Math.floor(this.frame + 1e-6), n - 1), part = this.frame - i;
    const { header, blocks } = this.frames[i];
    const shown = part < 1e-4 || n === 1 ? blocks : this.mix(i, part);
    this.on.frame({ ...header, ...state, frame: this.frame, round: this.round }, shown);
  }

  mix(i, part) {
    const here = this.frames[i].blocks, wraps = i + 1 === this.frames.length;
    const next = this.frames[wraps ? 0 : i + 1].blocks;
    for (const actor in here) {
      const travel = this.travel[actor] ?? [0, 0, 0], travels = travel.some((x) => x);
      const out = (this.mixed[actor] = { ...here[actor] });
      if (wraps && !travels) continue;
      if (here[actor].vertices) { // of a body they are of their own pose only; clothes keep up with those that are mixed
        if (!here[actor].pose) Object.assign(out, this.between(here[actor], next[actor], part, wraps ? travel : [0, 0, 0]));
        continue;
      }
      for (const channel of ["pose", "displacers", "markers"]) {
        const a = here[actor][channel]?.array, b = next[actor][channel]?.array;
        if (!a) continue;
        const c = new Float32Array(a.length);
        for (let k = 0; k < a.length; k++) {
          const ahead = wraps && channel === "pose" && k % 4 === 3 ? travel[((k / 4) | 0) % 3] : 0;
          c[k] = a[k] + part * (b[k] + ahead - a[k]);
        }
        out[channel] = { ...here[actor][channel], array: c };
      }
    }
    return this.mixed;
  }

  /** Points and normals of clothes that part of the way to the next frame, which is `ahead` of where it says. */
  between(a, b, part, ahead) {
    const [p, q] = [a.vertices, b.vertices], [h, k] = [p.scale / 32767, q.scale / 32767];
    const points = new Float32Array(p.array.length), turned = new Float32Array(p.array.length);
    for (let i = 0; i < points.length; i++) {
      const axis = i & 3;
      if (axis === 3) continue;
      const from = p.origin[axis] + h * p.array[i];
      points[i] = from + part * (q.origin[axis] + k * q.array[i] + ahead[axis] - from);
      turned[i] = a.normals.array[i] + part * (b.normals.array[i] - a.normals.array[i]);
    }
    return { vertices: { array: points, scale: 32767, origin: [0, 0, 0] }, normals: { array: turned } };
  }

  play() {
    if (!this.state.loop && this.frame >= this.frames.length - 1.5) this.frame = 0;
    this.state.playing = this.frames.length > 1;
    this.dirty = true;
  }
  pause() { this.state.playing = false; this.dirty = true; }
  seek(frame) { this.frame = Math.min(Math.max(frame, 0), this.frames.length - 1); this.dirty = true; }
  step(n) {
    const length = this.frames.length;
    this.state.playing = false;
    this.frame = (((Math.round(this.frame) + n) % length) + length) % length;
    this.dirty = true;
  }
  speed(value) { this.state.speed = value; this.dirty = true; }
  loop(value) { this.state.loop = value; this.dirty = true; }
  deformer() { this.dirty = true; }
  rotation() {}
  displacer() {}
  clear() {}
  pose() {}
  hands() {}
  landmarks() {}
  weights() {}
}
