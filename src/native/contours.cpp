// Motions of contours: each takes shares of the rotations of a chain of joints. Source: cross-section deformation of
// H-Anim bodies; a share of a rotation is the same axis with a part of the angle.
#include "kernels.h"

#include <math.h>

namespace vt::VT_NS {

namespace {

struct Quaternion {
    double x, y, z, w;
};

inline Quaternion product(const Quaternion& a, const Quaternion& b) {
    return {a.w * b.x + a.x * b.w + a.y * b.z - a.z * b.y, a.w * b.y - a.x * b.z + a.y * b.w + a.z * b.x,
            a.w * b.z + a.x * b.y - a.y * b.x + a.z * b.w, a.w * b.w - a.x * b.x - a.y * b.y - a.z * b.z};
}

// Of a rotation matrix with rows m[0..2], m[4..6], m[8..10], by its largest component (Shepperd).
Quaternion quaternion(const double* m) {
    const double a = m[0], b = m[5], c = m[10], trace = a + b + c;
    Quaternion q;
    if (trace >= a && trace >= b && trace >= c) {
        q = {m[9] - m[6], m[2] - m[8], m[4] - m[1], 1 + trace};
    } else if (a >= b && a >= c) {
        q = {1 + a - b - c, m[1] + m[4], m[2] + m[8], m[9] - m[6]};
    } else if (b >= c) {
        q = {m[1] + m[4], 1 - a + b - c, m[6] + m[9], m[2] - m[8]};
    } else {
        q = {m[2] + m[8], m[6] + m[9], 1 - a - b + c, m[4] - m[1]};
    }
    const double n = 1 / sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w);
    return {q.x * n, q.y * n, q.z * n, q.w * n};
}

// Axis times angle, the angle in 0..2 pi as the sign says.
void logarithm(const Quaternion& q, double* out) {
    const double length = sqrt(q.x * q.x + q.y * q.y + q.z * q.z);
    const double s = length < 1e-12 ? 2.0 : 2 * atan2(length, q.w) / length;
    out[0] = q.x * s, out[1] = q.y * s, out[2] = q.z * s;
}

const int kLanes = 8;  // a fixed number at a time, so that equal angles have equal sines wherever they stand

// Sines and cosines of eight angles, up to 2 pi: series of a quarter of each, doubled twice.
inline void waves(const double* angle, double* sine, double* cosine) {
    for (int i = 0; i < kLanes; ++i) {
        const double t = angle[i] / 4, u = t * t;
        double s = 1 + u * (-1.0 / 6 + u * (1.0 / 120 + u * (-1.0 / 5040 + u * (1.0 / 362880 + u * (-1.0 / 39916800 +
                   u * (1.0 / 6227020800 + u * (-1.0 / 1307674368000 + u * (1.0 / 355687428096000))))))));
        double c = 1 + u * (-1.0 / 2 + u * (1.0 / 24 + u * (-1.0 / 720 + u * (1.0 / 40320 + u * (-1.0 / 3628800 +
                   u * (1.0 / 479001600 + u * (-1.0 / 87178291200 + u * (1.0 / 20922789888000))))))));
        s *= t;
        const double s2 = 2 * s * c, c2 = 1 - 2 * s * s;
        sine[i] = 2 * s2 * c2;
        cosine[i] = 1 - 2 * s2 * s2;
    }
}

inline void rotation(const Quaternion& q, double r[3][4]) {
    const double x = q.x, y = q.y, z = q.z, w = q.w;
    r[0][0] = 1 - 2 * (y * y + z * z), r[0][1] = 2 * (x * y - z * w), r[0][2] = 2 * (x * z + y * w);
    r[1][0] = 2 * (x * y + z * w), r[1][1] = 1 - 2 * (x * x + z * z), r[1][2] = 2 * (y * z - x * w);
    r[2][0] = 2 * (x * z - y * w), r[2][1] = 2 * (y * z + x * w), r[2][2] = 1 - 2 * (x * x + y * y);
}

void place(const double* m, const double* p, double* out) {
    for (int r = 0; r < 3; ++r) out[r] = m[r * 4] * p[0] + m[r * 4 + 1] * p[1] + m[r * 4 + 2] * p[2] + m[r * 4 + 3];
}

inline double dot(const double* a, const double* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

const double kStill[16] = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};

}  // namespace

