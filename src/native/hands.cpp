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

struct Link {
    V3 start, along, y_near, y_far, z_near, z_far, bend;
};

inline V3 normal(const Link& k, double blend) { return unit((1 - blend) * k.y_near + blend * k.y_far); }

}  // namespace

// One frame: matrix (J,4,4); scratch holds 21 doubles a link; out (V,3) floats.
void hand(const double* matrix, const HandJob& p, double* scratch, float* out) {
    Link* links = reinterpret_cast<Link*>(scratch);
    for (int64_t l = 0; l < p.links; ++l) {
        const double* own = matrix + int64_t(p.near[l]) * 16;
        const double* before = p.before[l] < 0 ? own : matrix + int64_t(p.before[l]) * 16;
        const double* after = p.far[l] < 0 ? own : matrix + int64_t(p.far[l]) * 16;
        const V3 axis_near = load(p.axis_near + 3 * l), axis_far = load(p.axis_far + 3 * l);
        const V3 n_near = load(p.normal_near + 3 * l), n_far = load(p.normal_far + 3 * l);
        Link& k = links[l];
        k.start = put(own, load(p.start + 3 * l));
        k.along = put(after, load(p.end + 3 * l)) - k.start;
        k.y_near = unit(turn(before, n_near) + turn(own, n_near));
        k.y_far = unit(turn(own, n_far) + turn(after, n_far));
        k.z_near = square(-1.0 * (turn(before, axis_near) + turn(own, axis_near)), k.y_near);
        k.z_far = square(-1.0 * (turn(own, axis_far) + turn(after, axis_far)), k.y_far);
        const double a = flexion(before, own, axis_near), b = flexion(own, after, axis_far), mean = (a + b) / 2;
        k.bend = {knuckle(a), knuckle(b), 1 - cos(mean > 0 ? mean : 0)};
    }
    for (int64_t i = 0; i < p.vertices; ++i) {
        float* o = out + 3 * int64_t(p.vertex[i]);
        const double rest = 1 - p.whole[i];
        for (int c = 0; c < 3; ++c) o[c] = float(rest * o[c]);
    }
    for (int64_t i = 0; i < p.terms; ++i) {
        const Link& k = links[p.link[i]];
        const double t = p.blend[i];
        const V3 y = normal(k, t), z = square((1 - t) * k.z_near + t * k.z_far, y), x = cross(y, z);
        const V3 local = load(p.local + 3 * i);
        const double grown = 1 + dot(load(p.swell + 3 * i), k.bend);
        const V3 v = p.share[i] * (k.start + p.along[i] * k.along + local.x * x + (local.y * grown) * y + local.z * z);
        float* o = out + 3 * int64_t(p.term_vertex[i]);
        o[0] += float(v.x), o[1] += float(v.y), o[2] += float(v.z);
    }
    for (int64_t i = 0; i < p.gaps; ++i) {
        const Link &a = links[p.pair[2 * i]], &b = links[p.pair[2 * i + 1]];
        const V3 from = a.start + p.alongs[2 * i] * a.along, to = b.start + p.alongs[2 * i + 1] * b.along;
        const V3 bridge = to - from, x = unit(bridge);
        const double s = p.across[i], length = sqrt(dot(bridge, bridge));
        const double ratio = p.width[i] < 1e-6 ? 1.0 : length / p.width[i];
        double thick = 1;
        if (ratio < 1) {
            thick = 1 + p.fold[i] * (1 / (ratio > 1e-6 ? ratio : 1e-6) - 1);
            if (thick > 2) thick = 2;
        }
        const V3 mixed = (1 - s) * normal(a, p.blends[2 * i]) + s * normal(b, p.blends[2 * i + 1]);
        const V3 y = square(mixed, x), z = cross(x, y), local = load(p.gap_local + 3 * i);
        const V3 v = p.gap_share[i] * (from + s * bridge + local.x * x + (local.y * thick) * y + local.z * z);
        float* o = out + 3 * int64_t(p.gap_vertex[i]);
        o[0] += float(v.x), o[1] += float(v.y), o[2] += float(v.z);
    }
}

}  // namespace vt::VT_NS
