// Moves contours by shares of their joints' rotations, as vitruvian does; see its documentation of contours.
// Rotations arrive as events, the points of all surfaces go out first, then the rotations go on to the joints.

var J, C, turns, fresh, dirty, rest, place, links, on;

function plain(field) { var a = [], i; for (i = 0; i < field.length; ++i) a.push(field[i]); return a; }

function initialize() {
  var i, j;
  J = parent.length; C = base.length;
  turns = []; fresh = []; dirty = false; on = true;
  for (i = 0; i < J; ++i) { turns.push([0, 0, 1, 0]); fresh.push(null); }
  rest = plain(points);
  place = {
    parent: plain(parent), center: plain(center), link: plain(link), axis: plain(axis), bone: plain(bone),
    base: plain(base), row: plain(row), step: plain(step), swing: plain(swing), twist: plain(twist),
    middle: plain(middle), along: plain(along), frame: plain(frame), diversion: plain(diversion), mitre: plain(mitre),
    mitreLink: plain(mitreLink), mitreShare: plain(mitreShare), bulge: plain(bulge), bulgeLink: plain(bulgeLink),
    first: plain(first), each: plain(each), switched: plain(switched)
  };
  links = [];
  for (i = 0; i < place.link.length / 2; ++i) { j = [0, 0, 0, 1]; links.push({ before: j, known: false }); }
}

function turn(j, value) { turns[j] = [value[0], value[1], value[2], value[3]]; fresh[j] = value; dirty = true; }

function set_extremities(value) { on = value; dirty = true; }

function quaternion(x, y, z, a) {
  var n = Math.sqrt(x * x + y * y + z * z), s = n > 0 ? Math.sin(a / 2) / n : 0;
  return [x * s, y * s, z * s, n > 0 ? Math.cos(a / 2) : 1];
}

function product(a, b) {
  return [
    a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1], a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0],
    a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3], a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2]
  ];
}

// Rows of a 3x4 matrix that turns by q about c, and moves by t.
function motion(q, c, t) {
  var x = q[0], y = q[1], z = q[2], w = q[3], m = [
    1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), 0,
    2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), 0,
    2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), 0
  ], r;
  for (r = 0; r < 12; r += 4) m[r + 3] = c[r / 4] + t[r / 4] - (m[r] * c[0] + m[r + 1] * c[1] + m[r + 2] * c[2]);
  return m;
}

function times(a, b) {
  var m = [], r, k;
  for (r = 0; r < 12; r += 4) for (k = 0; k < 4; ++k)
    m.push(a[r] * b[k] + a[r + 1] * b[4 + k] + a[r + 2] * b[8 + k] + (k === 3 ? a[r + 3] : 0));
  return m;
}

function apply(m, x, y, z) {
  return [m[0] * x + m[1] * y + m[2] * z + m[3], m[4] * x + m[5] * y + m[6] * z + m[7], m[8] * x + m[9] * y + m[10] * z + m[11]];
}

function logarithm(q) {
  var n = Math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2]), s = n < 1e-12 ? 2 : 2 * Math.atan2(n, q[3]) / n;
  return [q[0] * s, q[1] * s, q[2] * s];
}

function part(v, share) {
  var a = share * Math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
  return quaternion(v[0], v[1], v[2], a);
}

var STILL = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0];
function three(a, i) { return [a[3 * i], a[3 * i + 1], a[3 * i + 2]]; }

// How the joints of each link are turned against each other: a joint's own rotation, or that of a chain of them.
function turned(world) {
  var p = place, l, k, q, dot, n, along, size, back, j;
  for (l = 0; l < links.length; ++l) {
    k = links[l];
    q = [0, 0, 0, 1];
    for (j = p.link[2 * l + 1]; j >= 0 && j !== p.link[2 * l]; j = p.parent[j]) q = product(world[j], q);
    dot = q[0] * k.before[0] + q[1] * k.before[1] + q[2] * k.before[2] + q[3] * k.before[3];
    if (k.known && Math.abs(dot) >= 0.9238795325112867 ? dot < 0 : q[3] < 0) q = [-q[0], -q[1], -q[2], -q[3]];
    k.before = q; k.known = true;
    k.whole = logarithm(q);
    n = three(p.axis, l);
    along = q[0] * n[0] + q[1] * n[1] + q[2] * n[2];
    size = Math.sqrt(along * along + q[3] * q[3]);
    back = size < 1e-12 ? [0, 0, 0, 1] : [-along * n[0] / size, -along * n[1] / size, -along * n[2] / size, q[3] / size];
    k.swing = logarithm(product(q, back));
    k.twist = size < 1e-12 ? 0 : 2 * Math.atan2(along, q[3]);
    k.bend = Math.sqrt(k.swing[0] * k.swing[0] + k.swing[1] * k.swing[1] + k.swing[2] * k.swing[2]);
  }
}

