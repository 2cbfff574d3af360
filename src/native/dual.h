// Eight dual quaternions in lanes: reading them from a table, and the functions of dual numbers that exp and log need.
#pragma once
#include "lanes.h"

namespace vt::VT_NS {
namespace {

struct Dual {
    f8 v[8];  // x y z w, then the dual part
};

VT_INLINE f8 dot(const f8* a, const f8* b) { return (a[0] * b[0] + a[1] * b[1]) + (a[2] * b[2] + a[3] * b[3]); }

// Joints of a group of eight vertices: K of them with U (all eight have the same), K times eight without.

// The rows of eight vertices by columns; with U all eight have the row of the first.
template <bool U>
inline Dual gather(const float* table, const int32_t* index) {
    Dual d;
    if (U) {
        for (int c = 0; c < 8; ++c) d.v[c] = all(table[index[0] + c]);
    } else {
        const float* row[8];
        for (int l = 0; l < 8; ++l) row[l] = table + index[l];
        transpose(row, d.v);
    }
    return d;
}

// Sum of weight times row over the influences of each of eight vertices, by columns.
template <int K, bool U>
inline Dual sum_rows(const float* table, const int32_t* joint, const float* weight, int n) {
    Dual d;
    if (U) {
        for (int k = 0; k < (K ? K : n); ++k) {
            const f8 w = load8(weight + k * 8);
            const float* row = table + joint[k];
            for (int c = 0; c < 8; ++c) d.v[c] = k ? d.v[c] + w * row[c] : w * row[c];
        }
        return d;
    }
    alignas(32) float rows[8][8];
    const float* row[8];
    for (int l = 0; l < 8; ++l) {
        f8 total = load8(table + joint[l]) * weight[l];
        for (int k = 1; k < (K ? K : n); ++k) total += load8(table + joint[k * 8 + l]) * weight[k * 8 + l];
        store8(rows[l], total);
        row[l] = rows[l];
    }
    transpose(row, d.v);
    return d;
}

// f(c) = acos(c) / sqrt(1 - c^2) and its derivative, for c > -1. Least maximal error polynomials on 0.6..1 (2e-8 and
// 8e-8); below, the half angle twice: with h = sqrt((1 + c) / 2), f(c) = f(h) / h.
// Above 0.9 (within 50 degrees of the mean, nearly always) fewer terms do.
VT_INLINE f8 near_f(f8 d) {
    return 0.999999978f +
           d * (0.333337117f + d * (0.133226849f + d * (0.0582286177f + d * (0.0205011702f + d * 0.0211345885f))));
}
VT_INLINE f8 near_slope(f8 d) {
    return -0.333333281f -
           d * (0.266679058f + d * (0.171062419f + d * (0.1053815f + d * (0.0405607865f + d * 0.0652510561f))));
}
VT_INLINE f8 close_f(f8 d) { return 0.999999978f + d * (0.333340382f + d * (0.132985746f + d * (0.0625745787f))); }
VT_INLINE f8 close_slope(f8 d) { return -0.333333300f + d * (-0.26668142f + d * (-0.17065555f + d * -0.11392895f)); }
VT_INLINE void angle_over_sine(f8 c, f8& f, f8& slope) {
    const f8 d = 1.0f - c;
    if (!any_below(c, 0.9f)) {
        f = close_f(d);
        slope = close_slope(d);
        return;
    }
    f = near_f(d);
    slope = near_slope(d);
    if (!any_below(c, 0.6f)) return;
    const f8 kept = where_negative(c + 0.999f, all(-0.999f), c);
    const f8 h = root(0.5f + 0.5f * kept), g = root(0.5f + 0.5f * h);
    const f8 far = near_f(1.0f - g) / (h * g);
    const f8 far_slope = (kept * far - 1.0f) / (1.0f - kept * kept);
    f = where_negative(c - 0.6f, far, f);
    slope = where_negative(c - 0.6f, far_slope, slope);
}

// cos sqrt(n), sin sqrt(n) / sqrt(n) and the derivative of the latter, n in 0..10 (Taylor; 1e-9 at the n = 2.5 of a
// half turn's half angle).
VT_INLINE void cosine_sine(f8 n, f8& c, f8& s, f8& slope) {
    if (!any_below(0.02f - n, 0.0f)) {
        c = 1.0f + n * (-1.0f / 2 + n * (1.0f / 24));
        s = 1.0f + n * (-1.0f / 6 + n * (1.0f / 120));
        slope = -1.0f / 6 + n * (1.0f / 60);
        return;
    }
    c = 1.0f + n * (-1.0f / 2 + n * (1.0f / 24 + n * (-1.0f / 720 + n * (1.0f / 40320 + n * (-1.0f / 3628800 +
        n * (1.0f / 479001600))))));
    s = 1.0f + n * (-1.0f / 6 + n * (1.0f / 120 + n * (-1.0f / 5040 + n * (1.0f / 362880 + n * (-1.0f / 39916800)))));
    slope = -1.0f / 6 + n * (1.0f / 60 + n * (-1.0f / 1680 + n * (1.0f / 90720 + n * (-1.0f / 7983360))));
}

}  // namespace
}  // namespace vt::VT_NS
