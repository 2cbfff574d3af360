// The room: renderer, lights, backdrop, floor with contact shadows and grid, camera.

import * as THREE from "three";
import { OrbitControls } from "./vendor/OrbitControls.js";

const THEMES = {
  dark: { centre: "#54565b", edge: "#17181b", grid: [1, 1, 1, 0.07], shadow: 0.72, exposure: 1.0 },
  light: { centre: "#f3f1ee", edge: "#c3beb8", grid: [0, 0, 0, 0.075], shadow: 0.5, exposure: 1.06 },
};
const BLOBS = 20; // spheres under which the floor is darkened
const CELLS = 96, SPAN = 2.6; // texture of the contact shadow: cells and metres a side
const GRID = 0.5; // metres
const FOV = 28; // degrees, vertical
const GRAIN = 0.85; // pixels

/** Quality steps; the page takes the best that keeps up. `dpr` caps the pixels, `shadows` is the key light's map. */
const STEPS = [
  { name: "sketch", dpr: 0.5, shadows: false },
  { name: "draft", dpr: 0.75, shadows: false },
  { name: "plain", dpr: 1, shadows: false },
  { name: "good", dpr: 1.25, shadows: true },
  { name: "best", dpr: 2, shadows: true },
];

const BACKDROP = `
  varying vec2 at; uniform vec3 centre, edge; uniform float aspect;
  float grain(vec2 p) { return fract(sin(dot(p, vec2(12.9898, 78.233))) * 43758.5453); }
  void main() {
    vec2 p = (at - vec2(0.0, 0.08)) * vec2(min(aspect, 1.7), 1.0);
    float t = smoothstep(0.0, 1.75, length(p));
    gl_FragColor = vec4(mix(centre, edge, t) + (grain(gl_FragCoord.xy) - 0.5) / 255.0, 1.0);
  }`;

const FLOOR = `
  varying vec3 world; uniform vec3 middle; uniform sampler2D contact; uniform vec2 corner; uniform vec4 grid; uniform float strength, reach;
  void main() {
    float far = length(world.xz - middle.xz);
    if (far > reach) discard;
    float fade = 1.0 - smoothstep(0.25 * reach, reach, far);
    vec2 cell = world.xz / ${GRID.toFixed(2)}, width = fwidth(cell);
    vec2 line = 1.0 - smoothstep(vec2(0.0), width * 1.3, abs(fract(cell - 0.5) - 0.5));
    float g = max(line.x, line.y) * grid.a * fade / (1.0 + 6.0 * max(width.x, width.y));
    float dark = strength * texture2D(contact, (world.xz - corner) / ${SPAN.toFixed(2)}).r;
    gl_FragColor = vec4(grid.rgb * g * (1.0 - dark), g * (1.0 - dark) + dark);
  }`;

