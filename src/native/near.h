// The blend of dual quaternions and one Karcher step in one go, where the joints of a vertex have turned little against
// each other.
//
// A, c, s and B of rigid.cpp are sums of the q_k, so A exp(.) is one blend of the q_k with other weights, dual numbers
// that follow from the products of the q_k alone. A common factor, dual or not, does not matter to the motion, so they
// can be written w_k (1 + t_k) with t_k small. With Y_k = 1 - (sum w_j q_j) . q_k and e = sum w Y,
//     t_k = Y_k (a + b e + Y_k (c + d Y_k))
// Its coefficients are those of least maximal error (3e-7 of the rotation, 3e-6 of its derivative, which is what dual parts
// feel) for random chains and fans of two to six joints with Y below kNear, found by least squares.
#pragma once
#include "dual.h"

namespace vt::VT_NS {
namespace {

const float kNear = 0.12f;

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

    // out_k = sum w_j of_jk, which is symmetric with zeros in the diagonal: each number is read once.
    static VT_INLINE void mix(const float (&of)[K][K], const f8* w, f8* out) {
        VT_UNROLL for (int j = 0; j < K; ++j) VT_UNROLL for (int k = j + 1; k < K; ++k) {
            const f8 a = all(of[j][k]);
            out[j] = k == 1 ? w[k] * a : out[j] + w[k] * a;
            out[k] = j == 0 ? w[j] * a : out[k] + w[j] * a;
        }
    }

    // The weights of the blend: K times eight real parts and as many dual ones; false where joints are too far apart.
    VT_INLINE bool weigh(const float* weight, float* real, float* dual) const {
        f8 w[K], y[K], e;
        VT_UNROLL for (int k = 0; k < K; ++k) w[k] = load8(weight + k * 8);
        mix(apart, w, y);
        if (!(worst < kNear)) {
            f8 most = y[0];
            VT_UNROLL for (int k = 1; k < K; ++k) most = larger(most, y[k]);
            if (any_below(kNear - most, 0.0f)) return false;
        }
        f8 wy[K];
        VT_UNROLL for (int k = 0; k < K; ++k) {
            wy[k] = w[k] * y[k];
            e = k ? e + wy[k] : wy[k];
        }
        const f8 both = 0.333282f - 0.025193f * e;
        VT_UNROLL for (int k = 0; k < K; ++k) {
            const f8 more = 0.134312f + 0.060931f * y[k], t = both + y[k] * more;
            store8(real + k * 8, w[k] + wy[k] * t);
            y[k] = t + y[k] * (more + 0.060931f * y[k]);
        }
        f8 z[K], e_dual;
        mix(slide, w, z);
        VT_UNROLL for (int k = 0; k < K; ++k) {
            z[k] = w[k] * z[k];
            e_dual = k ? e_dual + z[k] : z[k];
        }
        const f8 both_dual = -0.025193f * e_dual;
        VT_UNROLL for (int k = 0; k < K; ++k) store8(dual + k * 8, z[k] * y[k] + wy[k] * both_dual);
        return true;
    }

    // The sum of weight times dual quaternion, not normalised.
    VT_INLINE void blend(const float* table, const float* real, const float* dual, f8 out[8]) const {
        VT_UNROLL for (int k = 0; k < K; ++k) {
            const float* row = table + joint[k];
            const f8 r = load8(real + k * 8), d = load8(dual + k * 8);
            VT_UNROLL for (int c = 0; c < 4; ++c) {
                const f8 turned = r * row[c], moved = r * row[4 + c] + d * row[c];
                out[c] = k ? out[c] + turned : turned;
                out[4 + c] = k ? out[4 + c] + moved : moved;
            }
        }
    }
};

}  // namespace
}  // namespace vt::VT_NS
