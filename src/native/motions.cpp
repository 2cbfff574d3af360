#include "motions.h"

#include <cmath>
#include <utility>

namespace vt {
namespace {

const double kNear = std::cos(std::acos(-1.0) / 8);

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

void dual_table(int64_t frames, int64_t joints, const double* matrix, int64_t edges, const int32_t* tree, int64_t lefts,
                const int32_t* left, bool follow, float* out, uint8_t* agree, double* scratch) {
    double* q = scratch;
    double* now = scratch + 4 * (joints + 1);
    double* before = now + 4 * edges;
    for (int64_t f = 0; f < frames; ++f) {
        const double* m = matrix + f * joints * 16;
        for (int64_t j = 0; j < joints; ++j) quaternion(m + j * 16, q + 4 * j);
        double* still = q + 4 * joints;
        still[0] = still[1] = still[2] = 0;
        still[3] = 1;
        bool close = f > 0;
        for (int64_t e = 0; e < edges; ++e) {
            const double* a = q + 4 * int64_t(tree[2 * e]);
            double* b = q + 4 * int64_t(tree[2 * e + 1]);
            if (dot(a, b) < 0) negate(b);
            relative(a, b, now + 4 * e);
            close = close && std::fabs(dot(now + 4 * e, before + 4 * e)) >= kNear;
        }
        bool wound = false;
        if (follow) {
            for (int64_t e = 0; e < edges; ++e) {
                const double* a = q + 4 * int64_t(tree[2 * e]);
                double* b = q + 4 * int64_t(tree[2 * e + 1]);
                relative(a, b, now + 4 * e);
                if (close && dot(now + 4 * e, before + 4 * e) < 0) {
                    negate(b);
                    negate(now + 4 * e);
                }
                wound = wound || now[4 * e + 3] < 0;
            }
            std::swap(now, before);
        }
        agree[f] = 1;
        for (int64_t p = 0; p < lefts && !wound; ++p)
            if (dot(q + 4 * int64_t(left[2 * p]), q + 4 * int64_t(left[2 * p + 1])) < 0) agree[f] = 0;
        for (int64_t j = 0; j <= joints; ++j) {
            const double *r = q + 4 * j, *n = m + j * 16;
            const double a = j < joints ? n[3] : 0, b = j < joints ? n[7] : 0, c = j < joints ? n[11] : 0;
            float* o = out + (f * (joints + 1) + j) * 8;
            for (int k = 0; k < 4; ++k) o[k] = float(r[k]);
            o[4] = float(0.5 * (a * r[3] + b * r[2] - c * r[1]));
            o[5] = float(0.5 * (-a * r[2] + b * r[3] + c * r[0]));
            o[6] = float(0.5 * (a * r[1] - b * r[0] + c * r[3]));
            o[7] = float(0.5 * (-a * r[0] - b * r[1] - c * r[2]));
        }
    }
}

}  // namespace vt
