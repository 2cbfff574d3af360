#include "motions.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace vt {
namespace {

const double kHalfTurn = std::acos(-1.0);
const double kNear = std::cos(kHalfTurn / 8);

double dot(const double* a, const double* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3]; }

void negate(double* q) {
    for (int c = 0; c < 4; ++c) q[c] = -q[c];
}

// Largest component first. S. Shepperd, "Quaternion from Rotation Matrix" (1978).
void quaternion(const double* m, double* q) {
    const double trace = m[0] + m[5] + m[10];
    const double four[4] = {1 + 2 * m[0] - trace, 1 + 2 * m[5] - trace, 1 + 2 * m[10] - trace, 1 + trace};
    int best = 0;
    for (int k = 1; k < 4; ++k)
        if (four[k] > four[best]) best = k;
    const double yx = m[1] + m[4], zx = m[2] + m[8], zy = m[6] + m[9];
    const double wx = m[9] - m[6], wy = m[2] - m[8], wz = m[4] - m[1];
    const double rows[4][4] = {{four[0], yx, zx, wx}, {yx, four[1], zy, wy}, {zx, zy, four[2], wz}, {wx, wy, wz, four[3]}};
    const double length = std::sqrt(dot(rows[best], rows[best]));
    const double sign = rows[best][3] < 0 ? -1 : 1;
    for (int c = 0; c < 4; ++c) q[c] = sign * rows[best][c] / length;
}

// a^-1 b
void relative(const double* a, const double* b, double* out) {
    out[0] = a[3] * b[0] - a[0] * b[3] - a[1] * b[2] + a[2] * b[1];
    out[1] = a[3] * b[1] + a[0] * b[2] - a[1] * b[3] - a[2] * b[0];
    out[2] = a[3] * b[2] - a[0] * b[1] + a[1] * b[0] - a[2] * b[3];
    out[3] = dot(a, b);
}

}  // namespace

double deviation(int64_t count, const double* matrix) {
    double worst = 0;
    for (const double* m = matrix; m != matrix + count * 16; m += 16) {
        for (int a = 0; a < 3; ++a)
            for (int b = a; b < 3; ++b) {
                const double d = m[a] * m[b] + m[4 + a] * m[4 + b] + m[8 + a] * m[8 + b] - (a == b ? 1 : 0);
                if (!(std::fabs(d) <= worst)) worst = std::fabs(d);
            }
        const double det = m[0] * (m[5] * m[10] - m[6] * m[9]) - m[1] * (m[4] * m[10] - m[6] * m[8]) +
                           m[2] * (m[4] * m[9] - m[5] * m[8]);
        if (det <= 0) worst = worst > 2 ? worst : 2;
    }
    return worst;
}

int64_t motion_scratch(const MotionJob& job) { return 12 * (job.joints + 1) + 8 * job.edges + job.pairs; }

namespace {

// Half the logarithm of the unit dual quaternion a^-1 b, negated when `shorter` and more than half a turn.
// R. Murray, Z. Li, S. Sastry, "A Mathematical Introduction to Robotic Manipulation" (1994), section 2.3.
void half_twist(const double* a, const double* b, bool shorter, float* out) {
    double q[4], d[4], e[4];
    relative(a, b, q);
    relative(a, b + 4, d);
    relative(a + 4, b, e);
    double sign = shorter && q[3] < 0 ? -1 : 1;
    for (int c = 0; c < 4; ++c) {
        q[c] *= sign;
        d[c] = sign * (d[c] + e[c]);
    }
    // With h the half angle and g its dual part, real and dual vector are s sin h and m sin h + s g cos h, the dual scalar
    // is -g sin h; wanted are s h and m h + s g.
    double length = std::sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2]);
    const double h = std::atan2(length, q[3]);
    const bool small = length < 1e-4 && q[3] > 0;
    if (!small) length = std::fmax(length, 1e-7);  // at a full turn the axis is lost
    const double f = small ? 1 + length * length / 6 : h / length;
    const double slope = small ? -d[3] / 3 : -d[3] * (1 - f * q[3]) / (length * length);
    for (int c = 0; c < 3; ++c) {
        out[c] = float(f * q[c]);
        out[4 + c] = float(f * d[c] + slope * q[c]);
    }
    out[3] = out[7] = 0;
}