// How joint `near` (or nothing, -1) and joint `far` are turned against each other, of one frame: 12 doubles a link.
// The whole turn (3) where a step needs it, its part across the axis (3), the angle about the axis, the offset of the centre (3), the angles of
// the whole and of the part across.
// `before` (links,4) holds the quaternions of the frame before, for turns past 180 degrees; `fresh`: there is none.
void contour_links(const double* matrix, const ContourProgram& p, bool follow, bool fresh, double* before, double* out) {
    for (int64_t l = 0; l < p.links; ++l) {
        const int32_t near = p.link[2 * l], far = p.link[2 * l + 1];
        const double* a = near < 0 ? kStill : matrix + int64_t(near) * 16;
        const double* b = matrix + int64_t(far) * 16;
        double relative[12], *o = out + l * 12, moved[3];
        for (int r = 0; r < 3; ++r)
            for (int c = 0; c < 3; ++c) relative[r * 4 + c] = a[r] * b[c] + a[4 + r] * b[4 + c] + a[8 + r] * b[8 + c];
        Quaternion q = quaternion(relative);
        double* was = before + 4 * l;
        const double dot = q.x * was[0] + q.y * was[1] + q.z * was[2] + q.w * was[3];
        const bool near_before = follow && !fresh && fabs(dot) >= 0.9238795325112867;  // turned by less than 45 degrees
        if (near_before ? dot < 0 : q.w < 0) q = {-q.x, -q.y, -q.z, -q.w};
        was[0] = q.x, was[1] = q.y, was[2] = q.z, was[3] = q.w;
        o[0] = o[1] = o[2] = 0;
        if (p.whole[l]) logarithm(q, o);
        const double* n = p.axis + 3 * l;
        const double along = q.x * n[0] + q.y * n[1] + q.z * n[2];
        const double size = sqrt(along * along + q.w * q.w);
        const Quaternion back = size < 1e-12 ? Quaternion{0, 0, 0, 1}
                                             : Quaternion{-along * n[0] / size, -along * n[1] / size,
                                                          -along * n[2] / size, q.w / size};
        logarithm(product(q, back), o + 3);
        o[6] = size < 1e-12 ? 0.0 : 2 * atan2(along, q.w);
        const double* c = p.center + int64_t(far) * 3;
        place(b, c, moved);
        for (int r = 0; r < 3; ++r) moved[r] -= a[r * 4 + 3];
        for (int r = 0; r < 3; ++r) o[7 + r] = a[r] * moved[0] + a[4 + r] * moved[1] + a[8 + r] * moved[2] - c[r];
        for (int i = 0; i < 2; ++i) o[10 + i] = sqrt(o[3 * i] * o[3 * i] + o[3 * i + 1] * o[3 * i + 1] + o[3 * i + 2] * o[3 * i + 2]);
    }
}

// The share of its link's turn that each step takes, of one frame: four doubles a step, padded to a multiple of eight
// steps. The factor of the turn that makes it the vector of a quaternion, the scalar, and the same of the twist's angle.
void contour_turns(const ContourProgram& p, const double* links, double* out) {
    for (int64_t first = 0; first < p.steps; first += kLanes) {
        double half[2][kLanes], sine[2][kLanes], cosine[2][kLanes], length[kLanes], *o = out + 4 * first;
        const int count = int(p.steps - first < kLanes ? p.steps - first : kLanes);
        for (int i = 0; i < kLanes; ++i) {
            const int64_t s = first + (i < count ? i : count - 1);
            const double *l = links + int64_t(p.step[s]) * 12, twist = p.twist[s];
            const bool split = twist == twist;  // not a number: the rotation is not split
            length[i] = split ? l[11] : l[10];
            half[0][i] = p.swing[s] * length[i] / 2;
            half[1][i] = split ? twist * l[6] / 2 : 0;
            length[i] = length[i] < 1e-9 ? 0 : length[i];
        }
        waves(half[0], sine[0], cosine[0]);
        waves(half[1], sine[1], cosine[1]);
        for (int i = 0; i < kLanes; ++i, o += 4) {
            const int64_t s = first + (i < count ? i : count - 1);
            o[0] = length[i] == 0 ? p.swing[s] / 2 : sine[0][i] / length[i];
            o[1] = cosine[0][i], o[2] = sine[1][i], o[3] = cosine[1][i];
        }
    }
}