export class Studio {
  constructor(canvas) {
    this.canvas = canvas;
    const software = drawnBySoftware();
    this.software = software;
    document.documentElement.classList.toggle("software", software);
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: !software, powerPreference: "high-performance" });
    this.renderer.toneMapping = THREE.ACESFilmicToneMapping;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.level = this.software ? 2 : STEPS.length - 1;
    this.took = 20; // milliseconds a picture, lately

    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(FOV, 1, 0.05, 80);
    this.camera.position.set(1.6, 1.45, 4.4);
    this.controls = new OrbitControls(this.camera, canvas);
    Object.assign(this.controls, { enableDamping: true, dampingFactor: 0.09, maxDistance: 30, minDistance: 0.15, zoomSpeed: 0.8, maxPolarAngle: 1.75 });
    this.controls.target.set(0, 0.9, 0);
    this.controls.addEventListener("start", () => { this.flight = null; this.leave(); });
    this.follow = true;
    this.followed = null;
    this.light();
    this.backdrop();
    this.ground();
    this.theme("dark");
    this.quality(this.level);
    new ResizeObserver(() => this.resize()).observe(canvas.parentElement);
    this.resize();
  }

  light() {
    const lamp = (color, intensity, x, y, z) => {
      const l = new THREE.DirectionalLight(color, intensity);
      l.userData.from = new THREE.Vector3(x, y, z);
      this.rig.add(l, l.target);
      return l;
    };
    this.rig = new THREE.Group();
    this.scene.add(this.rig);
    this.key = lamp("#fff0de", 2.7, 2.1, 2.7, 2.3);
    this.fill = lamp("#cfe0ff", 0.35, -3, 1.2, 2.2);
    this.rim = lamp("#ffffff", 1.9, -1.7, 2.6, -3);
    this.spark = lamp("#ffffff", 0.3, 0.8, 0.95, 3.3); // near the camera: what shines in the eyes
    for (const l of [this.key, this.fill, this.rim, this.spark]) l.position.copy(l.userData.from);
    const { shadow } = this.key;
    shadow.mapSize.set(1536, 1536);
    Object.assign(shadow.camera, { left: -1.3, right: 1.3, top: 1.5, bottom: -1.5, near: 0.5, far: 9 });
    Object.assign(shadow, { bias: -0.0004, normalBias: 0.012, radius: 9 });
    const sky = softboxes(), strength = 0.5;
    if (this.software) { // prefiltering reflections would take seconds here: only the diffuse part of the same sky
      this.scene.add(new THREE.LightProbe(harmonics(sky), strength));
      return;
    }
    const texture = new THREE.DataTexture(sky.data, sky.width, sky.height, THREE.RGBAFormat, THREE.FloatType);
    texture.mapping = THREE.EquirectangularReflectionMapping;
    texture.magFilter = texture.minFilter = THREE.LinearFilter;
    texture.needsUpdate = true;
    const generator = new THREE.PMREMGenerator(this.renderer);
    this.scene.environment = generator.fromEquirectangular(texture).texture;
    this.scene.environmentIntensity = strength;
    generator.dispose();
    texture.dispose();
  }

  backdrop() {
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.Float32BufferAttribute([-1, -1, 0, 3, -1, 0, -1, 3, 0], 3));
    const material = new THREE.ShaderMaterial({
      uniforms: { centre: { value: new THREE.Vector3() }, edge: { value: new THREE.Vector3() }, aspect: { value: 1 } },
      vertexShader: "varying vec2 at; void main() { at = position.xy; gl_Position = vec4(position.xy, 1.0, 1.0); }",
      fragmentShader: BACKDROP, depthTest: false, depthWrite: false, toneMapped: false,
    });
    this.wall = new THREE.Mesh(geometry, material);
    Object.assign(this.wall, { frustumCulled: false, renderOrder: -10 });
    this.scene.add(this.wall);
  }

  ground() {
    this.contact = new THREE.DataTexture(new Uint8Array(CELLS * CELLS), CELLS, CELLS, THREE.RedFormat);
    this.contact.magFilter = this.contact.minFilter = THREE.LinearFilter;
    this.contact.unpackAlignment = 1;
    const disc = new THREE.CircleGeometry(1, 48).rotateX(-Math.PI / 2);
    const material = new THREE.ShaderMaterial({
      uniforms: {
        middle: { value: new THREE.Vector3() }, grid: { value: new THREE.Vector4() }, strength: { value: 0.6 }, reach: { value: 4 },
        contact: { value: this.contact }, corner: { value: new THREE.Vector2() },
      },
      vertexShader: "varying vec3 world; void main() { vec4 w = modelMatrix * vec4(position, 1.0); world = w.xyz; gl_Position = projectionMatrix * viewMatrix * w; }",
      fragmentShader: FLOOR, transparent: true, depthWrite: false, premultipliedAlpha: true, toneMapped: false,
      blending: THREE.CustomBlending, blendSrc: THREE.OneFactor, blendDst: THREE.OneMinusSrcAlphaFactor,
    });
    this.floor = new THREE.Mesh(disc, material);
    Object.assign(this.floor, { frustumCulled: false, renderOrder: -9 });
    this.cast = new THREE.Mesh(disc, new THREE.ShadowMaterial({ opacity: 0.26, transparent: true, depthWrite: false }));
    Object.assign(this.cast, { frustumCulled: false, renderOrder: -8, receiveShadow: true });
    this.cast.scale.setScalar(3);
    this.cast.position.y = 0.0005;
    this.scene.add(this.floor, this.cast);
  }

  theme(name) {
    const t = THEMES[name], srgb = (hex) => { const n = parseInt(hex.slice(1), 16); return [n >> 16, (n >> 8) & 255, n & 255].map((x) => x / 255); };
    this.wall.material.uniforms.centre.value.fromArray(srgb(t.centre));
    this.wall.material.uniforms.edge.value.fromArray(srgb(t.edge));
    this.floor.material.uniforms.grid.value.fromArray(t.grid);
    this.floor.material.uniforms.strength.value = t.shadow;
    this.cast.material.opacity = name === "dark" ? 0.34 : 0.22;
    this.renderer.toneMappingExposure = t.exposure;
    this.renderer.setClearColor(t.edge);
    this.stale = true;
  }

  quality(level) {
    this.level = level;
    const step = STEPS[level];
    this.renderer.shadowMap.enabled = step.shadows;
    this.key.castShadow = step.shadows;
    this.cast.visible = step.shadows;
    this.resize();
  }

  /** When nothing moves any more, draw once with four samples a pixel where the screen itself has no smoothing. */
  settle(idle) {
    const ratio = this.software && idle ? 2 : Math.min(devicePixelRatio, STEPS[this.level].dpr);
    if (ratio === this.renderer.getPixelRatio()) return;
    this.renderer.setPixelRatio(ratio);
    this.stale = true;
  }

  get qualityName() { return STEPS[this.level].name; }

  resize() {
    const { clientWidth: w, clientHeight: h } = this.canvas.parentElement;
    if (!w || !h) return;
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, STEPS[this.level].dpr));
    this.renderer.setSize(w, h, false);
    const cell = this.cells?.[0], aspect = cell ? cell.w / Math.max(cell.h, 1) : w / h;
    this.camera.aspect = aspect;
    this.camera.updateProjectionMatrix();
    this.wall.material.uniforms.aspect.value = aspect;
    this.stale = true;
  }

  /** Draw in each of `cells` {x, y, w, h in pixels of the window, wear()} instead of once everywhere (null). */
  divide(cells) {
    const before = this.narrow;
    this.cells = cells?.length && cells[0].w > 1 && cells[0].h > 1 ? cells : null;
    this.resize();
    const { position } = this.camera, { target } = this.controls;
    if (this.box) position.sub(target).multiplyScalar(before / this.narrow).add(target); // as much is seen as before
  }

  /** How much of the height of a figure fits: 1 unless the picture is narrow. Columns leave less room at the sides. */
  get narrow() {
    if (!this.cells || !this.box) return Math.min(1, this.camera.aspect / 0.62);
    const { low, high } = this.box, wide = Math.max(high[0] - low[0], high[2] - low[2]) / Math.max(high[1] - low[1], 0.05);
    return Math.min(1, this.camera.aspect / Math.min(0.62, Math.max(0.38, 1.1 * wide)));
  }

  /** [x, y, w, h]: a point of the window within the cell that it is in, or in the whole picture. */
  local(x, y) {
    const cell = this.cells?.find((c) => x >= c.x && x <= c.x + c.w && y >= c.y && y <= c.y + c.h) ?? this.cells?.[0];
    return cell ? [x - cell.x, y - cell.y, cell.w, cell.h] : [x, y, this.canvas.clientWidth, this.canvas.clientHeight];
  }

  /** Pixel [x, y] of the window of a world point after `project`, in the first cell where there are some. */
  window({ x, y }) {
    const { x: left, y: top, w, h } = this.cells?.[0] ?? { x: 0, y: 0, w: this.canvas.clientWidth, h: this.canvas.clientHeight };
    return [left + ((x + 1) / 2) * w, top + ((1 - y) / 2) * h];
  }

  /** Step down when pictures take longer than 1/30 s for a while; the choice is shown, and never silently undone. */
  watch(milliseconds) {
    this.took += (Math.min(milliseconds, 100) - this.took) / 30; // the mean: single pictures take whole screen refreshes
    if (this.took > 32 && this.level > 0) { this.took = 20; this.quality(this.level - 1); }
  }

  /** Put the figure of this box (min, max) into the picture at once. */
  frame(low, high) {
    this.box = { low, high };
    const { position, target } = this.pose("start");
    this.camera.position.copy(position);
    this.controls.target.copy(target);
    this.flight = null;
    this.stale = true;
  }

  /** Camera position and target of a view: start, front, side, back, face. */
  pose(view) {
    const { low, high } = this.box, height = Math.max(high[1] - Math.min(0, low[1]), 0.05);
    const middle = this.followed ?? new THREE.Vector3((low[0] + high[0]) / 2, 0, (low[2] + high[2]) / 2);
    const half = Math.tan((FOV * Math.PI) / 360);
    if (view === "face") {
      const face = this.head?.() ?? new THREE.Vector3(middle.x, low[1] + 0.93 * height, middle.z);
      return { position: face.clone().add(new THREE.Vector3(0.09, 0.0, 0.66)), target: face };
    }
    const bars = this.cells ? 1 : 1 + 60 / Math.max(this.canvas.clientHeight, 200);
    const distance = (height * 0.585 * bars) / half / this.narrow;
    const turn = { start: 0.5, front: 0, side: Math.PI / 2, back: Math.PI }[view];
    const target = new THREE.Vector3(middle.x, low[1] + 0.475 * height, middle.z);
    const rise = 0.33 * height; // the camera is a little below eye height and looks slightly down
    const flat = Math.sqrt(distance * distance - rise * rise);
    const offset = new THREE.Vector3(Math.sin(turn) * flat, rise, Math.cos(turn) * flat);
    return { position: target.clone().add(offset), target };
  }

  fly(view) { if (this.box) this.flyTo(this.pose(view)); }

  /** Fly to {position, target, fov in degrees}. */
  flyTo({ position, target, fov = FOV }) {
    this.leave();
    const { camera, controls } = this;
    this.flight = { t: 0, from: { position: camera.position.clone(), target: controls.target.clone(), fov: camera.fov }, to: { position, target, fov } };
    this.stale = true;
  }

  /** Fly so that `reach` metres above and below the point are seen, from this side, or from `outward` when it is turned away. */
  approach(point, reach, outward = null) {
    const from = this.camera.position.clone().sub(this.controls.target).normalize();
    if (outward && from.dot(outward) < 0.3) from.multiplyScalar(0.35).add(outward).normalize();
    this.face(point, reach, from);
  }

  /** The same from the side `from`. */
  face(point, reach, from) {
    from.y = Math.max(-0.15, Math.min(0.6, from.y)); // not from under the floor, not from the top of the head
    if (from.lengthSq() < 1e-6) from.set(0, 0, 1);
    const distance = Math.max(reach / Math.tan((FOV * Math.PI) / 360), this.controls.minDistance);
    this.flyTo({ position: point.clone().addScaledVector(from.normalize(), distance), target: point.clone() });
  }

  /** Fly to where `get` says, {position, target}, and ride along until somebody moves the camera. `fov` in radians. */
  through(get, fov) {
    this.flyTo({ ...get(), fov: (fov * 180) / Math.PI });
    this.ride = get;
    this.controls.maxPolarAngle = Math.PI;
    this.controls.minDistance = 0;
  }

  leave() {
    this.ride = null;
    Object.assign(this.controls, { maxPolarAngle: 1.75, minDistance: 0.15 });
  }

  /** Move the camera along with the point that is followed. */
  track(point, dt, playing) {
    if (!this.followed) { this.followed = point.clone(); this.pace = new THREE.Vector3(); return; }
    const step = point.clone().sub(this.followed);
    step.y = Math.abs(step.y) > 0.5 ? step.y : 0; // bobbing is the figure's, not the camera's
    if (!playing) this.pace.set(0, 0, 0);
    if (!playing && step.length() < 1e-4) return;
    if (step.length() > 1) this.pace.set(0, 0, 0); // a cut: go there at once
    else { // an alpha-beta filter: smooth, and without lag behind a steady walk
      const a = 1 - Math.exp(-3.5 * dt), error = step.addScaledVector(this.pace, -dt);
      const move = this.pace.clone().multiplyScalar(dt).addScaledVector(error, a);
      if (dt > 0 && playing) this.pace.addScaledVector(error, (a * a) / (2 - a) / dt);
      step.copy(move);
    }
    this.followed.add(step);
    if (this.follow && !this.ride) { this.shift(step); this.stale = true; }
  }

  shift(step) {
    this.camera.position.add(step);
    this.controls.target.add(step);
    for (const end of this.flight ? [this.flight.from, this.flight.to] : []) { end.position.add(step); end.target.add(step); }
  }

  /** Metres that nobody can tell apart: most of a pixel where the figure is nearest. 0 with a graphics processor: draw all. */
  grain() {
    if (!this.software || !(this.near > 0)) return 0;
    const pixels = this.renderer.domElement.height * (this.height / (this.canvas.clientHeight || 1));
    return (GRAIN * 2 * this.near * Math.tan((this.camera.fov * Math.PI) / 360)) / pixels;
  }

  /** Metres of a pixel of the window at a world point. */
  pixel(point) {
    return (2 * this.camera.position.distanceTo(point) * Math.tan((this.camera.fov * Math.PI) / 360)) / (this.height || 1);
  }

  /** Pixels of the window from the bottom to the top of a picture. */
  get height() { return this.cells?.[0].h ?? this.canvas.clientHeight; }

  /** Contact shadow: how much of the sky the spheres [x, y, z, radius] hide from each cell of the floor around us. */
  shade(spheres) {
    const strength = (s) => s[3] / Math.max(s[1], s[3]), data = this.contact.image.data, cell = SPAN / CELLS;
    const best = spheres.sort((a, b) => strength(b) - strength(a)).slice(0, BLOBS), open = this.open ??= new Float32Array(CELLS * CELLS);
    const { position } = this.camera, { x: mx, z: mz } = this.followed ?? this.controls.target, x0 = mx - SPAN / 2, z0 = mz - SPAN / 2;
    this.near = Math.min(...spheres.map(([x, y, z, r]) => Math.hypot(x - position.x, y - position.y, z - position.z) - 2 * r));
    open.fill(1);
    for (const [x, y, z, r] of best) {
      const h = Math.max(y, 0.6 * r), far = 5 * h + 4 * r; // beyond it less than 1 % is hidden
      const from = (a) => Math.max(0, Math.floor((a - far) / cell)), to = (a) => Math.min(CELLS - 1, Math.ceil((a + far) / cell));
      for (let i = from(z - z0); i <= to(z - z0); i++) for (let j = from(x - x0); j <= to(x - x0); j++) {
        const dx = x0 + (j + 0.5) * cell - x, dz = z0 + (i + 0.5) * cell - z, q = dx * dx + dz * dz + y * y + 1e-6;
        open[i * CELLS + j] *= 1 - Math.min(0.96, (r * r * h) / (q * Math.sqrt(q)));
      }
    }
    for (let i = 0; i < CELLS; i++) for (let j = 0; j < CELLS; j++) {
      const k = i * CELLS + j, rim = Math.min(i, j, CELLS - 1 - i, CELLS - 1 - j) / 14; // nothing at the border
      data[k] = 255 * (1 - open[k]) * Math.min(1, rim);
    }
    this.contact.needsUpdate = true;
    this.floor.material.uniforms.corner.value.set(x0, z0);
  }

  /** Draw if anything changed. Returns whether it drew. */
  draw(dt, force) {
    if (this.ride) {
      const at = this.ride();
      if (this.flight) Object.assign(this.flight.to, at);
      else if (force) { this.camera.position.copy(at.position); this.controls.target.copy(at.target); }
    }
    if (this.flight) {
      const f = this.flight, t = (f.t = Math.min(1, f.t + dt / 0.45)), s = t * t * (3 - 2 * t);
      this.camera.position.lerpVectors(f.from.position, f.to.position, s);
      this.controls.target.lerpVectors(f.from.target, f.to.target, s);
      this.camera.fov = f.from.fov + s * (f.to.fov - f.from.fov);
      this.camera.updateProjectionMatrix();
      if (t === 1) this.flight = null;
      this.stale = true;
    }
    const moved = this.controls.update(dt);
    this.moving = moved || Boolean(this.flight);
    if (!moved && !force && !this.stale) return false;
    this.stale = false;
    const middle = this.followed ?? this.controls.target;
    for (const l of [this.key, this.fill, this.rim, this.spark]) {
      l.target.position.set(middle.x, 0.9, middle.z);
      l.position.copy(l.userData.from).add(l.target.position);
    }
    this.floor.position.set(middle.x, 0, middle.z);
    this.cast.position.set(middle.x, 0.0005, middle.z);
    const reach = Math.max(3.5, 1.1 * this.camera.position.distanceTo(this.controls.target));
    this.floor.scale.setScalar(reach);
    this.floor.material.uniforms.reach.value = reach;
    this.floor.material.uniforms.middle.value.copy(middle);
    this.render();
    return true;
  }

  render() {
    const { renderer, scene, camera, cells } = this, { clientWidth: w, clientHeight: h } = this.canvas;
    if (!cells) { renderer.render(scene, camera); return; }
    renderer.setScissorTest(false);
    renderer.clear();
    renderer.setScissorTest(true);
    for (const cell of cells) {
      cell.wear();
      renderer.setViewport(cell.x, h - cell.y - cell.h, cell.w, cell.h);
      renderer.setScissor(cell.x, h - cell.y - cell.h, cell.w, cell.h);
      renderer.render(scene, camera);
    }
    renderer.setScissorTest(false);
    renderer.setViewport(0, 0, w, h);
  }

  /** A PNG of the present view at full quality. */
  async picture() {
    const level = this.level;
    this.quality(STEPS.length - 1);
    this.renderer.setPixelRatio(Math.max(2, devicePixelRatio));
    this.draw(0, true);
    const blob = await new Promise((done) => this.canvas.toBlob(done, "image/png"));
    this.quality(level);
    return blob;
  }
}