function contour(i, M) {
  var p = place, m = p.base[i] < 0 ? STILL : M[p.base[i]], s, l, k, n, c = three(p.middle, i), q, half, sine;
  for (s = p.row[i]; s < p.row[i + 1]; ++s) {
    l = p.step[s]; k = links[l]; n = three(p.axis, l);
    if (p.twist[s] < 0) q = part(k.whole, p.swing[s]);
    else {
      half = p.twist[s] * k.twist / 2; sine = Math.sin(half);
      q = product(part(k.swing, p.swing[s]), [n[0] * sine, n[1] * sine, n[2] * sine, Math.cos(half)]);
    }
    m = times(m, motion(q, three(p.center, p.link[2 * l + 1]), [0, 0, 0]));
  }
  var shift = [0, 0, 0], here, there, r, stretch = 0, u = [0, 0, 0], widen = 1, d, v, size, full, a, b, j, w;
  if (p.diversion[i] !== 0) {
    here = apply(m, c[0], c[1], c[2]); there = apply(M[p.frame[i]], c[0], c[1], c[2]);
    for (r = 0; r < 3; ++r) shift[r] = p.diversion[i] * (there[r] - here[r]);
  }
  if (p.mitre[i] !== 0) {
    k = links[p.mitreLink[i]]; v = k.swing; d = three(p.bone, p.mitreLink[i]);
    u = [v[1] * d[2] - v[2] * d[1], v[2] * d[0] - v[0] * d[2], v[0] * d[1] - v[1] * d[0]];
    size = Math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2]);
    if (size > 1e-12) {
      full = Math.min(1 / Math.cos(Math.min(p.mitreShare[i] * k.bend, 1.5)), 1.5);
      stretch = p.mitre[i] * (full - 1);
      u = [u[0] / size, u[1] / size, u[2] / size];
    }
  }
  if (p.bulge[i] !== 0) widen = 1 + p.bulge[i] * (1 - Math.cos(links[p.bulgeLink[i]].bend)) / 2;
  if (widen !== 1 || stretch !== 0) {
    here = apply(m, c[0], c[1], c[2]); d = three(p.along, i); w = m.slice(0);
    for (r = 0; r < 3; ++r) {
      a = m[4 * r] * u[0] + m[4 * r + 1] * u[1] + m[4 * r + 2] * u[2];
      b = m[4 * r] * d[0] + m[4 * r + 1] * d[1] + m[4 * r + 2] * d[2];
      for (j = 0; j < 3; ++j) w[4 * r + j] = widen * (m[4 * r + j] + stretch * a * u[j]) + (1 - widen) * b * d[j];
      w[4 * r + 3] = here[r] - (w[4 * r] * c[0] + w[4 * r + 1] * c[1] + w[4 * r + 2] * c[2]);
    }
    m = w;
  }
  m = m.slice(0);
  for (r = 0; r < 3; ++r) m[4 * r + 3] += shift[r];
  return m;
}

// m seen from the surface's joint, whose matrix is f: f^-1 m.
function seen(f, m) {
  var out = [], r, k, t = [m[3] - f[3], m[7] - f[7], m[11] - f[11]];
  for (r = 0; r < 3; ++r) {
    for (k = 0; k < 3; ++k) out.push(f[r] * m[k] + f[4 + r] * m[4 + k] + f[8 + r] * m[8 + k]);
    out.push(f[r] * t[0] + f[4 + r] * t[1] + f[8 + r] * t[2]);
  }
  return out;
}

function surface(s, M) {
  var p = place, out = new MFVec3f(), i, k, x, n = 0, at, f, c, q;
  for (i = 0; i < s; ++i) n += p.each[i] * (p.first[i + 1] - p.first[i]);
  f = p.frame[p.first[s]]; c = three(p.center, f); at = 0;
  out.length = p.each[s] * (p.first[s + 1] - p.first[s]);
  for (i = p.first[s]; i < p.first[s + 1]; ++i) {
    x = !on && p.switched[s] ? STILL : seen(M[f], contour(i, M));
    for (k = 0; k < p.each[s]; ++k, ++n, ++at) {
      q = apply(x, rest[3 * n], rest[3 * n + 1], rest[3 * n + 2]);
      out[at] = new SFVec3f(q[0] - c[0], q[1] - c[1], q[2] - c[2]);
    }
  }
  return out;
}

// Once per moment, however many rotations came.
function eventsProcessed() {
  if (!dirty) return;
  dirty = false;
  var M = [], world = [], j, t, m;
  for (j = 0; j < J; ++j) {
    t = turns[j];
    world.push(quaternion(t[0], t[1], t[2], t[3]));
    m = motion(world[j], three(place.center, j), [0, 0, 0]);
    M.push(place.parent[j] < 0 ? m : times(M[place.parent[j]], m));
  }
  turned(world);
  publish(M);
  release();
}