// Changes `shift` of the centre of contour k, which m turns, as if it turned about its place on the bone instead of the
// joint, and slides it in the contour's plane until it stands off from the bone as far as at rest. In the rest frame of
// the bone; the contour of a seam has the same numbers on both surfaces.
void recentre(const double* matrix, const ContourProgram& p, int64_t k, const double* m, double* shift) {
    const double* f = p.limb[k] < 0 ? kStill : matrix + int64_t(p.limb[k]) * 16;
    const double *c = p.middle + 3 * k, *d = p.way + 3 * k, *e = p.aside + 3 * k;
    const double* n = p.bone + 3 * int64_t(p.mitre_link[k]);
    double here[3], gone[3], offset[3], normal[3], lag[3], change[3];
    place(m, c, here);
    for (int i = 0; i < 3; ++i) here[i] += shift[i] - f[i * 4 + 3];
    for (int i = 0; i < 3; ++i) {
        double turned[3];  // a row of the motion against the bone
        for (int j = 0; j < 3; ++j) turned[j] = f[i] * m[j] + f[4 + i] * m[4 + j] + f[8 + i] * m[8 + j];
        gone[i] = f[i] * here[0] + f[4 + i] * here[1] + f[8 + i] * here[2] - c[i];
        normal[i] = dot(turned, n);
        offset[i] = dot(turned, e) - e[i];
        lag[i] = p.seam[k] * (dot(turned, d) - d[i]);
    }
    const double along = dot(offset, d);
    for (int i = 0; i < 3; ++i) offset[i] = e[i] + (offset[i] - along * d[i]);
    const double size = dot(offset, offset), scale = size > 1e-24 ? sqrt(dot(e, e) / size) : 1;
    for (int i = 0; i < 3; ++i) offset[i] *= scale;
    const double slide = (dot(offset, normal) - dot(e, n) - dot(lag, normal)) / fmax(dot(d, normal), 0.2);
    for (int i = 0; i < 3; ++i) change[i] = p.recentre[k] * (offset[i] - e[i] - slide * d[i] - gone[i]);
    for (int i = 0; i < 3; ++i) shift[i] += dot(f + i * 4, change);
}

// What the steps of contour k make of its base: three rows of its motion.
void chain(const double* matrix, const ContourProgram& p, const double* links, const double* turns, int64_t k,
           double* own) {
    const double* start = p.base[k] < 0 ? kStill : matrix + int64_t(p.base[k]) * 16;
    for (int i = 0; i < 12; ++i) own[i] = start[i];
    for (int32_t s = p.row[k]; s < p.row[k + 1]; ++s) {
        const int32_t l = p.step[s];
        const double *o = links + int64_t(l) * 12, *n = p.axis + 3 * int64_t(l), *w = turns + 4 * int64_t(s);
        const double *c = p.center + 3 * int64_t(p.link[2 * l + 1]), share = p.swing[s];
        const double* v = p.twist[s] != p.twist[s] ? o : o + 3;
        const Quaternion q = product({v[0] * w[0], v[1] * w[0], v[2] * w[0], w[1]},
                                     {n[0] * w[2], n[1] * w[2], n[2] * w[2], w[3]});
        double r[3][4], next[12];
        rotation(q, r);
        for (int i = 0; i < 3; ++i)
            r[i][3] = c[i] + share * o[7 + i] - (r[i][0] * c[0] + r[i][1] * c[1] + r[i][2] * c[2]);
        for (int i = 0; i < 3; ++i) {
            const double x = own[i * 4], y = own[i * 4 + 1], z = own[i * 4 + 2], last[4] = {0, 0, 0, own[i * 4 + 3]};
            for (int j = 0; j < 4; ++j) next[i * 4 + j] = last[j] + x * r[0][j] + y * r[1][j] + z * r[2][j];
        }
        for (int i = 0; i < 12; ++i) own[i] = next[i];
    }
}

