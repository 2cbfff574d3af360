// Vectors of three numbers and quaternions xyzw in double precision.
#pragma once
#include <cmath>

namespace vt::VT_NS {
namespace {

inline double dot(const double* a, const double* b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

inline void cross(const double* a, const double* b, double* out) {
    out[0] = a[1] * b[2] - a[2] * b[1];
    out[1] = a[2] * b[0] - a[0] * b[2];
    out[2] = a[0] * b[1] - a[1] * b[0];
}

inline double length(const double* v) { return std::sqrt(dot(v, v)); }

inline void make_unit(double* v) {
    const double n = length(v), s = 1.0 / (n > 1e-12 ? n : 1e-12);
    for (int i = 0; i < 3; ++i) v[i] *= s;
}

inline void multiply(const double* a, const double* b, double* out) {
    const double x = a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1];
    const double y = a[3] * b[1] + a[1] * b[3] + a[2] * b[0] - a[0] * b[2];
    const double z = a[3] * b[2] + a[2] * b[3] + a[0] * b[1] - a[1] * b[0];
    out[3] = a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2];
    out[0] = x;
    out[1] = y;
    out[2] = z;
}

inline void from_vector(const double* v, double* q) {
    const double angle = length(v), s = angle > 1e-8 ? std::sin(angle / 2) / angle : 0.5;
    for (int i = 0; i < 3; ++i) q[i] = s * v[i];
    q[3] = std::cos(angle / 2);
}

// The rotation vector, of length at most pi, of a * b^-1.
inline void turn_between(const double* a, const double* b, double* out) {
    const double back[4] = {-b[0], -b[1], -b[2], b[3]};
    double q[4];
    multiply(a, back, q);
    const double sign = q[3] < 0 ? -1.0 : 1.0, size = length(q), w = sign * q[3];
    const double s = size > 1e-12 ? sign * 2.0 * std::atan2(size, w) / size : 2.0 * sign;
    for (int i = 0; i < 3; ++i) out[i] = s * q[i];
}

inline void to_matrix(const double* q, double* m) {
    const double x = q[0], y = q[1], z = q[2], w = q[3], n = x * x + y * y + z * z + w * w, s = n > 0 ? 2.0 / n : 0.0;
    m[0] = 1 - s * (y * y + z * z);
    m[1] = s * (x * y - z * w);
    m[2] = s * (x * z + y * w);
    m[3] = s * (x * y + z * w);
    m[4] = 1 - s * (x * x + z * z);
    m[5] = s * (y * z - x * w);
    m[6] = s * (x * z - y * w);
    m[7] = s * (y * z + x * w);
    m[8] = 1 - s * (x * x + y * y);
}

// Of the first three columns of three rows of four, columns made unit.
inline void to_quaternion(const double* row, double* q) {
    double m[9];
    for (int c = 0; c < 3; ++c) {
        double v[3] = {row[c], row[4 + c], row[8 + c]};
        make_unit(v);
        for (int r = 0; r < 3; ++r) m[r * 3 + c] = v[r];
    }
    const double t[4] = {1 + m[0] - m[4] - m[8], 1 - m[0] + m[4] - m[8], 1 - m[0] - m[4] + m[8], 1 + m[0] + m[4] + m[8]};
    int best = 0;
    for (int i = 1; i < 4; ++i)
        if (t[i] > t[best]) best = i;
    const double s = 0.5 / std::sqrt(t[best] > 1e-300 ? t[best] : 1e-300);
    const double d[3] = {m[7] - m[5], m[2] - m[6], m[3] - m[1]};
    const double e[3] = {m[5] + m[7], m[2] + m[6], m[1] + m[3]};
    if (best == 3) {
        for (int i = 0; i < 3; ++i) q[i] = d[i] * s;
    } else {
        for (int i = 0; i < 3; ++i) q[i] = i == best ? t[best] * s : e[3 - best - i] * s;
    }
    q[3] = best == 3 ? t[3] * s : d[best] * s;
}

}  // namespace
}  // namespace vt::VT_NS
