// Linear blending of eight vertices in lanes, and how groups of eight are stored.
#pragma once
#include "lanes.h"

namespace vt::VT_NS {
namespace {

// A = I + sum w (M - I), by rows of four. Joints: K with U (the eight vertices share them), K times eight without;
// S times the joint is its place in a table of four columns of three floats and a zero.
template <int K, bool U, int S = 2>
VT_INLINE void blend_matrices(const float* table, const int32_t* joint, const float* weight, f8 m[12]) {
    if (U) {
        for (int r = 0; r < 3; ++r)
            for (int k = 0; k < K; ++k) {
                const f8 w = load8(weight + k * 8);
                const float* t = table + S * int64_t(joint[k]) + r;
                for (int c = 0; c < 4; ++c) m[r * 4 + c] = k ? m[r * 4 + c] + w * t[c * 4] : w * t[c * 4];
            }
    } else {
        alignas(32) float rows[2][8][8];
        const float *low[8], *high[8];
        for (int l = 0; l < 8; ++l) {
            const float* t = table + S * int64_t(joint[l]);
            f8 a = load8(t) * weight[l], b = load8(t + 8) * weight[l];
            for (int k = 1; k < K; ++k) {
                t = table + S * int64_t(joint[k * 8 + l]);
                a += load8(t) * weight[k * 8 + l];
                b += load8(t + 8) * weight[k * 8 + l];
            }
            store8(rows[0][l], a);
            store8(rows[1][l], b);
            low[l] = rows[0][l];
            high[l] = rows[1][l];
        }
        f8 column[16];
        transpose(low, column);
        transpose(high, column + 8);
        for (int r = 0; r < 3; ++r)
            for (int c = 0; c < 4; ++c) m[r * 4 + c] = column[c * 4 + r];
    }
    m[0] = m[0] + 1.0f;
    m[5] = m[5] + 1.0f;
    m[10] = m[10] + 1.0f;
}

// p' = p + sum w (M p - p).
template <int K, bool U, int S = 2>
VT_INLINE void blend_points(const float* table, const int32_t* joint, const float* weight, const f8 p[3], f8 out[3]) {
    if (U) {
        VT_UNROLL for (int r = 0; r < 3; ++r) {
            f8 m[4];
            for (int k = 0; k < K; ++k) {
                const f8 w = load8(weight + k * 8);
                const float* t = table + S * int64_t(joint[k]) + r;
                for (int c = 0; c < 4; ++c) m[c] = k ? m[c] + w * t[c * 4] : w * t[c * 4];
            }
            out[r] = p[r] + ((m[0] * p[0] + m[1] * p[1]) + (m[2] * p[2] + m[3]));
        }
        return;
    }
    f8 m[12];
    blend_matrices<K, false, S>(table, joint, weight, m);
    for (int r = 0; r < 3; ++r)
        out[r] = (m[r * 4] * p[0] + m[r * 4 + 1] * p[1]) + (m[r * 4 + 2] * p[2] + m[r * 4 + 3]);
}

// Eight points, or as many as there are before `last`.
VT_INLINE void write_points(const int32_t* target, int64_t place, int64_t last, const f8 moved[3], float* out) {
    float xy[8][2], z[8];
    interleave(moved[0], moved[1], xy[0]);
    store8(z, moved[2]);
    if (place + 8 <= last) {
        if (target) {
            target += place;
            VT_UNROLL for (int l = 0; l < 8; ++l) {
                float* o = out + 3 * int64_t(target[l]);
                memcpy(o, xy[l], 8);
                o[2] = z[l];
            }
        } else {
            float* o = out + 3 * place;
            VT_UNROLL for (int l = 0; l < 8; ++l) {
                memcpy(o + 3 * l, xy[l], 8);
                o[3 * l + 2] = z[l];
            }
        }
        return;
    }
    for (int64_t l = 0; l < last - place; ++l) {
        float* o = out + 3 * (target ? target[place + l] : place + l);
        memcpy(o, xy[l], 8);
        o[2] = z[l];
    }
}

inline void write_frames(const int32_t* target, int64_t place, int64_t last, const f8 m[12], float* out) {
    float v[12][8];
    for (int c = 0; c < 12; ++c) store8(v[c], m[c]);
    for (int64_t l = 0; l < 8 && place + l < last; ++l) {
        float* o = out + 12 * (target ? target[place + l] : place + l);
        for (int c = 0; c < 12; ++c) o[c] = v[c][l];
    }
}

}  // namespace
}  // namespace vt::VT_NS
