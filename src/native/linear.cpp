// Linear blend skinning: A = I + sum w (M - I), exact when weights do not sum to one (ISO/IEC 19774-1, skinCoordWeight).
#include "kernels.h"
#include "matrices.h"

namespace vt::VT_NS {

// Matrices (n,4,4) float64 to M - I as four columns of three floats and a zero, (n,16).
void linear_table(int64_t count, const double* matrix, float* out) {
    for (int64_t n = 0; n < count; ++n)
        for (int c = 0; c < 4; ++c) {
            for (int r = 0; r < 3; ++r) out[n * 16 + c * 4 + r] = float(matrix[n * 16 + r * 4 + c] - (r == c ? 1 : 0));
            out[n * 16 + c * 4 + 3] = 0.0f;
        }
}

namespace {

const int kAhead = 64;  // vertices
const int kFrames = 4;  // that are worked on at once

struct Blend {
    f8 xy, zt;  // columns x, y and z, translation of A - I
};

inline f4 low(f8 v) {
    f4 r;
    memcpy(&r, &v, 16);
    return r;
}
inline f4 high(f8 v) {
    f4 r;
    memcpy(&r, reinterpret_cast<const char*>(&v) + 16, 16);
    return r;
}
// Four numbers twice, and one of them in all places: fewer loads than one per number, and loads are most of the work.
inline f8 twice(f4 v) {
#if defined(VT_VECTORS)
    return join(v, v);
#else
    f8 r;
    for (int i = 0; i < 8; ++i) r[i] = v[i % 4];
    return r;
#endif
}
VT_INLINE f8 spread(f8 v, int64_t k) {
#if defined(VT_VECTORS)
    switch (k) {
        case 0: return VT_SHUFFLE8(v, v, 0, 0, 0, 0, 4, 4, 4, 4);
        case 1: return VT_SHUFFLE8(v, v, 1, 1, 1, 1, 5, 5, 5, 5);
        case 2: return VT_SHUFFLE8(v, v, 2, 2, 2, 2, 6, 6, 6, 6);
        default: return VT_SHUFFLE8(v, v, 3, 3, 3, 3, 7, 7, 7, 7);
    }
#else
    return all(v[int(k)]);
#endif
}
inline void store2(float* p, f4 v) { memcpy(p, &v, 8); }

template <int K>
inline Blend blend(const float* table, const int32_t* joint, const float* weight, int64_t count) {
    Blend b;
    if (!K && !count) {
        b.xy = b.zt = all(0.0f);
        return b;
    }
    b.xy = load8(table + joint[0]) * weight[0];
    b.zt = load8(table + joint[0] + 8) * weight[0];
    for (int64_t k = 1; k < (K ? K : count); ++k) {
        b.xy += load8(table + joint[k]) * weight[k];
        b.zt += load8(table + joint[k] + 8) * weight[k];
    }
    return b;
}

inline f4 move(const Blend& b, f4 p) {
    return low(b.xy) * p[0] + high(b.xy) * p[1] + (low(b.zt) * p[2] + high(b.zt));
}

// N frames at once, `joints` * 16 floats apart in the table and `stride` in out: they share the loads of joints and
// weights, which are half of all.
template <int K, int N>
void points(const Bucket& bucket, int64_t first, int64_t last, int64_t joints, const float* table, float* out,
            int64_t stride) {
    const auto one = [&](int64_t i, f4 p) {
        const int64_t entry = K ? i * K : bucket.row[i];
        const int64_t count = K ? K : bucket.row[i + 1] - entry;
        Blend b[N];
        VT_UNROLL for (int f = 0; f < N; ++f) b[f].xy = b[f].zt = all(0.0f);
        f8 weights;
        VT_UNROLL for (int64_t k = 0; k < (K ? K : count); ++k) {
            if (K >= 4 && k % 4 == 0) weights = twice(load4(bucket.weight + entry + k));
            const f8 w = K >= 4 ? spread(weights, k % 4) : all(bucket.weight[entry + k]);
            const float* row = table + bucket.joint[entry + k];
            VT_UNROLL for (int f = 0; f < N; ++f) {
                const f8 xy = load8(row + f * joints * 16), zt = load8(row + f * joints * 16 + 8);
                b[f].xy = k ? b[f].xy + xy * w : xy * w;
                b[f].zt = k ? b[f].zt + zt * w : zt * w;
            }
        }
        float* o = out + 3 * (bucket.target ? bucket.target[i] : i);
        VT_UNROLL for (int f = 0; f < N; ++f) {
            const f4 moved = p + move(b[f], p);
            store2(o + f * stride, moved);
            o[f * stride + 2] = moved[2];
        }
    };
    int64_t i = first;
    for (; K && N == 1 && i + 4 < last; i += 4) {  // large meshes wait for memory
        const int64_t soon = i + kAhead;
        VT_PREFETCH(bucket.joint + soon * K, 0);
        VT_PREFETCH(bucket.weight + soon * K, 0);
        VT_PREFETCH(bucket.rest + soon * 3, 0);
        VT_PREFETCH(out + soon * 3, 1);
        for (int64_t l = 0; l < 4; ++l) one(i + l, load4(bucket.rest + (i + l) * 3));
    }
    for (; i + 1 < last; ++i) one(i, load4(bucket.rest + i * 3));
    float p[4] = {0, 0, 0, 0};  // the last position has nothing behind it to read
    memcpy(p, bucket.rest + (last - 1) * 3, 12);
    one(last - 1, load4(p));
}

template <int K>
void frames(const Bucket& bucket, int64_t first, int64_t last, const float* table, float* out) {
    for (int64_t i = first; i < last; ++i) {
        const int64_t entry = K ? i * K : bucket.row[i];
        const int64_t count = K ? K : bucket.row[i + 1] - entry;
        const Blend b = blend<K>(table, bucket.joint + entry, bucket.weight + entry, count);
        const f4 column[4] = {low(b.xy), high(b.xy), low(b.zt), high(b.zt)};
        float* o = out + 12 * (bucket.target ? bucket.target[i] : i);
        for (int r = 0; r < 3; ++r)
            for (int c = 0; c < 4; ++c) o[r * 4 + c] = column[c][r] + (r == c ? 1.0f : 0.0f);
    }
}

template <int K>
void run(const Bucket& bucket, int64_t first, int64_t last, int64_t count, int64_t joints, const float* table,
         float* out, int64_t stride, bool whole) {
    int64_t f = 0;
    for (; !whole && f + kFrames <= count; f += kFrames)
        points<K, kFrames>(bucket, first, last, joints, table + f * joints * 16, out + f * stride, stride);
    for (; f < count; ++f) {
        if (whole)
            frames<K>(bucket, first, last, table + f * joints * 16, out + f * stride);
        else
            points<K, 1>(bucket, first, last, joints, table + f * joints * 16, out + f * stride, stride);
    }
}

}  // namespace

// Vertices [first, last) of a bucket in `frames` frames; table (frames, joints, 16); out with `stride` floats between
// frames, three numbers per vertex, or with `whole` the twelve of A.
void linear(const Bucket& bucket, int64_t first, int64_t last, int64_t frames, int64_t joints, const float* table,
            float* out, int64_t stride, bool whole) {
    switch (bucket.influences) {
        case 1: return run<1>(bucket, first, last, frames, joints, table, out, stride, whole);
        case 2: return run<2>(bucket, first, last, frames, joints, table, out, stride, whole);
        case 4: return run<4>(bucket, first, last, frames, joints, table, out, stride, whole);
        case 8: return run<8>(bucket, first, last, frames, joints, table, out, stride, whole);
        default: return run<0>(bucket, first, last, frames, joints, table, out, stride, whole);
    }
}

namespace {

template <int K>
void run_lanes(const Bucket& bucket, int64_t first, int64_t last, int64_t frames, int64_t joints, const float* table,
               float* out, int64_t stride, bool whole) {
    for (int64_t f = 0; f < frames; ++f) {
        const float* t = table + f * joints * 16;
        float* o = out + f * stride;
        for (int64_t place = first; place < last; place += 8) {
            const int32_t* joint = bucket.joint + place / 8 * K;
            const float* weight = bucket.weight + place * K;
            const float* rest = bucket.rest + place * 3;
            if (whole) {
                f8 m[12];
                blend_matrices<K, true, 1>(t, joint, weight, m);
                write_frames(bucket.target, place, last, m, o);
                continue;
            }
            const f8 p[3] = {load8(rest), load8(rest + 8), load8(rest + 16)};
            f8 moved[3];
            blend_points<K, true, 1>(t, joint, weight, p, moved);
            write_points(bucket.target, place, last, moved, o);
        }
    }
}

}  // namespace

// `linear` of a bucket in lane layout with shared joints; `first` is a multiple of 8.
void linear_lanes(const Bucket& bucket, int64_t first, int64_t last, int64_t frames, int64_t joints, const float* table,
                  float* out, int64_t stride, bool whole) {
    switch (bucket.influences) {
        case 1: return run_lanes<1>(bucket, first, last, frames, joints, table, out, stride, whole);
        case 2: return run_lanes<2>(bucket, first, last, frames, joints, table, out, stride, whole);
        case 4: return run_lanes<4>(bucket, first, last, frames, joints, table, out, stride, whole);
        case 8: return run_lanes<8>(bucket, first, last, frames, joints, table, out, stride, whole);
        default: return;  // linear_buckets makes no others, the binding checks it
    }
}

// What `linear_lanes` of four influences cannot go below, for benchmarks: its loads and stores, with additions in place of
// the arithmetic. Without a table it leaves out the matrices, which are in the first level cache.
void touch(const Bucket& bucket, int64_t first, int64_t last, const float* table, float* out) {
    for (int64_t place = first; place < last; place += 8) {
        const int32_t* joint = bucket.joint + place / 8 * 4;
        const float* weight = bucket.weight + place * 4;
        const float* rest = bucket.rest + place * 3;
        f8 moved[3];
        for (int r = 0; r < 3; ++r) {
            f8 sum[4];
            for (int k = 0; k < 4; ++k) {
                sum[k] = load8(weight + k * 8);
                const float* t = table ? table + joint[k] + r : nullptr;
                for (int c = 0; t && c < 4; ++c) sum[k] += all(t[c * 4]);
            }
            moved[r] = load8(rest + 8 * r) + ((sum[0] + sum[1]) + (sum[2] + sum[3]));
        }
        if (!table) moved[0] += all(float(joint[0] ^ joint[1] ^ joint[2] ^ joint[3]));
        write_points(bucket.target, place, last, moved, out);
    }
}

}  // namespace vt::VT_NS
