// Vertex normals: face normals weighted by area, gathered per welded point in the order of the rows, so that the result
// depends neither on threads nor on which copy of a point asks.
#include "kernels.h"
#include "lanes.h"

namespace vt::VT_NS {

namespace {

// y z x w
inline f4 turned(f4 v) {
#if !defined(VT_VECTORS)
    f4 r;
    r[0] = v[1];
    r[1] = v[2];
    r[2] = v[0];
    r[3] = v[3];
    return r;
#elif defined(__clang__) || __GNUC__ >= 12
    return __builtin_shufflevector(v, v, 1, 2, 0, 3);
#else
    typedef int32_t i4 __attribute__((vector_size(16)));
    return __builtin_shuffle(v, (i4){1, 2, 0, 3});
#endif
}

}  // namespace

// Cross products (twice the area long) of triangles [first, last); points (count,3), out (T,4), the fourth meaningless.
void face_normals(int64_t first, int64_t last, int64_t count, const float* points, const int32_t* triangle, float* out) {
    const auto load = [&](int64_t i) {
        if (i + 1 < count) return load4(points + 3 * i);
        float p[4] = {0, 0, 0, 0};  // the last position has nothing behind it to read
        memcpy(p, points + 3 * i, 12);
        return load4(p);
    };
    for (int64_t t = first; t < last; ++t) {
        const f4 a = load(triangle[3 * t]);
        const f4 u = load(triangle[3 * t + 1]) - a, v = load(triangle[3 * t + 2]) - a;
        store4(out + 4 * t, turned(u * turned(v) - turned(u) * v));
    }
}

// Unit sums for vertices order[first .. last) of welded points: `row` and `face` say which faces meet at point[vertex].
// In an order in which as many faces meet at one vertex as at the next, the processor foresees how long the sums are.
void vertex_normals(int64_t first, int64_t last, const float* normal, const int32_t* row, const int32_t* face,
                    const int32_t* point, const int32_t* order, float* out) {
    for (int64_t i = first; i < last; ++i) {
        const int64_t v = order[i];
        const int32_t start = row[point[v]], stop = row[point[v] + 1];
        const float none[4] = {0, 0, 0, 0};
        f4 sum = load4(none);
        for (int32_t k = start; k < stop; ++k) sum = sum + load4(normal + 4 * int64_t(face[k]));
        const float x = sum[0], y = sum[1], z = sum[2];
        const float length = sqrtf(x * x + y * y + z * z);
        const float s = length > 0 ? 1.0f / length : 0.0f;
        out[3 * v] = x * s;
        out[3 * v + 1] = y * s;
        out[3 * v + 2] = z * s;
    }
}

}  // namespace vt::VT_NS