// Motions of the contours of one frame, (C,4,4).
void contour_motions(const double* matrix, const ContourProgram& p, const double* links, const double* turns,
                     double* out) {
    for (int64_t k = 0; k < p.contours; ++k) {
        double* m = out + k * 16;
        if (p.same[k] < 0)
            chain(matrix, p, links, turns, k, m);
        else
            for (int i = 0; i < 12; ++i) m[i] = out[int64_t(p.same[k]) * 16 + i];
    }
    for (int64_t k = 0; k < p.contours; ++k) {
        double* m = out + k * 16;
        const double* c = p.middle + 3 * k;
        double shift[3] = {0, 0, 0};
        if (p.diversion[k] != 0) {
            double here[3], there[3];
            place(m, c, here);
            place(matrix + int64_t(p.frame[k]) * 16, c, there);
            for (int i = 0; i < 3; ++i) shift[i] = p.diversion[k] * (there[i] - here[i]);
        }
        if (p.recentre[k] != 0) recentre(matrix, p, k, m, shift);
        double widen = 1, stretch = 0, across[3] = {0, 0, 0};
        if (p.mitre[k] != 0) {  // in the plane of the bend, by 1 / cos of what the contour lacks to the bone
            const int32_t l = p.mitre_link[k];
            const double *v = links + int64_t(l) * 12 + 3, *d = p.bone + 3 * int64_t(l), angle = v[8];
            const double u[3] = {v[1] * d[2] - v[2] * d[1], v[2] * d[0] - v[0] * d[2], v[0] * d[1] - v[1] * d[0]};
            const double size = sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2]);
            if (size > 1e-12) {
                const double lacks = fmin(p.mitre_share[k] * angle, 1.5), full = fmin(1 / cos(lacks), 1.5);
                stretch = p.mitre[k] * (full - 1);
                for (int i = 0; i < 3; ++i) across[i] = u[i] / size;
            }
        }
        if (p.bulge[k] != 0) {
            widen = 1 + p.bulge[k] * (1 - cos(links[int64_t(p.bulge_link[k]) * 12 + 11])) / 2;
        }
        if (widen != 1 || stretch != 0) {
            double t[3];
            for (int i = 0; i < 3; ++i) t[i] = m[i * 4] * c[0] + m[i * 4 + 1] * c[1] + m[i * 4 + 2] * c[2] + m[i * 4 + 3];
            const double* d = p.along + 3 * k;  // the contour's normal: it does not get thicker
            for (int i = 0; i < 3; ++i) {
                double* w = m + i * 4;
                const double a = w[0] * across[0] + w[1] * across[1] + w[2] * across[2];
                const double b = w[0] * d[0] + w[1] * d[1] + w[2] * d[2];
                for (int j = 0; j < 3; ++j) w[j] = widen * (w[j] + stretch * a * across[j]) + (1 - widen) * b * d[j];
            }
            for (int i = 0; i < 3; ++i) {
                const double* w = m + i * 4;
                m[i * 4 + 3] = t[i] - (w[0] * c[0] + w[1] * c[1] + w[2] * c[2]);
            }
        }
        for (int i = 0; i < 3; ++i) m[i * 4 + 3] += shift[i];
        m[12] = m[13] = m[14] = 0.0;
        m[15] = 1.0;
    }
}

}  // namespace vt::VT_NS
