// Forward kinematics. Source: ISO/IEC 19775-1, Transform (T C R SR S -SR -C).
#include "kernels.h"

namespace vt::VT_NS {

// Frames [first, last). rotation (F,J,4) xyzw of any length but zero; translation with 0 or 3 J doubles between frames;
// root (F,3) replaces joint 0's translation, stretch (J,3,3) and binding (J,4,4) may be null; out (F,J,4,4).
void forward_kinematics(int64_t first, int64_t last, int64_t joints, const int32_t* parent, const double* center,
                        const double* rotation, const double* translation, int64_t translation_stride,
                        const double* root, const double* stretch, const double* binding, double* out) {
    for (int64_t f = first; f < last; ++f) {
        double* frame = out + f * joints * 16;
        for (int64_t j = 0; j < joints; ++j) {
            const double* q = rotation + (f * joints + j) * 4;
            const double* c = center + j * 3;
            const double* t = j == 0 && root ? root + f * 3 : translation + f * translation_stride + j * 3;
            const double x = q[0], y = q[1], z = q[2], w = q[3];
            const double norm = x * x + y * y + z * z + w * w;
            const double s = norm > 0 ? 2.0 / norm : 0.0;  // a zero quaternion does not turn
            double local[3][4] = {
                {1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w), 0},
                {s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w), 0},
                {s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y), 0},
            };
            if (stretch) {
                const double* e = stretch + j * 9;
                for (auto& r : local) {
                    const double a = r[0], b = r[1], d = r[2];
                    for (int k = 0; k < 3; ++k) r[k] = a * e[k] + b * e[3 + k] + d * e[6 + k];
                }
            }
            for (int r = 0; r < 3; ++r)
                local[r][3] = t[r] + c[r] - (local[r][0] * c[0] + local[r][1] * c[1] + local[r][2] * c[2]);
            double* m = frame + j * 16;
            if (parent[j] < 0) {
                for (int r = 0; r < 3; ++r)
                    for (int k = 0; k < 4; ++k) m[r * 4 + k] = local[r][k];
            } else {
                const double* p = frame + int64_t(parent[j]) * 16;
                for (int r = 0; r < 3; ++r) {
                    const double a = p[r * 4], b = p[r * 4 + 1], d = p[r * 4 + 2], e = p[r * 4 + 3];
                    for (int k = 0; k < 4; ++k)
                        m[r * 4 + k] = a * local[0][k] + b * local[1][k] + d * local[2][k] + (k == 3 ? e : 0.0);
                }
            }
            m[12] = m[13] = m[14] = 0.0;
            m[15] = 1.0;
        }
        if (!binding) continue;
        for (int64_t j = 0; j < joints; ++j) {
            double* m = frame + j * 16;
            const double* b = binding + j * 16;
            for (int r = 0; r < 4; ++r) {
                const double a0 = m[r * 4], a1 = m[r * 4 + 1], a2 = m[r * 4 + 2], a3 = m[r * 4 + 3];
                for (int k = 0; k < 4; ++k) m[r * 4 + k] = a0 * b[k] + a1 * b[4 + k] + a2 * b[8 + k] + a3 * b[12 + k];
            }
        }
    }
}

}  // namespace vt::VT_NS
