// What holds cloth together, eight constraints at a time. Membrane: engineering strains along weft and warp and the shear
// between them, three at once for each triangle. Bending: the quadratic hinge of Bergou et al. 2006 for flat cloth, or, made
// of the same, the curvature of each triangle.
#pragma once

#include <stdint.h>
#include <string.h>

#include "kernels.h"
#include "lanes.h"

namespace vt::VT_NS {

namespace {

const float kTiny = 1e-12f;
const float kSudden = 0.25f;  // strain that a step takes away at most: triangles that have folded up open without a burst

// Rows of four floats of eight vertices, as columns.
VT_INLINE void gather(const float* x, const int32_t* index, f8 out[4]) {
#if defined(VT_VECTORS)
    f8 r[4];
    for (int i = 0; i < 4; ++i) r[i] = join(load4(x + 4 * int64_t(index[i])), load4(x + 4 * int64_t(index[i + 4])));
    const f8 t0 = VT_SHUFFLE8(r[0], r[1], 0, 8, 1, 9, 4, 12, 5, 13);
    const f8 t1 = VT_SHUFFLE8(r[0], r[1], 2, 10, 3, 11, 6, 14, 7, 15);
    const f8 t2 = VT_SHUFFLE8(r[2], r[3], 0, 8, 1, 9, 4, 12, 5, 13);
    const f8 t3 = VT_SHUFFLE8(r[2], r[3], 2, 10, 3, 11, 6, 14, 7, 15);
    out[0] = VT_SHUFFLE8(t0, t2, 0, 1, 8, 9, 4, 5, 12, 13);
    out[1] = VT_SHUFFLE8(t0, t2, 2, 3, 10, 11, 6, 7, 14, 15);
    out[2] = VT_SHUFFLE8(t1, t3, 0, 1, 8, 9, 4, 5, 12, 13);
    out[3] = VT_SHUFFLE8(t1, t3, 2, 3, 10, 11, 6, 7, 14, 15);
#else
    for (int l = 0; l < 8; ++l)
        for (int k = 0; k < 4; ++k) out[k][l] = x[4 * int64_t(index[l]) + k];
#endif
}

VT_INLINE void scatter(float* x, const int32_t* index, const f8 in[4]) {
#if defined(VT_VECTORS)
    const f8 a = VT_SHUFFLE8(in[0], in[1], 0, 8, 1, 9, 4, 12, 5, 13), b = VT_SHUFFLE8(in[0], in[1], 2, 10, 3, 11, 6, 14, 7, 15);
    const f8 c = VT_SHUFFLE8(in[2], in[3], 0, 8, 1, 9, 4, 12, 5, 13), d = VT_SHUFFLE8(in[2], in[3], 2, 10, 3, 11, 6, 14, 7, 15);
    const f8 r[4] = {VT_SHUFFLE8(a, c, 0, 1, 8, 9, 4, 5, 12, 13), VT_SHUFFLE8(a, c, 2, 3, 10, 11, 6, 7, 14, 15),
                     VT_SHUFFLE8(b, d, 0, 1, 8, 9, 4, 5, 12, 13), VT_SHUFFLE8(b, d, 2, 3, 10, 11, 6, 7, 14, 15)};
    for (int i = 0; i < 4; ++i) {
        float both[8];
        store8(both, r[i]);
        memcpy(x + 4 * int64_t(index[i]), both, 16);
        memcpy(x + 4 * int64_t(index[i + 4]), both + 4, 16);
    }
#else
    for (int l = 0; l < 8; ++l)
        for (int k = 0; k < 4; ++k) x[4 * int64_t(index[l]) + k] = in[k][l];
#endif
}

VT_INLINE f8 within(f8 x, float most) { return larger(all(-most), all(0.0f) - larger(all(-most), all(0.0f) - x)); }

VT_INLINE f8 dot(const f8 a[3], const f8 b[3]) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

// Eight triangles: C = (|f_u| - 1, |f_v| - 1, f_u . f_v) with f the columns of the deformation gradient.
VT_INLINE void membrane(float* x, const int32_t* index, const float* rest, float* force, float over, float carry) {
    f8 q[3][4], e1[3], e2[3], fu[3], fv[3];
    for (int k = 0; k < 3; ++k) gather(x, index + 8 * k, q[k]);
    const f8 a = load8(rest), b = load8(rest + 8), c = load8(rest + 16), d = load8(rest + 24);
    for (int k = 0; k < 3; ++k) {
        e1[k] = q[1][k] - q[0][k], e2[k] = q[2][k] - q[0][k];
        fu[k] = a * e1[k] + c * e2[k], fv[k] = b * e1[k] + d * e2[k];
    }
    const f8 uu = dot(fu, fu), vv = dot(fv, fv), uv = dot(fu, fv), one = all(1.0f);
    const f8 lu = root(uu + kTiny * one), lv = root(vv + kTiny * one), iu = one / lu, iv = one / lv;
    const f8 gu[3] = {all(0.0f) - a - c, a, c}, gv[3] = {all(0.0f) - b - d, b, d};
    f8 suu = all(0.0f), svv = suu, suv = suu;
    for (int k = 0; k < 3; ++k) {
        const f8 w = q[k][3];
        suu += w * gu[k] * gu[k], svv += w * gv[k] * gv[k], suv += w * gu[k] * gv[k];
    }
    const f8 cosine = uv * iu * iv;  // of the angle between both
    const f8 a11 = suu + load8(rest + 32) * over, a12 = suv * cosine + load8(rest + 40) * over;
    const f8 a22 = svv + load8(rest + 48) * over, a13 = suu * uv * iu + suv * lu, a23 = suv * lv + svv * uv * iv;
    const f8 a33 = suu * vv + 2.0f * suv * uv + svv * uu + load8(rest + 56) * over;
    const f8 k1 = carry * load8(force), k2 = carry * load8(force + 8), k3 = carry * load8(force + 16);
    const f8 s11 = load8(rest + 32) * over, s12 = load8(rest + 40) * over, s22 = load8(rest + 48) * over;
    const f8 s33 = load8(rest + 56) * over;
    const f8 r1 = within(one - lu - s11 * k1 - s12 * k2, kSudden), r2 = within(one - lv - s12 * k1 - s22 * k2, kSudden);
    const f8 r3 = within(all(0.0f) - uv - s33 * k3, kSudden);
    // symmetric, positive definite: by cofactors
    const f8 m11 = a22 * a33 - a23 * a23, m12 = a13 * a23 - a12 * a33, m13 = a12 * a23 - a13 * a22;
    const f8 m22 = a11 * a33 - a13 * a13, m23 = a12 * a13 - a11 * a23, m33 = a11 * a22 - a12 * a12;
    const f8 whole = a11 * m11 + a12 * m12 + a13 * m13;
    const f8 least = 1e-1f * a11 * a22 * a33 + 1e-30f * one;
    const f8 inverse = one / larger(whole, least);
    const f8 l1 = (m11 * r1 + m12 * r2 + m13 * r3) * inverse, l2 = (m12 * r1 + m22 * r2 + m23 * r3) * inverse;
    const f8 l3 = (m13 * r1 + m23 * r2 + m33 * r3) * inverse;
    store8(force, k1 + l1), store8(force + 8, k2 + l2), store8(force + 16, k3 + l3);
    const f8 pu = iu * l1, qv = iv * l2;
    for (int k = 0; k < 3; ++k) {
        const f8 w = q[k][3];
        for (int i = 0; i < 3; ++i)
            q[k][i] += w * (gu[k] * (pu * fu[i] + l3 * fv[i]) + gv[k] * (qv * fv[i] + l3 * fu[i]));
        scatter(x, index + 8 * k, q[k]);
    }
}

// Eight hinges: the weighted sum of their four vertices, as long as the angle between the triangles is wide.
VT_INLINE void hinge(float* x, const int32_t* index, const float* rest, float over) {
    f8 q[4][4], c[3], k[4];
    for (int i = 0; i < 4; ++i) gather(x, index + 8 * i, q[i]), k[i] = load8(rest + 8 * i);
    f8 sum = load8(rest + 32) * over;
    for (int i = 0; i < 4; ++i) sum += q[i][3] * k[i] * k[i];
    const f8 minus = all(-1.0f) / larger(sum, all(1e-30f));
    for (int j = 0; j < 3; ++j) c[j] = (k[0] * q[0][j] + k[1] * q[1][j] + k[2] * q[2][j] + k[3] * q[3][j]) * minus;
    for (int i = 0; i < 4; ++i) {
        const f8 share = q[i][3] * k[i];
        for (int j = 0; j < 3; ++j) q[i][j] += share * c[j];
        scatter(x, index + 8 * i, q[i]);
    }
}

// Eight triangles: three sums of their corners and what is opposite, which are nothing where they are flat.
VT_INLINE void shape(float* x, const int32_t* index, const float* rest, float over) {
    f8 q[6][4];
    for (int i = 0; i < 6; ++i) gather(x, index + 8 * i, q[i]);
    const f8 give = load8(rest + 144) * over;
    f8 a11 = give, a22 = give, a33 = give, a12 = all(0.0f), a13 = a12, a23 = a12, s[3][3];
    for (int r = 0; r < 3; ++r)
        for (int j = 0; j < 3; ++j) s[r][j] = all(0.0f);
    for (int i = 0; i < 6; ++i) {
        const f8 k1 = load8(rest + 8 * i), k2 = load8(rest + 48 + 8 * i), k3 = load8(rest + 96 + 8 * i), w = q[i][3];
        a11 += w * k1 * k1, a22 += w * k2 * k2, a33 += w * k3 * k3;
        a12 += w * k1 * k2, a13 += w * k1 * k3, a23 += w * k2 * k3;
        for (int j = 0; j < 3; ++j) s[0][j] += k1 * q[i][j], s[1][j] += k2 * q[i][j], s[2][j] += k3 * q[i][j];
    }
    const f8 m11 = a22 * a33 - a23 * a23, m12 = a13 * a23 - a12 * a33, m13 = a12 * a23 - a13 * a22;
    const f8 m22 = a11 * a33 - a13 * a13, m23 = a12 * a13 - a11 * a23, m33 = a11 * a22 - a12 * a12;
    const f8 inverse = all(-1.0f) / (a11 * m11 + a12 * m12 + a13 * m13);
    f8 l[3][3];
    for (int j = 0; j < 3; ++j) {
        l[0][j] = (m11 * s[0][j] + m12 * s[1][j] + m13 * s[2][j]) * inverse;
        l[1][j] = (m12 * s[0][j] + m22 * s[1][j] + m23 * s[2][j]) * inverse;
        l[2][j] = (m13 * s[0][j] + m23 * s[1][j] + m33 * s[2][j]) * inverse;
    }
    for (int i = 0; i < 6; ++i) {
        const f8 k1 = load8(rest + 8 * i), k2 = load8(rest + 48 + 8 * i), k3 = load8(rest + 96 + 8 * i), w = q[i][3];
        for (int j = 0; j < 3; ++j) q[i][j] += w * (k1 * l[0][j] + k2 * l[1][j] + k3 * l[2][j]);
        scatter(x, index + 8 * i, q[i]);
    }
}

// Eight pairs of vertices that may come nearer to each other, not farther apart.
VT_INLINE void tether(float* x, const int32_t* index, const float* rest) {
    f8 a[4], b[4], way[3];
    gather(x, index, a), gather(x, index + 8, b);
    for (int j = 0; j < 3; ++j) way[j] = b[j] - a[j];
    const f8 apart = root(dot(way, way) + kTiny * all(1.0f));
    const f8 over = larger(apart - load8(rest), all(0.0f)), both = larger(a[3] + b[3], all(1e-30f));
    const f8 share = over / (apart * both);
    for (int j = 0; j < 3; ++j) a[j] += a[3] * share * way[j], b[j] -= b[3] * share * way[j];
    scatter(x, index, a), scatter(x, index + 8, b);
}

}  // namespace

}  // namespace vt::VT_NS
