// What is nearest on a body to a vertex of cloth, from a triangle that was. Included by kernels, which are compiled twice.
#pragma once
#include <cmath>
#include <cstdint>

#include "cloth.h"
#include "lanes.h"

namespace vt::VT_NS {
namespace {

// The point of a triangle nearest to x: shares of its corners (Ericson, Real-Time Collision Detection, 5.1.5). Returns
// which edge it lies on (0: from corner 0 to 1, ...), -1 inside.
inline int foot(const float* x, const float p[3][3], float share[3]) {
    float ab[3], ac[3], ap[3], bp[3], cp[3];
    for (int j = 0; j < 3; ++j) {
        ab[j] = p[1][j] - p[0][j], ac[j] = p[2][j] - p[0][j];
        ap[j] = x[j] - p[0][j], bp[j] = x[j] - p[1][j], cp[j] = x[j] - p[2][j];
    }
    const auto product = [](const float* u, const float* v) { return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]; };
    const float d1 = product(ab, ap), d2 = product(ac, ap), d3 = product(ab, bp), d4 = product(ac, bp);
    const float d5 = product(ab, cp), d6 = product(ac, cp);
    const float va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2;
    share[0] = share[1] = share[2] = 0;
    if (d1 <= 0 && d2 <= 0) {
        share[0] = 1;
        return d1 > d2 ? 0 : 2;
    }
    if (d3 >= 0 && d4 <= d3) {
        share[1] = 1;
        return d4 > d3 - d4 ? 1 : 0;
    }
    if (d6 >= 0 && d5 <= d6) {
        share[2] = 1;
        return d5 > d6 - d5 ? 1 : 2;
    }
    if (vc <= 0 && d1 >= 0 && d3 <= 0) {
        share[1] = d1 - d3 > 0 ? d1 / (d1 - d3) : 0, share[0] = 1 - share[1];
        return 0;
    }
    if (vb <= 0 && d2 >= 0 && d6 <= 0) {
        share[2] = d2 - d6 > 0 ? d2 / (d2 - d6) : 0, share[0] = 1 - share[2];
        return 2;
    }
    if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) {
        const float w = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        share[2] = w, share[1] = 1 - w;
        return 1;
    }
    const float whole = va + vb + vc, one = whole != 0 ? 1 / whole : 0;
    share[1] = vb * one, share[2] = vc * one, share[0] = 1 - share[1] - share[2];
    return -1;
}

struct Foot {
    int32_t triangle;
    float share[3], now[3], normal[3], squared;
};

inline void corners(const ClothBody& body, int32_t t, float s, float p[3][3]) {
    for (int k = 0; k < 3; ++k) {
        const int64_t v = 6 * int64_t(body.triangle[3 * int64_t(t) + k]);
        for (int j = 0; j < 3; ++j) p[k][j] = body.before[v + j] + s * (body.after[v + j] - body.before[v + j]);
    }
}

inline float measure(const ClothBody& body, const float* x, int32_t t, float s, Foot& out, int& edge) {
    float p[3][3], share[3];
    corners(body, t, s, p);
    edge = foot(x, p, share);
    float now[3], squared = 0;
    for (int j = 0; j < 3; ++j) {
        now[j] = share[0] * p[0][j] + share[1] * p[1][j] + share[2] * p[2][j];
        squared += (x[j] - now[j]) * (x[j] - now[j]);
    }
    out.triangle = t, out.squared = squared;
    for (int j = 0; j < 3; ++j) out.share[j] = share[j], out.now[j] = now[j];
    return squared;
}

// From the triangle that was nearest, over edges, as long as it gets nearer; true if it ends inside one.
inline bool walk(const ClothBody& body, const float* x, int32_t start, float s, Foot& best) {
    int edge = -1;
    measure(body, x, start, s, best, edge);
    int32_t from = -1;
    for (int steps = 0; steps < 24 && edge >= 0; ++steps) {
        bool moved = false;
        const int32_t here = best.triangle;
        // the edge that the foot lies on first, then the others that meet in its corner
        for (int turn = 0; turn < 3; ++turn) {
            const int k = (edge + turn) % 3, a = k, b = (k + 1) % 3;
            if (best.share[a] + best.share[b] < 1 - 1e-6f) continue;
            const int32_t next = body.neighbour[3 * int64_t(here) + k];
            if (next < 0 || next == from) continue;
            Foot other;
            int side = -1;
            if (measure(body, x, next, s, other, side) < best.squared * (1 - 1e-6f) - 1e-14f) {
                from = here, best = other, edge = side, moved = true;
                break;
            }
        }
        if (!moved) return false;
    }
    return edge < 0;
}

}  // namespace
}  // namespace vt::VT_NS
