// Hands: points placed along their links, in frames that bend with the joints. See vitruvian.deform.hands, which is the
// same in NumPy.
#include "kernels.h"

#include <math.h>

namespace vt::VT_NS {

namespace {

struct V3 {
    double x, y, z;
};

inline V3 operator+(const V3& a, const V3& b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline V3 operator-(const V3& a, const V3& b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline V3 operator*(double s, const V3& a) { return {s * a.x, s * a.y, s * a.z}; }
inline double dot(const V3& a, const V3& b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline V3 cross(const V3& a, const V3& b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }
inline V3 load(const double* p) { return {p[0], p[1], p[2]}; }
inline V3 unit(const V3& a) {
    const double n = sqrt(dot(a, a));
    return (1 / (n > 1e-12 ? n : 1e-12)) * a;
}
inline V3 square(const V3& z, const V3& y) { return unit(z - dot(z, y) * y); }
inline V3 turn(const double* m, const V3& v) {
    return {m[0] * v.x + m[1] * v.y + m[2] * v.z, m[4] * v.x + m[5] * v.y + m[6] * v.z,
            m[8] * v.x + m[9] * v.y + m[10] * v.z};
}
inline V3 put(const double* m, const V3& v) { return turn(m, v) + V3{m[3], m[7], m[11]}; }

// Signed angle about `axis` of the rotation from a to b (row-major 4x4).
double flexion(const double* a, const double* b, const V3& axis) {
    double r[3][3];
    for (int i = 0; i < 3; ++i)
        for (int j = 0; j < 3; ++j) r[i][j] = a[i] * b[j] + a[4 + i] * b[4 + j] + a[8 + i] * b[8 + j];
    const double trace = r[0][0] + r[1][1] + r[2][2];
    double q[4];
    if (trace > 0) {
        q[0] = r[2][1] - r[1][2], q[1] = r[0][2] - r[2][0], q[2] = r[1][0] - r[0][1], q[3] = 1 + trace;
    } else {
        int i = 0;
        if (r[1][1] > r[0][0]) i = 1;
        if (r[2][2] > r[i][i]) i = 2;
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        q[i] = 1 + r[i][i] - r[j][j] - r[k][k];
        q[j] = r[j][i] + r[i][j];
        q[k] = r[k][i] + r[i][k];
        q[3] = r[k][j] - r[j][k];
        if (q[3] < 0)
            for (double& c : q) c = -c;
    }
    const double n = 1 / sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    return 2 * atan2(n * (q[0] * axis.x + q[1] * axis.y + q[2] * axis.z), n * q[3]);
}

double knuckle(double angle) {
    const double most = 2.0943951023931953;
    return 1 / cos((angle < 0 ? 0 : angle > most ? most : angle) / 2) - 1;
}

// Of one link in a pose: its first end and the way to the other; normals and side axes at the near end, of the link, at
// the far end; knuckles and muscle; how far the two ends are rounded and how tight the palm side is there.
struct Link {
    V3 start, along, y[3], z[3], bend;
    double arc[2], tight[2];
};

inline double rounded(double angle) {
    const double full = 1.0471975511965976, c = angle < 0 ? 0 : angle > full ? 1 : angle / full;
    return c * (2 - c);
}

constexpr int LANES = 8;

inline void put(const V3& v, float* out) { out[0] = float(v.x), out[1] = float(v.y), out[2] = float(v.z); }

inline void add(const float moved[3][LANES], const int32_t* vertex, float* out) {
    for (int i = 0; i < LANES; ++i) {
        float* o = out + 3 * int64_t(vertex[i]);
        o[0] += moved[0][i], o[1] += moved[1][i], o[2] += moved[2][i];
    }
}

// Eight terms of one link, in single precision about the link's first end.
void block(const Link& k, const float* t, const int32_t* vertex, float* out) {
    float y[3][3], z[3][3], way[3], start[3], bend[3], arc[2], tight[2], moved[3][LANES];
    for (int e = 0; e < 3; ++e) put(k.y[e], y[e]), put(k.z[e], z[e]);
    put(k.along, way), put(k.start, start), put(k.bend, bend);
    arc[0] = float(k.arc[0]), arc[1] = float(k.arc[1]);
    tight[0] = float(k.tight[0]), tight[1] = float(k.tight[1]);
    for (int i = 0; i < LANES; ++i) {
        const float share = t[i], a = t[8 + i] + t[16 + i] * arc[0] + t[24 + i] * arc[1];
        const float c0 = t[32 + i], c2 = t[40 + i], c1 = 1 - c0 - c2;
        float yx = c0 * y[0][0] + c1 * y[1][0] + c2 * y[2][0], yy = c0 * y[0][1] + c1 * y[1][1] + c2 * y[2][1],
              yz = c0 * y[0][2] + c1 * y[1][2] + c2 * y[2][2];
        float zx = c0 * z[0][0] + c1 * z[1][0] + c2 * z[2][0], zy = c0 * z[0][1] + c1 * z[1][1] + c2 * z[2][1],
              zz = c0 * z[0][2] + c1 * z[1][2] + c2 * z[2][2];
        const float size = yx * yx + yy * yy + yz * yz + 1e-24f, d = (zx * yx + zy * yy + zz * yz) / size;
        zx -= d * yx, zy -= d * yy, zz -= d * yz;
        const float ny = 1 / sqrtf(size), nz = 1 / sqrtf(zx * zx + zy * zy + zz * zz + 1e-24f);
        yx *= ny, yy *= ny, yz *= ny;
        zx *= nz, zy *= nz, zz *= nz;
        const float lx = t[48 + i], lz = t[64 + i];
        float ly = t[56 + i] * (1 + t[72 + i] * bend[0] + t[80 + i] * bend[1] + t[88 + i] * bend[2]);
        float r = t[8 + i];
        r = r < 0 ? 0 : r > 1 ? 1 : r;
        const float depth = t[96 + i] * ly * ((1 - r) * tight[0] + r * tight[1]), squared = depth * depth;
        ly /= sqrtf(sqrtf(1 + squared * squared));
        moved[0][i] = share * (start[0] + a * way[0] + lx * (yy * zz - yz * zy) + ly * yx + lz * zx);
        moved[1][i] = share * (start[1] + a * way[1] + lx * (yz * zx - yx * zz) + ly * yy + lz * zy);
        moved[2][i] = share * (start[2] + a * way[2] + lx * (yx * zy - yy * zx) + ly * yz + lz * zz);
    }
    add(moved, vertex, out);
}

// Eight terms of the gap between two links, in single precision about the first link's first end.
void bridge(const Link& one, const Link& two, const float* t, const int32_t* vertex, float* out) {
    float y[2][3][3], way[2][3], start[3], between[3], moved[3][LANES];
    const Link* link[2] = {&one, &two};
    for (int k = 0; k < 2; ++k) {
        for (int e = 0; e < 3; ++e) put(link[k]->y[e], y[k][e]);
        put(link[k]->along, way[k]);
    }
    put(one.start, start);
    put(two.start - one.start, between);
    for (int i = 0; i < LANES; ++i) {
        const float share = t[i], s = t[8 + i], a = t[16 + i], b = t[24 + i];
        float n[2][3];
        for (int k = 0; k < 2; ++k) {
            const float c0 = t[32 + 16 * k + i], c2 = t[40 + 16 * k + i], c1 = 1 - c0 - c2;
            for (int c = 0; c < 3; ++c) n[k][c] = c0 * y[k][0][c] + c1 * y[k][1][c] + c2 * y[k][2][c];
            const float size = 1 / sqrtf(n[k][0] * n[k][0] + n[k][1] * n[k][1] + n[k][2] * n[k][2] + 1e-24f);
            for (int c = 0; c < 3; ++c) n[k][c] *= size;
        }
        float from[3], w[3], x[3], m[3];
        for (int c = 0; c < 3; ++c) from[c] = a * way[0][c], w[c] = between[c] + b * way[1][c] - from[c];
        const float length = sqrtf(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]), short_ = length > 1e-12f ? length : 1e-12f;
        for (int c = 0; c < 3; ++c) x[c] = w[c] / short_, m[c] = (1 - s) * n[0][c] + s * n[1][c];
        const float d = m[0] * x[0] + m[1] * x[1] + m[2] * x[2];
        for (int c = 0; c < 3; ++c) m[c] -= d * x[c];
        const float size = 1 / sqrtf(m[0] * m[0] + m[1] * m[1] + m[2] * m[2] + 1e-24f);
        for (int c = 0; c < 3; ++c) m[c] *= size;
        const float width = t[96 + i], ratio = width < 1e-6f ? 1 : length / width, least = ratio > 1e-6f ? ratio : 1e-6f;
        const float more = 1 + t[88 + i] * (1 / least - 1), thick = ratio < 1 ? (more > 2 ? 2 : more) : 1;
        const float lx = t[64 + i], ly = t[72 + i] * thick, lz = t[80 + i];
        const float z[3] = {x[1] * m[2] - x[2] * m[1], x[2] * m[0] - x[0] * m[2], x[0] * m[1] - x[1] * m[0]};
        for (int c = 0; c < 3; ++c)
            moved[c][i] = share * (start[c] + from[c] + s * w[c] + lx * x[c] + ly * m[c] + lz * z[c]);
    }
    add(moved, vertex, out);
}

}  // namespace

// One frame: matrix (J,4,4); scratch holds 33 doubles a link; out (V,3) floats.
void hand(const double* matrix, const HandJob& p, double* scratch, float* out) {
    Link* links = reinterpret_cast<Link*>(scratch);
    double* bends = scratch + 31 * p.links;
    for (int64_t l = p.links; l-- > 0;) {  // a link comes after the one it hangs on, whose far end mostly bends as its near end
        const double *own = matrix + int64_t(p.near[l]) * 16, *a = p.axis_near + 3 * l, *f = p.axis_far + 3 * l;
        int64_t next = l + 1;
        while (next < p.links && p.previous[next] != l) ++next;
        const double* n = p.axis_near + 3 * next;
        const bool same = next < p.links && p.before[next] == p.near[l] && f[0] == n[0] && f[1] == n[1] && f[2] == n[2];
        bends[2 * l] = p.before[l] < 0 ? 0 : flexion(matrix + int64_t(p.before[l]) * 16, own, load(a));
        bends[2 * l + 1] = same ? bends[2 * next] : p.far[l] < 0 ? 0 : flexion(own, matrix + int64_t(p.far[l]) * 16, load(f));
    }
    for (int64_t l = 0; l < p.links; ++l) {
        const double* own = matrix + int64_t(p.near[l]) * 16;
        const double* before = p.before[l] < 0 ? own : matrix + int64_t(p.before[l]) * 16;
        const double* after = p.far[l] < 0 ? own : matrix + int64_t(p.far[l]) * 16;
        const V3 axis_near = load(p.axis_near + 3 * l), axis_far = load(p.axis_far + 3 * l);
        const V3 n_near = load(p.normal_near + 3 * l), n_far = load(p.normal_far + 3 * l);
        Link& k = links[l];
        k.start = put(own, load(p.start + 3 * l));
        k.along = put(after, load(p.end + 3 * l)) - k.start;
        k.y[0] = unit(turn(before, n_near) + turn(own, n_near));
        k.y[1] = turn(own, unit(n_near + n_far));
        k.y[2] = unit(turn(own, n_far) + turn(after, n_far));
        k.z[0] = square(-1.0 * (turn(before, axis_near) + turn(own, axis_near)), k.y[0]);
        k.z[1] = square(-1.0 * turn(own, unit(axis_near + axis_far)), k.y[1]);
        k.z[2] = square(-1.0 * (turn(own, axis_far) + turn(after, axis_far)), k.y[2]);
        const double a = bends[2 * l], b = bends[2 * l + 1], mean = (a + b) / 2;
        k.bend = {knuckle(a), knuckle(b), 1 - cos(mean > 0 ? mean : 0)};
        k.arc[0] = rounded(a), k.arc[1] = rounded(b);
        const double most = 2.0943951023931953, steepest = a > b ? a : b;
        const double clipped = steepest < 0 ? 0 : steepest > most ? most : steepest;
        k.tight[0] = k.tight[1] = (mean > 0 ? mean : 0) / (0.9 * sqrt(dot(k.along, k.along)) * cos(clipped / 2));
    }
    for (int64_t l = 0; l < p.links; ++l)  // both links of a joint agree there
        if (p.previous[l] >= 0) {
            double &one = links[p.previous[l]].tight[1], &two = links[l].tight[0];
            one = two = one > two ? one : two;
        }
    for (int64_t i = 0; i < p.vertices; ++i) {
        float* o = out + 3 * int64_t(p.vertex[i]);
        const float rest = float(1 - p.whole[i]);
        if (rest > 1e-7f)
            o[0] *= rest, o[1] *= rest, o[2] *= rest;
        else
            o[0] = o[1] = o[2] = 0;  // whatever is there
    }
    for (int64_t i = 0; i < p.blocks; ++i)
        block(links[p.block_link[i]], p.term + i * 13 * LANES, p.block_vertex + i * LANES, out);
    for (int64_t i = 0; i < p.gaps; ++i)
        bridge(links[p.pair[2 * i]], links[p.pair[2 * i + 1]], p.gap + i * 13 * LANES, p.gap_vertex + i * LANES, out);
}

}  // namespace vt::VT_NS
