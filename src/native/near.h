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
        bool same = known;
        for (int k = 0; k < K; ++k) same = same && joint[k] == index[k];
        if (same) return;
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

    // The blend of one group of eight vertices, not normalised; false where the joints are too far apart.
    VT_INLINE bool blend(const float* table, const float* weight, Dual& out) const {
        f8 w[K], y[K], z[K];
        VT_UNROLL for (int k = 0; k < K; ++k) w[k] = load8(weight + k * 8);
        f8 e = all(0.0f), u = e, e_dual = e, u_dual = e;
        VT_UNROLL for (int k = 0; k < K; ++k) {
            const int first = k == 0;
            y[k] = w[first] * apart[first][k];
            z[k] = w[first] * slide[first][k];
            VT_UNROLL for (int j = first + 1; j < K; ++j) {
                if (j == k) continue;
                y[k] += w[j] * apart[j][k];
                z[k] += w[j] * slide[j][k];
            }
            const f8 wy = w[k] * y[k];
            e += wy;
            e_dual += w[k] * z[k];
            u += wy * y[k];
            u_dual += wy * z[k];
        }
        if (!(worst < kNear)) {
            f8 room = kNear - y[0];
            VT_UNROLL for (int k = 1; k < K; ++k) room = where_negative(kNear - y[k] - room, kNear - y[k], room);
            if (any_below(room, 0.0f)) return false;
        }
        const f8 one = 0.333341f - 0.020767f * e - 0.084749f * u, two = 0.132107f + 0.029262f * e;
        const f8 one_dual = -0.020767f * e_dual - (2 * 0.084749f) * u_dual, two_dual = 0.029262f * e_dual;
        VT_UNROLL for (int k = 0; k < K; ++k) {
            const f8 wy = w[k] * y[k];
            const f8 real = w[k] + wy * (one + y[k] * (two + y[k] * 0.068089f));
            const f8 slope = one + y[k] * (2.0f * two + y[k] * (3 * 0.068089f));
            const f8 dual = w[k] * z[k] * slope + wy * (one_dual + y[k] * two_dual);
            const float* row = table + joint[k];
            for (int c = 0; c < 4; ++c) {
                out.v[c] = k ? out.v[c] + real * row[c] : real * row[c];
                out.v[4 + c] = (k ? out.v[4 + c] + real * row[4 + c] : real * row[4 + c]) + dual * row[c];
            }
        }
        return true;
    }
};

}  // namespace
}  // namespace vt::VT_NS