/** Does this browser draw without a graphics processor? Then the page starts with fewer effects. */
function drawnBySoftware() {
  const gl = document.createElement("canvas").getContext("webgl2"), info = gl?.getExtension("WEBGL_debug_renderer_info");
  const device = info ? String(gl.getParameter(info.UNMASKED_RENDERER_WEBGL)) : "";
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software|basic render/i.test(device);
}

/** A small light studio as an equirectangular picture: a warm floor, a soft dome, two big boxes. Linear values. */
function softboxes() {
  const w = 128, h = 64, data = new Float32Array(4 * w * h);
  const box = (u, v, cu, cv, ru, rv) => {
    const du = Math.abs(((u - cu + 1.5) % 1) - 0.5) / ru, dv = Math.abs(v - cv) / rv;
    return 1 / (1 + Math.exp(18 * (Math.max(du, dv) - 1)));
  };
  for (let y = 0; y < h; y++) for (let x = 0; x < w; x++) {
    const u = (x + 0.5) / w, v = (y + 0.5) / h, up = v, k = 4 * (y * w + x);
    const dome = 0.22 + 0.62 * Math.pow(up, 1.3), floor = 0.2 * Math.pow(1 - up, 2);
    const key = 4.2 * box(u, v, 0.66, 0.72, 0.07, 0.12), side = 1.5 * box(u, v, 0.92, 0.6, 0.05, 0.22), back = 2.2 * box(u, v, 0.27, 0.7, 0.08, 0.14);
    data[k] = dome * 0.98 + floor * 1.15 + key * 1.02 + side * 0.85 + back;
    data[k + 1] = dome * 0.99 + floor + key * 0.97 + side * 0.95 + back;
    data[k + 2] = dome * 1.03 + floor * 0.85 + key * 0.88 + side * 1.1 + back;
    data[k + 3] = 1;
  }
  return { data, width: w, height: h };
}

/** Spherical harmonics of degree 2 of an equirectangular picture (row 0 at the bottom). */
function harmonics({ data, width, height }) {
  const sh = new THREE.SphericalHarmonics3(), basis = new Array(9), direction = new THREE.Vector3(), color = new THREE.Vector3();
  for (let y = 0; y < height; y++) for (let x = 0; x < width; x++) {
    const longitude = ((x + 0.5) / width - 0.5) * 2 * Math.PI, latitude = ((y + 0.5) / height - 0.5) * Math.PI, k = 4 * (y * width + x);
    direction.set(Math.cos(latitude) * Math.cos(longitude), Math.sin(latitude), Math.cos(latitude) * Math.sin(longitude));
    THREE.SphericalHarmonics3.getBasisAt(direction, basis);
    const solid = Math.cos(latitude) * (2 * Math.PI / width) * (Math.PI / height);
    for (let i = 0; i < 9; i++) sh.coefficients[i].addScaledVector(color.fromArray(data, k), basis[i] * solid);
  }
  return sh;
}
