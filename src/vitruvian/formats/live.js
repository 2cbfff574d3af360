// Moves contours by shares of their joints' rotations, and what lies between them by its weights, as vitruvian does;
// see its documentation of the live file. Rotations arrive as events, the points of all surfaces go out first, then
// the rotations go on to the joints. Everything is worked out once for each moment, however many events it brings, and
// only for surfaces that they concern.

var F = typeof Float32Array === 'undefined' ? Array : Float32Array;
var STILL = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0], SMALL = 1e-12, NOWHERE = [0, 0, 0], MOST = 32;
var J, turns, fresh, dirty, place, links, on, survey, level, parts, quick, world, M, Q, shownM, shownQ, ridden, local, moved;

function plain(field) { var a = [], i, n = field.length; for (i = 0; i < n; ++i) a.push(field[i]); return a; }

// Numbers of an MFVec3f-like field that is stored flat, three by three.
function three(a, i) { return [a[3 * i], a[3 * i + 1], a[3 * i + 2]]; }

// Some browsers take all numbers of a field at once, which is far quicker than point by point.
function takesArrays() {
  var t;
  try {
    t = new MFVec3f();
    t.setValue(new Float32Array([1, 2, 3, 4, 5, 6]));
    return t.length === 2 && t[1].z === 6;
  } catch (e) { return false; }
}

function initialize() {
  var i, n = 0;
  place = {
    parent: plain(parent), center: plain(center), link: plain(link), axis: plain(axis), bone: plain(bone),
    base: plain(base), row: plain(row), step: plain(step), swing: plain(swing), twist: plain(twist),
    middle: plain(middle), along: plain(along), frame: plain(frame), diversion: plain(diversion), mitre: plain(mitre),
    mitreLink: plain(mitreLink), mitreShare: plain(mitreShare), bulge: plain(bulge), bulgeLink: plain(bulgeLink),
    recentre: plain(recentre), limb: plain(limb), way: plain(way), aside: plain(aside),
    seam: plain(seam),
    first: plain(first), each: plain(each), switched: plain(switched), needRow: plain(needRow), need: plain(need),
    pair: plain(pair), area: plain(area), free: plain(free), points: plain(points), normals: plain(normals),
    softRow: plain(softRow), softJoint: plain(softJoint), softWeight: plain(softWeight), softEnd: plain(softEnd),
    tied: plain(tied), stays: plain(stays), closed: plain(closed), seenSurface: plain(seenSurface), round: plain(round),
    facesRow: plain(facesRow), faces: plain(faces), looks: plain(looks)
  };
  J = place.parent.length;
  turns = []; fresh = []; links = []; parts = []; local = [];
  dirty = []; on = true; survey = false; level = 0;
  for (i = 0; i < J; ++i) { turns.push([0, 0, 1, 0]); fresh.push(null); }
  for (i = 0; i < place.link.length / 2; ++i) links.push({ before: [0, 0, 0, 1], known: false });
  quick = takesArrays();
  for (i = 0; i < place.each.length + place.softEnd.length; ++i) {
    var p = { first: n, count: size(i), soft: i - place.each.length };
    n += p.count;
    p.points = new F(3 * p.count); p.normals = new F(3 * p.count);
    p.sent = quick ? new MFVec3f() : null; p.sentNormals = quick ? new MFVec3f() : null;
    p.used = everything(p.count);
    parts.push(p);
  }
}

function size(i) {
  var k = i - place.each.length;
  if (k >= 0) return place.softEnd[k] - (k > 0 ? place.softEnd[k - 1] : 0);
  return place.each[i] * (place.first[i + 1] - place.first[i]);
}

function everything(count) { var a = [], i; for (i = 0; i < count; ++i) a.push(1); return a; }

function turn(j, value) { turns[j] = [value[0], value[1], value[2], value[3]]; fresh[j] = value; dirty.push(j); }
function set_extremities(value) { on = value; dirty.push(-1); }
function set_survey(value) { survey = value; dirty.push(-1); }

