// Vectors of 4 and 8 floats: compiler vectors with GCC and Clang (which lower them to what the processor has), plain
// loops elsewhere. Everything here is internal to one instruction set.
#pragma once
#include <cstdint>
#include <cstring>
#include <math.h>
#if defined(__AVX__)
#include <immintrin.h>
#endif

#if defined(__GNUC__) || defined(__clang__)
#define VT_INLINE inline __attribute__((always_inline))
#else
#define VT_INLINE inline
#endif
#if defined(__GNUC__) || defined(__clang__)
#define VT_PREFETCH(place, write) __builtin_prefetch(place, write)
#else
#define VT_PREFETCH(place, write)
#endif
#if defined(__GNUC__) && !defined(__clang__)
#define VT_UNROLL _Pragma("GCC unroll 8")
#else
#define VT_UNROLL
#endif

namespace vt::VT_NS {

#if (defined(__GNUC__) || defined(__clang__)) && !defined(VT_PLAIN)  // VT_PLAIN: to test the loops
#define VT_VECTORS 1
typedef float f4 __attribute__((vector_size(16)));
typedef float f8 __attribute__((vector_size(32)));
typedef int32_t i8 __attribute__((vector_size(32)));
#if defined(__clang__) || __GNUC__ >= 12
#define VT_SHUFFLE8(a, b, ...) __builtin_shufflevector(a, b, __VA_ARGS__)
#else
#define VT_SHUFFLE8(a, b, ...) __builtin_shuffle(a, b, (i8){__VA_ARGS__})
#endif
#if defined(__AVX__)
static inline f8 join(f4 a, f4 b) { return _mm256_insertf128_ps(_mm256_castps128_ps256(a), b, 1); }
#else
static inline f8 join(f4 a, f4 b) { return f8{a[0], a[1], a[2], a[3], b[0], b[1], b[2], b[3]}; }
#endif
static inline f8 all(float x) { return f8{x, x, x, x, x, x, x, x}; }
static inline f8 where_negative(f8 x, f8 yes, f8 no) { return x < 0.0f ? yes : no; }
#else
template <int N>
struct Lanes {
    float v[N];
    float operator[](int i) const { return v[i]; }
    float& operator[](int i) { return v[i]; }
};
#define VT_LANES_OPERATOR(op)                                                                        \
    template <int N>                                                                                 \
    static inline Lanes<N> operator op(Lanes<N> a, Lanes<N> b) {                                     \
        for (int i = 0; i < N; ++i) a.v[i] = a.v[i] op b.v[i];                                       \
        return a;                                                                                    \
    }                                                                                                \
    template <int N>                                                                                 \
    static inline Lanes<N> operator op(Lanes<N> a, float b) {                                        \
        for (int i = 0; i < N; ++i) a.v[i] = a.v[i] op b;                                            \
        return a;                                                                                    \
    }                                                                                                \
    template <int N>                                                                                 \
    static inline Lanes<N> operator op(float a, Lanes<N> b) {                                        \
        for (int i = 0; i < N; ++i) b.v[i] = a op b.v[i];                                            \
        return b;                                                                                    \
    }
VT_LANES_OPERATOR(+)
VT_LANES_OPERATOR(-)
VT_LANES_OPERATOR(*)
VT_LANES_OPERATOR(/)
template <int N>
static inline Lanes<N>& operator+=(Lanes<N>& a, Lanes<N> b) {
    return a = a + b;
}
typedef Lanes<4> f4;
typedef Lanes<8> f8;
static inline f8 all(float x) { return f8{{x, x, x, x, x, x, x, x}}; }
static inline f8 where_negative(f8 x, f8 yes, f8 no) {
    for (int i = 0; i < 8; ++i) no.v[i] = x.v[i] < 0.0f ? yes.v[i] : no.v[i];
    return no;
}
#endif

static inline f4 load4(const float* p) {
    f4 v;
    memcpy(&v, p, sizeof v);
    return v;
}
static inline f8 load8(const float* p) {
    f8 v;
    memcpy(&v, p, sizeof v);
    return v;
}
static inline void store4(float* p, f4 v) { memcpy(p, &v, sizeof v); }
static inline void store8(float* p, f8 v) { memcpy(p, &v, sizeof v); }

#if defined(VT_VECTORS) && defined(__AVX__)
static inline f8 root(f8 x) { return _mm256_sqrt_ps(x); }
static inline f8 larger(f8 a, f8 b) { return _mm256_max_ps(a, b); }
static inline f8 smaller(f8 a, f8 b) { return _mm256_min_ps(a, b); }
static inline bool any_below(f8 x, float limit) { return _mm256_movemask_ps(x - limit) != 0; }
static inline uint32_t at_most(f8 x, float limit) {
    return uint32_t(_mm256_movemask_ps(_mm256_cmp_ps(x, all(limit), _CMP_LE_OQ)));
}
#else
static inline f8 root(f8 x) {
    float v[8];
    store8(v, x);
    for (int i = 0; i < 8; ++i) v[i] = sqrtf(v[i]);
    return load8(v);
}
static inline f8 larger(f8 a, f8 b) { return where_negative(a - b, b, a); }
static inline f8 smaller(f8 a, f8 b) { return where_negative(b - a, b, a); }
static inline bool any_below(f8 x, float limit) {
    float v[8];
    store8(v, x - limit);
    int found = 0;
    for (int i = 0; i < 8; ++i) found |= v[i] < 0.0f;
    return found;
}
// A bit for each that is not above the limit.
static inline uint32_t at_most(f8 x, float limit) {
    float v[8];
    store8(v, x);
    uint32_t found = 0;
    for (int i = 0; i < 8; ++i) found |= uint32_t(v[i] <= limit) << i;
    return found;
}
#endif

// A bit for each of eight triples (3, 8) of numbers that has one of those in another.
static inline uint32_t in_common(const int32_t one[3], const int32_t eight[3][8]) {
#if defined(VT_VECTORS)
    i8 hit = {0, 0, 0, 0, 0, 0, 0, 0};
    for (int j = 0; j < 3; ++j) {
        i8 other;
        memcpy(&other, eight[j], sizeof other);
        hit |= (other == one[0]) | (other == one[1]) | (other == one[2]);
    }
#if defined(__AVX__)
    return uint32_t(_mm256_movemask_ps(reinterpret_cast<f8>(hit)));
#endif
#else
    int32_t hit[8] = {0, 0, 0, 0, 0, 0, 0, 0};
    for (int j = 0; j < 3; ++j)
        for (int l = 0; l < 8; ++l)
            if (eight[j][l] == one[0] || eight[j][l] == one[1] || eight[j][l] == one[2]) hit[l] = 1;
#endif
#if !defined(VT_VECTORS) || !defined(__AVX__)
    uint32_t found = 0;
    for (int l = 0; l < 8; ++l) found |= uint32_t(hit[l] != 0) << l;
    return found;
#endif
}

// Columns of 8 rows of 8 floats: out[k] lane l = row l, place k.
static inline void transpose(const float* const row[8], f8 out[8]) {
#if defined(VT_VECTORS)
    for (int half = 0; half < 2; ++half) {
        f8 r[4];
        for (int i = 0; i < 4; ++i) {
            r[i] = join(load4(row[i] + 4 * half), load4(row[i + 4] + 4 * half));
        }
        const f8 t0 = VT_SHUFFLE8(r[0], r[1], 0, 8, 1, 9, 4, 12, 5, 13);
        const f8 t1 = VT_SHUFFLE8(r[0], r[1], 2, 10, 3, 11, 6, 14, 7, 15);
        const f8 t2 = VT_SHUFFLE8(r[2], r[3], 0, 8, 1, 9, 4, 12, 5, 13);
        const f8 t3 = VT_SHUFFLE8(r[2], r[3], 2, 10, 3, 11, 6, 14, 7, 15);
        out[4 * half + 0] = VT_SHUFFLE8(t0, t2, 0, 1, 8, 9, 4, 5, 12, 13);
        out[4 * half + 1] = VT_SHUFFLE8(t0, t2, 2, 3, 10, 11, 6, 7, 14, 15);
        out[4 * half + 2] = VT_SHUFFLE8(t1, t3, 0, 1, 8, 9, 4, 5, 12, 13);
        out[4 * half + 3] = VT_SHUFFLE8(t1, t3, 2, 3, 10, 11, 6, 7, 14, 15);
    }
#else
    for (int k = 0; k < 8; ++k)
        for (int l = 0; l < 8; ++l) out[k][l] = row[l][k];
#endif
}

// x0 y0 x1 y1 ... x7 y7
static inline void interleave(f8 x, f8 y, float out[16]) {
#if defined(VT_VECTORS)
    const f8 a = VT_SHUFFLE8(x, y, 0, 8, 1, 9, 4, 12, 5, 13), b = VT_SHUFFLE8(x, y, 2, 10, 3, 11, 6, 14, 7, 15);
    store8(out, VT_SHUFFLE8(a, b, 0, 1, 2, 3, 8, 9, 10, 11));
    store8(out + 8, VT_SHUFFLE8(a, b, 4, 5, 6, 7, 12, 13, 14, 15));
#else
    for (int l = 0; l < 8; ++l) {
        out[2 * l] = x[l];
        out[2 * l + 1] = y[l];
    }
#endif
}

}  // namespace vt::VT_NS
