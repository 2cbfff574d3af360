// Vertex normals: face normals weighted by area, gathered per welded point in the order of the rows, so that the result
// depends neither on threads nor on which copy of a point asks.
#include <math.h>

#include "kernels.h"

namespace vt::VT_NS {

// Cross products (twice the area long) of triangles [first, last); points (V,3), out (T,3).
void face_normals(int64_t first, int64_t last, const float* points, const int32_t* triangle, float* out) {
    for (int64_t t = first; t < last; ++t) {
        const float* a = points + 3 * int64_t(triangle[3 * t]);
        const float* b = points + 3 * int64_t(triangle[3 * t + 1]);
        const float* c = points + 3 * int64_t(triangle[3 * t + 2]);
        const float ux = b[0] - a[0], uy = b[1] - a[1], uz = b[2] - a[2];
        const float vx = c[0] - a[0], vy = c[1] - a[1], vz = c[2] - a[2];
        out[3 * t] = uy * vz - uz * vy;
        out[3 * t + 1] = uz * vx - ux * vz;
        out[3 * t + 2] = ux * vy - uy * vx;
    }
}

// Unit sums for vertices [first, last) of welded points: `row` and `face` say which faces meet at point[vertex].
void vertex_normals(int64_t first, int64_t last, const float* normal, const int32_t* row, const int32_t* face,
                    const int32_t* point, float* out) {
    for (int64_t v = first; v < last; ++v) {
        float x = 0, y = 0, z = 0;
        for (int32_t i = row[point[v]]; i < row[point[v] + 1]; ++i) {
            const float* n = normal + 3 * int64_t(face[i]);
            x += n[0];
            y += n[1];
            z += n[2];
        }
        const float length = sqrtf(x * x + y * y + z * z);
        const float s = length > 0 ? 1.0f / length : 0.0f;
        out[3 * v] = x * s;
        out[3 * v + 1] = y * s;
        out[3 * v + 2] = z * s;
    }
}

}  // namespace vt::VT_NS