// Another level of detail: other faces, and only the points that they use are worked out.
function set_lod(value) {
  var levels = (place.facesRow.length - 1) / place.each.length, s, i, a;
  level = Math.max(0, Math.min(value, levels - 1));
  for (s = 0; s < place.each.length; ++s) {
    a = facesOf(s, place.faces);
    parts[s].used = everything(0);
    for (i = 0; i < parts[s].count; ++i) parts[s].used.push(0);
    for (i = 0; i < a.length; ++i) parts[s].used[a[i]] = 1;
    parts[s].relevel = true;
  }
  dirty.push(-1);
}

// One level of detail more, for set_lod: every value[0]-th contour and every value[1]-th point, and all that seams and the
// ends of ramps need. Seams keep all points, so that both their sides keep the same.
function add_lod(value) {
  var p = place, steps = [Math.max(1, value[0] || 1), Math.max(1, value[1] || 1)], s, r, rows, i;
  if (p.facesRow.length > MOST * p.each.length) return;
  for (s = 0; s < p.each.length; ++s) {
    rows = [];
    for (r = p.first[s]; r < p.first[s + 1]; ++r)
      if ((r - p.first[s]) % steps[0] === 0 || p.stays[r] > 0) rows.push(r - p.first[s]);
    for (i = 1; i < rows.length; ++i) band(s, rows[i - 1], rows[i], steps[1]);
    p.facesRow.push(p.faces.length);
  }
  for (i = p.looks.length; i > 0 && i < p.faces.length; ++i) p.looks.push(p.faces[i]);
  lod_count = (p.facesRow.length - 1) / p.each.length;
}

// Points of a contour that remain when every n-th does; a closed one ends with its first point again.
function remaining(s, row, n) {
  var each = place.each[s], step = place.stays[place.first[s] + row] === 2 || each <= 2 * n ? 1 : n, out = [], k;
  for (k = 0; k < each; k += step) out.push(k);
  if (place.closed[s]) out.push(each);
  else if (out[out.length - 1] !== each - 1) out.push(each - 1);
  return out;
}

// Triangles between two contours that keep different points, the outside out.
function band(s, near, far, n) {
  var a = remaining(s, near, n), b = remaining(s, far, n), each = place.each[s], out = place.faces, i = 0, k = 0;
  while (i < a.length - 1 || k < b.length - 1) {
    out.push(near * each + a[i] % each, far * each + b[k] % each);
    if (k === b.length - 1 || (i < a.length - 1 && a[i + 1] <= b[k + 1])) out.push(near * each + a[++i] % each);
    else out.push(far * each + b[++k] % each);
  }
}

function facesOf(s, all) {
  var i = level * place.each.length + s;
  return all.slice(place.facesRow[i], place.facesRow[i + 1]);
}

function index(s, all) {
  var a = facesOf(s, all), out = new MFInt32(), i, n = 0;
  for (i = 0; i < a.length; ++i) { out[n++] = a[i]; if (i % 3 === 2) out[n++] = -1; }
  return out;
}

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

// Rows of a 3x4 matrix that turns by q and moves by t.
function matrix(q, t) {
  var x = q[0], y = q[1], z = q[2], w = q[3];
  return [
    1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), t[0],
    2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), t[1],
    2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), t[2]
  ];
}

function about(q, c) {
  var m = matrix(q, [0, 0, 0]), r;
  for (r = 0; r < 12; r += 4) m[r + 3] = c[r / 4] - (m[r] * c[0] + m[r + 1] * c[1] + m[r + 2] * c[2]);
  return m;
}

function times(a, b) {
  var m = [], r, k;
  for (r = 0; r < 12; r += 4) for (k = 0; k < 4; ++k)
    m.push(a[r] * b[k] + a[r + 1] * b[4 + k] + a[r + 2] * b[8 + k] + (k === 3 ? a[r + 3] : 0));
  return m;
}

