// Normal equations of joints in a tree. A number moves only what hangs on its joint, so two numbers meet only where one
// is above the other: each row of J^T J keeps its ancestors alone, packed, and elimination from the leaves to the root
// fills nothing in (Featherstone, Rigid Body Dynamics Algorithms, sections 6.2 and 6.4 for composite bodies, 6.5 for the
// factor L^T L).
#pragma once
#include <cmath>
#include <cstdint>

#include "kernels.h"

namespace vt::VT_NS {
namespace {

// Rows of numbers: that of d is [start[d], start[d] + depth[d]], its ancestors from the root down and itself at the end;
// `chain` has their numbers. order: ancestors first.
struct Tree {
    int32_t *start, *depth, *order, *last, *chain;  // (n) (n) (n) (joints) (n (n + 1) / 2)
    int64_t size;                                   // entries of all rows
};

void plant(const PoseProblem& p, Tree& t) {
    int64_t count = 0;
    t.size = 0;
    int32_t root = -1;
    auto append = [&](int64_t d, int32_t up) {
        t.order[count++] = int32_t(d);
        t.start[d] = int32_t(t.size);
        t.depth[d] = up < 0 ? 0 : t.depth[up] + 1;
        for (int32_t i = 0; i < t.depth[d]; ++i) t.chain[t.size + i] = t.chain[t.start[up] + i];
        t.size += t.depth[d];
        t.chain[t.size++] = int32_t(d);
    };
    int64_t turning = p.columns;
    while (turning > 0 && p.column[turning * 2 - 2] < 0) --turning;  // shifts are the last
    for (int64_t d = turning; d < p.columns; ++d) {
        append(d, root);
        root = int32_t(d);
    }
    int64_t d = 0;
    for (int64_t j = 0; j < p.joints; ++j) {
        t.last[j] = p.parent[j] >= 0 ? t.last[p.parent[j]] : j == 0 ? root : -1;
        for (; d < turning && p.column[d * 2] == j; ++d) {
            append(d, t.last[j]);
            t.last[j] = int32_t(d);
        }
    }
}

// mass (joints, 42): of each joint a 6 x 6 matrix and a vector of 6: what wishes at it and below ask of a twist (turn,
// velocity at the origin). Adds the rows A (3, 6) of a wish: heft A^T A and A^T e.
void ask(double* mass, const double* rows, double heft, const double* e) {
    for (int i = 0; i < 3; ++i) {
        const double* r = rows + i * 6;
        for (int a = 0; a < 6; ++a) {
            const double h = heft * r[a];
            for (int b = 0; b < 6; ++b) mass[a * 6 + b] += h * r[b];
            mass[36 + a] += r[a] * e[i];
        }
    }
}

// J^T J, packed, and J^T e (n) of numbers whose twists are (n, 6).
void meet(const PoseProblem& p, const Tree& t, double* mass, const double* twist, double* normal, double* pull) {
    for (int64_t j = p.joints - 1; j > 0; --j)
        if (p.parent[j] >= 0)
            for (int i = 0; i < 42; ++i) mass[p.parent[j] * 42 + i] += mass[j * 42 + i];
    for (int64_t d = 0; d < p.columns; ++d) {
        const int64_t j = p.column[d * 2];
        const double *m = mass + (j < 0 ? 0 : j) * 42, *s = twist + d * 6;
        double f[6];
        for (int a = 0; a < 6; ++a) {
            f[a] = 0.0;
            for (int b = 0; b < 6; ++b) f[a] += m[b * 6 + a] * s[b];
        }
        pull[d] = 0.0;
        for (int a = 0; a < 6; ++a) pull[d] += s[a] * m[36 + a];
        double* row = normal + t.start[d];
        const int32_t* above = t.chain + t.start[d];
        for (int64_t i = 0; i <= t.depth[d]; ++i) {
            const double* o = twist + above[i] * 6;
            row[i] = f[0] * o[0] + f[1] * o[1] + f[2] * o[2] + f[3] * o[3] + f[4] * o[4] + f[5] * o[5];
        }
    }
}

// x of (N + damp) x = pull in the rows that are not held, x = fixed in the others; N packed. room: as N. false when the
// matrix is not positive definite.
bool step_of(const Tree& t, int64_t n, const double* normal, double damp, const double* pull, const int32_t* held,
             const double* fixed, double* room, double* x) {
    for (int64_t d = 0; d < n; ++d) x[d] = held[d] ? fixed[d] : pull[d];
    for (int64_t d = 0; d < n; ++d) {
        const double* from = normal + t.start[d];
        double* to = room + t.start[d];
        const int32_t* above = t.chain + t.start[d];
        const int64_t c = t.depth[d];
        for (int64_t i = 0; i < c; ++i) {
            const int32_t o = above[i];
            to[i] = held[d] || held[o] ? 0.0 : from[i];
            if (held[o] && !held[d]) x[d] -= from[i] * fixed[o];
            if (held[d] && !held[o]) x[o] -= from[i] * fixed[d];
        }
        to[c] = held[d] ? 1.0 : from[c] + damp;
    }
    for (int64_t k = n - 1; k >= 0; --k) {
        const int64_t d = t.order[k], c = t.depth[d];
        double* row = room + t.start[d];
        const int32_t* above = t.chain + t.start[d];
        if (!(row[c] > 0)) return false;
        const double root = std::sqrt(row[c]), one = 1.0 / root;
        row[c] = root;
        for (int64_t i = 0; i < c; ++i) row[i] *= one;
        for (int64_t i = 0; i < c; ++i) {
            const double s = row[i];
            if (s == 0.0) continue;
            double* other = room + t.start[above[i]];
            for (int64_t q = 0; q <= i; ++q) other[q] -= s * row[q];
        }
        x[d] *= one;
        for (int64_t i = 0; i < c; ++i) x[above[i]] -= row[i] * x[d];
    }
    for (int64_t k = 0; k < n; ++k) {
        const int64_t d = t.order[k], c = t.depth[d];
        const double* row = room + t.start[d];
        const int32_t* above = t.chain + t.start[d];
        double sum = x[d];
        for (int64_t i = 0; i < c; ++i) sum -= row[i] * x[above[i]];
        x[d] = sum / row[c];
    }
    return true;
}

}  // namespace
}  // namespace vt::VT_NS
