// The blend of dual quaternions and one Karcher step in one go, where the joints of a vertex have turned little against
// each other.
//
// A, c, s and B of rigid.cpp are sums of the q_k, so A exp(.) is one blend of the q_k with other weights, dual numbers
// that follow from the products of the q_k alone. A common factor, dual or not, does not matter to the motion, so they
// can be written w_k (1 + t_k) with t_k small. With Y_k = 1 - (sum w_j q_j) . q_k, e = sum w Y and u = sum w Y^2,
//     t_k = Y_k (a + b e + c u + Y_k (d + g e) + Y_k^2 h)
// to the 7th power of the angles. Its coefficients are those of least maximal error (1e-7 of the rotation, 5e-7 of the
// translation per metre) for random chains and fans of four joints with Y below kNear, found by weighted least squares.
#pragma once
#include "dual.h"

namespace vt::VT_NS {
namespace {

const float kNear = 0.15f;

// For vertices with the same K joints: 1 - q_j . q_k, and its dual part.
template <int K>
struct Near {
    int32_t joint[K];
    bool known = false;
    float worst = 0;
    float apart[K][K], slide[K][K];

    void learn(const float* table, const int32_t* index) {
        if (knows(index)) return;
        known = true;
        worst = 0;
        for (int k = 0; k < K; ++k) joint[k] = index[k];
        for (int j = 0; j < K; ++j)
            for (int k = j + 1; k < K; ++k) {
                const float *p = table + joint[j], *q = table + joint[k];
                float a = 1, b = 0;
                for (int c = 0; c < 4; ++c) {
                    a -= p[c] * q[c];
                    b -= p[c] * q[4 + c] + p[4 + c] * q[c];
                }
                apart[j][k] = apart[k][j] = a;
                slide[j][k] = slide[k][j] = b;
                if (!(a <= worst)) worst = a;
            }
    }

    bool knows(const int32_t* index) const {
        bool same = known;
        for (int k = 0; k < K; ++k) same = same && joint[k] == index[k];
        return same;
    }

    // The blends of G groups of eight vertices that stand one after the other, not normalised; false where the joints are
    // too far apart. Two groups at once take little longer than one: each is one long chain of arithmetic.
    template <int G>
    VT_INLINE bool blend(const float* table, const float* weight, Dual* out) const {
        f8 w[K][G], y[K][G], z[K][G], e[G], u[G], e_dual[G], u_dual[G];
        VT_UNROLL for (int k = 0; k < K; ++k)
            VT_UNROLL for (int g = 0; g < G; ++g) w[k][g] = load8(weight + (g * K + k) * 8);
        VT_UNROLL for (int k = 0; k < K; ++k) {
            const int first = k == 0;
            VT_UNROLL for (int g = 0; g < G; ++g) {
                y[k][g] = w[first][g] * apart[first][k];
                z[k][g] = w[first][g] * slide[first][k];
            }
            VT_UNROLL for (int j = first + 1; j < K; ++j) {
                if (j == k) continue;
                VT_UNROLL for (int g = 0; g < G; ++g) {
                    y[k][g] += w[j][g] * apart[j][k];
                    z[k][g] += w[j][g] * slide[j][k];
                }
            }
            VT_UNROLL for (int g = 0; g < G; ++g) {
                const f8 wy = w[k][g] * y[k][g];
                e[g] = k ? e[g] + wy : wy;
                e_dual[g] = k ? e_dual[g] + w[k][g] * z[k][g] : w[k][g] * z[k][g];
                u[g] = k ? u[g] + wy * y[k][g] : wy * y[k][g];
                u_dual[g] = k ? u_dual[g] + wy * z[k][g] : wy * z[k][g];
            }
        }
        if (!(worst < kNear)) {
            for (int g = 0; g < G; ++g) {
                f8 room = kNear - y[0][g];
                VT_UNROLL for (int k = 1; k < K; ++k)
                    room = where_negative(kNear - y[k][g] - room, kNear - y[k][g], room);
                if (any_below(room, 0.0f)) return false;
            }
        }
        f8 one[G], two[G], one_dual[G], two_dual[G];
        VT_UNROLL for (int g = 0; g < G; ++g) {
            one[g] = 0.333341f - 0.020767f * e[g] - 0.084749f * u[g];
            two[g] = 0.132107f + 0.029262f * e[g];
            one_dual[g] = -0.020767f * e_dual[g] - (2 * 0.084749f) * u_dual[g];
            two_dual[g] = 0.029262f * e_dual[g];
        }
        VT_UNROLL for (int k = 0; k < K; ++k) {
            f8 real[G], dual[G];
            VT_UNROLL for (int g = 0; g < G; ++g) {
                const f8 v = y[k][g], wy = w[k][g] * v;
                real[g] = w[k][g] + wy * (one[g] + v * (two[g] + v * 0.068089f));
                const f8 slope = one[g] + v * (2.0f * two[g] + v * (3 * 0.068089f));
                dual[g] = w[k][g] * z[k][g] * slope + wy * (one_dual[g] + v * two_dual[g]);
            }
            const float* row = table + joint[k];
            VT_UNROLL for (int c = 0; c < 4; ++c)
                VT_UNROLL for (int g = 0; g < G; ++g) {
                    f8 *o = out[g].v, turned = real[g] * row[c], moved = real[g] * row[4 + c] + dual[g] * row[c];
                    o[c] = k ? o[c] + turned : turned;
                    o[4 + c] = k ? o[4 + c] + moved : moved;
                }
        }
        return true;
    }
};

}  // namespace
}  // namespace vt::VT_NS