function apply(m, p) {
  return [m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3], m[4] * p[0] + m[5] * p[1] + m[6] * p[2] + m[7],
    m[8] * p[0] + m[9] * p[1] + m[10] * p[2] + m[11]];
}

function cross(a, b) { return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]; }
function dot(a, b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// Axis times angle.
function logarithm(q) {
  var n = Math.sqrt(dot(q, q)), s = n < SMALL ? 2 : 2 * Math.atan2(n, q[3]) / n;
  return [q[0] * s, q[1] * s, q[2] * s];
}

function part(v, share) { return quaternion(v[0], v[1], v[2], share * Math.sqrt(dot(v, v))); }

// m seen from the surface's joint, whose matrix is f: f^-1 m.
function seen(f, m) {
  var out = [], r, k, t = [m[3] - f[3], m[7] - f[7], m[11] - f[11]];
  for (r = 0; r < 3; ++r) {
    for (k = 0; k < 3; ++k) out.push(f[r] * m[k] + f[4 + r] * m[4 + k] + f[8 + r] * m[8 + k]);
    out.push(f[r] * t[0] + f[4 + r] * t[1] + f[8 + r] * t[2]);
  }
  return out;
}

// How the joints of each link are turned against each other: a joint's own rotation, or that of a chain of them.
function turned() {
  var p = place, l, k, q, d, n, along, size, back, j;
  for (l = 0; l < links.length; ++l) {
    k = links[l];
    q = [0, 0, 0, 1];
    for (j = p.link[2 * l + 1]; j >= 0 && j !== p.link[2 * l]; j = p.parent[j]) q = product(world[j], q);
    d = dot(q, k.before) + q[3] * k.before[3];
    if (k.known && Math.abs(d) >= 0.9238795325112867 ? d < 0 : q[3] < 0) q = [-q[0], -q[1], -q[2], -q[3]];
    k.before = q; k.known = true;
    k.whole = logarithm(q);
    n = three(p.axis, l);
    along = dot(q, n);
    size = Math.sqrt(along * along + q[3] * q[3]);
    d = size < SMALL ? 0 : 1 / size;
    back = d ? [-along * n[0] * d, -along * n[1] * d, -along * n[2] * d, q[3] * d] : [0, 0, 0, 1];
    k.swing = logarithm(product(q, back));
    k.twist = size < SMALL ? 0 : 2 * Math.atan2(along, q[3]);
    k.bend = Math.sqrt(dot(k.swing, k.swing));
  }
}

// The share that step s takes of its link's rotation.
function share(s) {
  var p = place, l = p.step[s], k = links[l], n = three(p.axis, l), half, sine;
  if (p.twist[s] < 0) return part(k.whole, p.swing[s]);
  half = p.twist[s] * k.twist / 2; sine = Math.sin(half);
  return product(part(k.swing, p.swing[s]), [n[0] * sine, n[1] * sine, n[2] * sine, Math.cos(half)]);
}

// Joints as skin between contours sees them: without the twist that contours sewn to it spread below, and with the
// twist that contours have taken up above.
function retwisted() {
  var p = place, e, i, s, m, q, t, first = p.first[p.each.length];
  shownM = M.slice(0); shownQ = Q.slice(0);
  for (e = 0; e < p.seenSurface.length; ++e) {
    if (!on && p.switched[p.seenSurface[e]]) continue;
    i = first + e;
    m = p.base[i] < 0 ? STILL : M[p.base[i]];
    q = p.base[i] < 0 ? [0, 0, 0, 1] : Q[p.base[i]];
    for (s = p.row[i]; s < p.row[i + 1]; ++s) {
      t = share(s);
      m = times(m, about(t, three(p.center, p.link[2 * p.step[s] + 1])));
      q = product(q, t);
    }
    shownM[p.frame[i]] = m; shownQ[p.frame[i]] = q;
  }
}

function contour(i) {
  var p = place, m = p.base[i] < 0 ? STILL : M[p.base[i]], s, k, c = three(p.middle, i);
  for (s = p.row[i]; s < p.row[i + 1]; ++s) m = times(m, about(share(s), three(p.center, p.link[2 * p.step[s] + 1])));
  var shift = [0, 0, 0], here, there, r, stretch = 0, u = [0, 0, 0], widen = 1, size;
  if (p.diversion[i] !== 0) {
    here = apply(m, c); there = apply(M[p.frame[i]], c);
    for (r = 0; r < 3; ++r) shift[r] = p.diversion[i] * (there[r] - here[r]);
  }
  if (p.recentre.length && p.recentre[i] !== 0) {
    here = apply(m, c); there = recentred(i, m, [here[0] + shift[0], here[1] + shift[1], here[2] + shift[2]]);
    for (r = 0; r < 3; ++r) shift[r] += there[r];
  }
  if (p.mitre[i] !== 0) {
    k = links[p.mitreLink[i]];
    u = cross(k.swing, three(p.bone, p.mitreLink[i]));
    size = Math.sqrt(dot(u, u));
    if (size > SMALL) {
      stretch = p.mitre[i] * (Math.min(1 / Math.cos(Math.min(p.mitreShare[i] * k.bend, 1.5)), 1.5) - 1);
      u = [u[0] / size, u[1] / size, u[2] / size];
    }
  }
  if (p.bulge[i] !== 0) widen = 1 + p.bulge[i] * (1 - Math.cos(links[p.bulgeLink[i]].bend)) / 2;
  if (widen !== 1 || stretch !== 0) m = widened(m, c, three(p.along, i), widen, u, stretch);
  m = m.slice(0);
  for (r = 0; r < 3; ++r) m[4 * r + 3] += shift[r];
  return m;
}

// How far the centre of contour i, now `here`, goes so that the contour, which m turns, turns about its place on the bone
// and stands off from it as far as at rest.
function recentred(i, m, here) {
  var p = place, c = three(p.middle, i), d = three(p.way, i), e = three(p.aside, i), n = three(p.bone, p.mitreLink[i]);
  var f = p.limb[i] < 0 ? STILL : M[p.limb[i]], b = seen(f, m), gone = [], out = [], r, size, along, scale, slide, lag;
  var offset = spun(b, e), normal = spun(b, n), change = [];
  along = dot(offset, d); lag = spun(b, d);
  for (r = 0; r < 3; ++r) {
    gone.push(f[r] * (here[0] - f[3]) + f[4 + r] * (here[1] - f[7]) + f[8 + r] * (here[2] - f[11]) - c[r]);
    offset[r] -= along * d[r]; lag[r] = p.seam[i] * (lag[r] - d[r]);
  }
  size = dot(offset, offset);
  scale = size > 1e-24 ? Math.sqrt(dot(e, e) / size) : 1;
  for (r = 0; r < 3; ++r) offset[r] *= scale;
  slide = (dot(offset, normal) - dot(e, n) - dot(lag, normal)) / Math.max(dot(d, normal), 0.2);
  for (r = 0; r < 3; ++r) change.push(p.recentre[i] * (offset[r] - e[r] - slide * d[r] - gone[r]));
  for (r = 0; r < 3; ++r) out.push(f[4 * r] * change[0] + f[4 * r + 1] * change[1] + f[4 * r + 2] * change[2]);
  return out;
}

// The vector v as m turns it.
function spun(m, v) {
  return [m[0] * v[0] + m[1] * v[1] + m[2] * v[2], m[4] * v[0] + m[5] * v[1] + m[6] * v[2],
    m[8] * v[0] + m[9] * v[1] + m[10] * v[2]];
}

// m after widening across d and stretching along u, about the point c.
function widened(m, c, d, widen, u, stretch) {
  var here = apply(m, c), w = m.slice(0), r, j, a, b;
  for (r = 0; r < 3; ++r) {
    a = m[4 * r] * u[0] + m[4 * r + 1] * u[1] + m[4 * r + 2] * u[2];
    b = m[4 * r] * d[0] + m[4 * r + 1] * d[1] + m[4 * r + 2] * d[2];
    for (j = 0; j < 3; ++j) w[4 * r + j] = widen * (m[4 * r + j] + stretch * a * u[j]) + (1 - widen) * b * d[j];
    w[4 * r + 3] = here[r] - (w[4 * r] * c[0] + w[4 * r + 1] * c[1] + w[4 * r + 2] * c[2]);
  }
  return w;
}

// Volume survey: contours of a surface widened or narrowed so that what lies between two of them keeps its volume.
function surveyed(all, first) {
  var p = place, total = [], count = [], i, k, a, b, pair, way, now, was, ratio, out = [], factor, sum, x, y;
  for (i = 0; i < all.length; ++i) { total.push(0); count.push(0); }
  function slab(one, two, from, to) {
    way = [to[0] - from[0], to[1] - from[1], to[2] - from[2]];
    return (dot(one, way) + dot(two, way)) / 2;
  }
  for (pair = 0; pair < p.pair.length; pair += 2) {
    a = p.pair[pair] - first; b = p.pair[pair + 1] - first;
    if (a < 0 || b < 0 || a >= all.length || b >= all.length) continue;
    x = three(p.area, a + first); y = three(p.area, b + first);
    was = slab(x, y, three(p.middle, a + first), three(p.middle, b + first));
    now = slab(spun(all[a], x), spun(all[b], y),
      apply(all[a], three(p.middle, a + first)), apply(all[b], three(p.middle, b + first)));
    ratio = Math.max(0.49, Math.min(1.96, was / (Math.abs(now) > SMALL ? now : SMALL)));
    total[a] += ratio; total[b] += ratio; ++count[a]; ++count[b];
  }
  for (i = 0; i < all.length; ++i) {
    factor = count[i] > 0 ? Math.sqrt(total[i] / count[i]) : 1;
    factor = 1 + p.free[i + first] * (Math.max(0.7, Math.min(1.4, factor)) - 1);
    out.push(widened(all[i], three(p.middle, i + first), three(p.along, i + first), factor, [0, 0, 0], 0));
  }
  return out;
}

// Puts point n of the body, moved by x, at place k of its part; normals turn along.
function put(o, k, x, n, c) {
  var r = place.points, s = place.normals, a = r[3 * n], b = r[3 * n + 1], d = r[3 * n + 2], i;
  for (i = 0; i < 3; ++i)
    o.points[3 * k + i] = x[4 * i] * a + x[4 * i + 1] * b + x[4 * i + 2] * d + x[4 * i + 3] - c[i];
  a = s[3 * n]; b = s[3 * n + 1]; d = s[3 * n + 2];
  for (i = 0; i < 3; ++i) o.normals[3 * k + i] = x[4 * i] * a + x[4 * i + 1] * b + x[4 * i + 2] * d;
}

function surface(s) {
  var p = place, o = parts[s], first = p.first[s], f = p.frame[first], c = three(p.center, f), all = [], i, k, x;
  var whole = !on && p.switched[s], at = 0;
  if (!whole) {
    for (i = first; i < p.first[s + 1]; ++i) all.push(contour(i));
    if (survey) all = surveyed(all, first);
  }
  for (i = first; i < p.first[s + 1]; ++i) {
    x = local[i] = whole ? STILL : seen(M[f], all[i - first]);
    for (k = 0; k < p.each[s]; ++k, ++at) if (o.used[at]) put(o, at, x, o.first + at, c);
  }
}

// Points between contours, as the first joint's Segment has them. What lies on the end of a surface goes with its
// contour; the rest by its weights.
function soft(s) {
  var p = place, o = parts[s], start = o.soft > 0 ? p.softEnd[o.soft - 1] : 0, ends = [], v, k, x, t;
  for (k = 0; k < o.count; ++k) {
    v = start + k; t = p.tied[v];
    if (t >= 0) x = ends[t] = ends[t] || seen(M[0], times(M[p.frame[t]], local[t]));
    else if (p.softRow[v + 1] - p.softRow[v] === 1 || (!on && p.switched[p.each.length + v]))
      x = ridden[p.softJoint[p.softRow[v]] + 1].m;
    else x = blended(p.softRow[v], p.softRow[v + 1]);
    put(o, k, x, o.first + k, NOWHERE);
  }
}

// What soft points ride on, seen from the first joint: nothing that moves, then all joints; rigid motions as matrices,
// and as quaternions (x y z w) with their dual parts, doubled.
function riding() {
  var back = [-Q[0][0], -Q[0][1], -Q[0][2], Q[0][3]], j, m, q;
  ridden = [];
  for (j = -1; j < J; ++j) {
    m = seen(M[0], j < 0 ? STILL : shownM[j]);
    q = product(back, j < 0 ? [0, 0, 0, 1] : shownQ[j]);
    ridden.push({ m: m, q: q, d: product([m[3], m[7], m[11], 0], q) });
  }
}

// Between the mean of rigid motions (blended, and taken one step: `log` of vitruvian) and that of their matrices. Written
// out, as this is done for each point.
function blended(from, to) {
  var joint = place.softJoint, share = place.softWeight, mean = [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
  var one = ridden[joint[from] + 1], q = one.q, x0 = q[0], y0 = q[1], z0 = q[2], w0 = q[3];
  var x = 0, y = 0, z = 0, w = 0, dx = 0, dy = 0, dz = 0, dw = 0, e, i, n, m, d, A, ax, ay, az, aw, tx, ty, tz, f, r, k;
  var turnX = 0, turnY = 0, turnZ = 0, wayX = 0, wayY = 0, wayZ = 0, ux, uy, uz, vx, vy, vz, cx, cy, cz, s;
  for (e = from; e < to; ++e) {
    one = ridden[joint[e] + 1]; m = one.m; q = one.q; d = one.d; s = share[e];
    for (i = 0; i < 12; ++i) mean[i] += s * m[i];
    if (q[0] * x0 + q[1] * y0 + q[2] * z0 + q[3] * w0 < 0) s = -s;
    x += s * q[0]; y += s * q[1]; z += s * q[2]; w += s * q[3];
    dx += s * d[0]; dy += s * d[1]; dz += s * d[2]; dw += s * d[3];
  }
  n = x * x + y * y + z * z + w * w;
  if (n < 1e-16) return ridden[joint[from] + 1].m;
  tx = (dx * w - dw * x + dz * y - dy * z) / n;
  ty = (dy * w - dw * y + dx * z - dz * x) / n;
  tz = (dz * w - dw * z + dy * x - dx * y) / n;
  n = 1 / Math.sqrt(n); x *= n; y *= n; z *= n; w *= n;
  A = matrix([x, y, z, w], [tx, ty, tz]);
  for (e = from; e < to; ++e) {
    one = ridden[joint[e] + 1]; m = one.m; q = one.q; s = share[e];
    f = q[0] * x0 + q[1] * y0 + q[2] * z0 + q[3] * w0 < 0 ? -1 : 1;
    ax = f * (w * q[0] - x * q[3] - y * q[2] + z * q[1]); ay = f * (w * q[1] + x * q[2] - y * q[3] - z * q[0]);
    az = f * (w * q[2] - x * q[1] + y * q[0] - z * q[3]); aw = f * (w * q[3] + x * q[0] + y * q[1] + z * q[2]);
    r = Math.sqrt(ax * ax + ay * ay + az * az);
    k = r < SMALL ? 2 : 2 * Math.atan2(r, aw) / r;
    ux = ax * k; uy = ay * k; uz = az * k;
    cx = m[3] - tx; cy = m[7] - ty; cz = m[11] - tz;
    vx = A[0] * cx + A[4] * cy + A[8] * cz; vy = A[1] * cx + A[5] * cy + A[9] * cz;
    vz = A[2] * cx + A[6] * cy + A[10] * cz;
    // The velocity that takes a body there while it turns.
    k = ux * ux + uy * uy + uz * uz;
    f = k < 1e-8 ? 1 / 12 : (1 - aw * Math.sqrt(k) / (2 * r)) / k;
    cx = uy * vz - uz * vy; cy = uz * vx - ux * vz; cz = ux * vy - uy * vx;
    turnX += s * ux; turnY += s * uy; turnZ += s * uz;
    wayX += s * (vx - cx / 2 + f * (uy * cz - uz * cy));
    wayY += s * (vy - cy / 2 + f * (uz * cx - ux * cz));
    wayZ += s * (vz - cz / 2 + f * (ux * cy - uy * cx));
  }
  q = [turnX, turnY, turnZ];
  m = times(A, matrix(part(q, 1), wayOf(q, [wayX, wayY, wayZ])));
  for (i = 0; i < 12; ++i) mean[i] += place.round[0] * (m[i] - mean[i]);
  return mean;
}

// The way that a body goes that turns by w while its velocity is v.
function wayOf(w, v) {
  var s = dot(w, w), a = Math.sqrt(s), f = s < 1e-8 ? 0.5 : (1 - Math.cos(a)) / s;
  var g = s < 1e-8 ? 1 / 6 : (a - Math.sin(a)) / (s * a), x = cross(w, v), y = cross(w, x);
  return [v[0] + f * x[0] + g * y[0], v[1] + f * x[1] + g * y[1], v[2] + f * x[2] + g * y[2]];
}

function concerned(s, which) {
  var i;
  for (i = place.needRow[s]; i < place.needRow[s + 1]; ++i) if (which[place.need[i]]) return true;
  return false;
}

function sent(o, normals) {
  var a = normals ? o.normals : o.points, out = normals ? o.sentNormals : o.sent, i;
  if (quick) { out.setValue(a); return out; }
  out = new MFVec3f();
  for (i = 0; i < o.count; ++i) out[i] = new SFVec3f(a[3 * i], a[3 * i + 1], a[3 * i + 2]);
  return out;
}

// Joints and surfaces below the Humanoid, by their names.
function found() {
  var out = {}, queue = plain(Human.skeleton), node, i;
  while (queue.length) {
    node = queue.shift();
    if (node.name && !out[node.name]) out[node.name] = node;
    if (node.children) for (i = 0; i < node.children.length; ++i) queue.push(node.children[i]);
  }
  return out;
}

// Once per moment, however many events came.
function eventsProcessed() {
  if (!dirty.length) return;
  var which = {}, j, s, t, m, all = false;
  for (j = 0; j < dirty.length; ++j) if (dirty[j] < 0) all = true; else which[dirty[j]] = true;
  dirty = [];
  M = []; Q = []; world = [];
  for (j = 0; j < J; ++j) {
    t = turns[j];
    world.push(quaternion(t[0], t[1], t[2], t[3]));
    m = about(world[j], three(place.center, j));
    M.push(place.parent[j] < 0 ? m : times(M[place.parent[j]], m));
    Q.push(place.parent[j] < 0 ? world[j] : product(Q[place.parent[j]], world[j]));
  }
  turned();
  retwisted();
  riding();
  moved = [];
  for (s = 0; s < parts.length; ++s) {
    moved.push(all || concerned(s, which));
    if (moved[s]) { if (parts[s].soft < 0) surface(s); else soft(s); }
  }
  publish();
  release();
}