// One frame: quaternions (joints + 1, 4) whose signs agree; whether they do on all pairs.
bool signs(const MotionJob& job, const double* m, double* q, double* now, const double* before) {
    for (int64_t j = 0; j < job.joints; ++j) quaternion(m + j * 16, q + 4 * j);
    double* still = q + 4 * job.joints;
    still[0] = still[1] = still[2] = 0;
    still[3] = 1;
    bool wound = false, agree = true;
    for (int64_t e = 0; e < job.edges; ++e) {
        const double* a = q + 4 * int64_t(job.tree[2 * e]);
        double* b = q + 4 * int64_t(job.tree[2 * e + 1]);
        double* turn = now + 4 * e;
        relative(a, b, turn);
        bool flip = turn[3] < 0;
        if (before) {
            const double same = dot(turn, before + 4 * e);
            if (std::fabs(same) >= kNear) flip = same < 0;
        }
        if (flip) {
            negate(b);
            negate(turn);
        }
        wound = wound || turn[3] < 0;
    }
    for (int64_t p = 0; p < job.lefts && !wound; ++p)
        if (dot(q + 4 * int64_t(job.left[2 * p]), q + 4 * int64_t(job.left[2 * p + 1])) < 0) agree = false;
    return agree;
}

// Calls work(frame, quaternions, whether signs agree) for each frame.
template <class F>
void each_frame(const MotionJob& job, double* scratch, F&& work) {
    double* q = scratch;
    double* now = q + 4 * (job.joints + 1);
    double* before = now + 4 * job.edges;
    bool some = false;
    if (job.follow && job.memory && job.edges && !std::isnan(job.memory[0])) {
        std::copy(job.memory, job.memory + 4 * job.edges, before);
        some = true;
    }
    for (int64_t f = 0; f < job.frames; ++f) {
        const bool agree = signs(job, job.matrix + f * job.joints * 16, q, now, some ? before : nullptr);
        work(f, q, agree);
        if (job.follow) {
            std::swap(now, before);
            some = true;
        }
    }
    if (job.follow && job.memory && some) std::copy(before, before + 4 * job.edges, job.memory);
}

}  // namespace

void motion_tables(const MotionJob& job, double* scratch) {
    double* dual = scratch + 4 * (job.joints + 1) + 8 * job.edges;
    each_frame(job, scratch, [&](int64_t f, const double* q, bool agree) {
        if (job.agree) job.agree[f] = agree;
        for (int64_t j = 0; j <= job.joints; ++j) {
            const double *r = q + 4 * j, *n = job.matrix + (f * job.joints + j) * 16;
            const bool moves = j < job.joints;
            const double a = moves ? n[3] : 0, b = moves ? n[7] : 0, c = moves ? n[11] : 0;
            double* o = dual + j * 8;
            for (int k = 0; k < 4; ++k) o[k] = r[k];
            o[4] = 0.5 * (a * r[3] + b * r[2] - c * r[1]);
            o[5] = 0.5 * (-a * r[2] + b * r[3] + c * r[0]);
            o[6] = 0.5 * (a * r[1] - b * r[0] + c * r[3]);
            o[7] = 0.5 * (-a * r[0] - b * r[1] - c * r[2]);
        }
        const int64_t size = 8 * (job.joints + 1);
        if (job.dual)
            for (int64_t i = 0; i < size; ++i) job.dual[f * size + i] = float(dual[i]);
        for (int64_t p = 0; p < job.pairs && job.twist; ++p)
            half_twist(dual + 8 * int64_t(job.pair[2 * p]), dual + 8 * int64_t(job.pair[2 * p + 1]), !agree,
                       job.twist + (f * job.pairs + p) * 8);
    });
}

void turn_shares(const MotionJob& job, const double* low, const double* high, bool hard, int64_t sets, const int32_t* row,
                 const int32_t* member, double* scratch, float* out) {
    double* share = scratch + 12 * (job.joints + 1) + 8 * job.edges;
    each_frame(job, scratch, [&](int64_t f, const double* q, bool agree) {
        for (int64_t p = 0; p < job.pairs; ++p) {
            double cosine = dot(q + 4 * int64_t(job.pair[2 * p]), q + 4 * int64_t(job.pair[2 * p + 1]));
            if (!agree) cosine = std::fabs(cosine);
            // The arc cosine only between the bounds: 1 - x^2/2 <= cos x <= 1 - x^2/2 + x^4/24.
            const double least = low[p] * low[p] / 8, most = high[p] * high[p] / 8;
            double s;
            if (!hard && cosine >= 1 - least + least * least / 6) {
                s = 0;
            } else if (cosine <= 1 - most) {
                s = 1;
            } else {
                const double angle = 2 * std::acos(std::fmax(-1.0, std::fmin(cosine, 1.0)));
                s = hard ? angle >= high[p] : (angle - low[p]) / (high[p] - low[p]);
            }
            s = s < 0 ? 0 : s > 1 ? 1 : s;
            share[p] = high[p] >= kHalfTurn ? 0 : high[p] <= 0 ? 1 : s * s * (3 - 2 * s);
        }
        for (int64_t i = 0; i < sets; ++i) {
            double most = 0;
            for (int32_t k = row[i]; k < row[i + 1]; ++k) most = std::fmax(most, share[member[k]]);
            out[f * sets + i] = float(most);
        }
    });
}

}  // namespace vt
