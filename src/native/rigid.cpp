// Operators that blend rigid motions, eight vertices at a time.
//
// Dual quaternions: L. Kavan et al., "Geometric Skinning with Approximate Dual Quaternion Blending" (2008).
// Karcher step A <- A exp(sum w log(A^-1 M)) without leaving dual quaternions: log(A^-1 q) is the vector part of
// A^-1 q times f(c), with c = A . q a dual number and f(c) = acos(c) / sqrt(1 - c^2). Dual numbers commute, so the sum
// is the vector part of A^-1 B with B = sum w f(c) q: one more blend, with other weights. As |A| = 1, its length is
// n = B . B - s^2 with s = A . B, and A exp(.) = A (C(n) - S(n) s) + S(n) B with C = cos sqrt(n), S = sin sqrt(n) /
// sqrt(n), all dual numbers. No trigonometry, no product of quaternions.
#include "dual.h"
#include "kernels.h"
#include "near.h"

namespace vt::VT_NS {

namespace {

// Where the real part has no length, the motion of the joint with the largest weight.
inline void mend(Dual& b, const float* table, const int32_t* joint, const float* weight, int n) {
    const f8 length = dot(b.v, b.v);
    if (!any_below(length, 1e-14f)) return;
    float v[8][8], size[8];
    store8(size, length);
    for (int c = 0; c < 8; ++c) store8(v[c], b.v[c]);
    for (int l = 0; l < 8; ++l) {
        if (size[l] >= 1e-14f) continue;
        int best = 0;
        for (int k = 1; k < n; ++k)
            if (weight[k * 8 + l] > weight[best * 8 + l]) best = k;
        for (int c = 0; c < 8; ++c) v[c][l] = table[joint[best * 8 + l] + c];
    }
    for (int c = 0; c < 8; ++c) b.v[c] = load8(v[c]);
}

// Makes the real part one long.
inline void normalise(Dual& b) {
    const f8 inverse = 1.0f / root(dot(b.v, b.v));
    for (f8& c : b.v) c = c * inverse;
}

inline void perpendicular(Dual& b) {
    const f8 along = dot(b.v, b.v + 4);
    for (int c = 0; c < 4; ++c) b.v[4 + c] = b.v[4 + c] - b.v[c] * along;
}

// Signs against the joint with the largest weight, the first of equals: sign[k] is 1 or -1.
inline void choose_signs(const float* table, const int32_t* joint, const float* weight, int n, f8* sign) {
    Dual best = gather<false>(table, joint);
    f8 most = load8(weight);
    for (int k = 1; k < n; ++k) {
        const f8 w = load8(weight + k * 8), less = most - w;
        const Dual q = gather<false>(table, joint + k * 8);
        for (int c = 0; c < 4; ++c) best.v[c] = where_negative(less, q.v[c], best.v[c]);
        most = where_negative(less, w, most);
    }
    for (int k = 0; k < n; ++k)
        sign[k] = where_negative(dot(gather<false>(table, joint + k * 8).v, best.v), all(-1.0f), all(1.0f));
}

const int kBatch = 4;  // groups that go through each phase before the next one: their chains of arithmetic overlap

// What is worked out about one group of eight vertices. Phases are short so that everything stays in registers.
template <int K>
struct Work {
    const int32_t* joint;
    const float* weight;
    static constexpr int n = K;
    bool uniform;
    Dual a, b;
    f8 real[K], dual[K];  // weights of the second blend: w f and w f' c'
    f8 sign[K];
    Dual kept[K];         // gathered influences; those of uniform groups are read from the table again

    template <bool U>
    Dual influence(const float* table, int k) const {
        return U ? gather<true>(table, joint + k * 8) : kept[k];
    }

    // The sum of weight times dual quaternion.
    template <bool U>
    void blend(const float* table, bool flip, bool keep) {
        if (flip) choose_signs(table, joint, weight, n, sign);
        if (!U && keep)
            for (int k = 0; k < n; ++k) kept[k] = gather<false>(table, joint + k * 8);
        if (!flip && (U || !keep)) {
            a = sum_rows<K, U>(table, joint, weight, n);
            return;
        }
        for (int k = 0; k < n; ++k) {
            const Dual q = U || keep ? influence<U>(table, k) : gather<false>(table, joint + k * 8);
            const f8 w = flip ? load8(weight + k * 8) * sign[k] : load8(weight + k * 8);
            for (int c = 0; c < 8; ++c) a.v[c] = k ? a.v[c] + w * q.v[c] : w * q.v[c];
        }
    }

    // Weights of the second blend.
    template <bool U>
    void compare(const float* table, bool flip) {
        VT_UNROLL for (int k = 0; k < n; ++k) {
            const Dual q = influence<U>(table, k);
            f8 w = load8(weight + k * 8), c = dot(a.v, q.v), c_dual = dot(a.v, q.v + 4) + dot(a.v + 4, q.v);
            if (flip) {
                c = c * sign[k];
                c_dual = c_dual * sign[k];
                w = w * sign[k];
            }
            f8 f, slope;
            angle_over_sine(c, f, slope);
            real[k] = w * f;
            dual[k] = w * slope * c_dual;
        }
    }

    template <bool U>
    void blend_again(const float* table) {
        Dual s;
        VT_UNROLL for (int k = 0; k < n; ++k) {
            const Dual q = influence<U>(table, k);
            for (int c = 0; c < 4; ++c) s.v[c] = k ? s.v[c] + real[k] * q.v[c] : real[k] * q.v[c];
            for (int c = 0; c < 4; ++c) {
                const f8 term = k ? s.v[4 + c] + real[k] * q.v[4 + c] : real[k] * q.v[4 + c];
                s.v[4 + c] = term + dual[k] * q.v[c];
            }
        }
        b = s;
    }

    // A <- A exp(.), see above.
    void advance() {
        const f8 s = dot(a.v, b.v), s_dual = dot(a.v, b.v + 4) + dot(a.v + 4, b.v);
        const f8 length = dot(b.v, b.v) - s * s, length_dual = 2.0f * (dot(b.v, b.v + 4) - s * s_dual);
        f8 cosine, sine, slope;
        cosine_sine(length, cosine, sine, slope);
        const f8 sine_dual = slope * length_dual;
        const f8 keep = cosine - sine * s;
        const f8 keep_dual = -0.5f * sine * length_dual - sine_dual * s - sine * s_dual;
        for (int c = 0; c < 4; ++c) {
            const f8 was = a.v[c];
            a.v[c] = keep * was + sine * b.v[c];
            a.v[4 + c] = (keep * a.v[4 + c] + keep_dual * was) + (sine * b.v[4 + c] + sine_dual * b.v[c]);
        }
    }
};

// Quaternion product.
inline void times(const f8* a, const f8* b, f8* out) {
    out[0] = a[3] * b[0] + a[0] * b[3] + a[1] * b[2] - a[2] * b[1];
    out[1] = a[3] * b[1] - a[0] * b[2] + a[1] * b[3] + a[2] * b[0];
    out[2] = a[3] * b[2] + a[0] * b[1] - a[1] * b[0] + a[2] * b[3];
    out[3] = a[3] * b[3] - a[0] * b[0] - a[1] * b[1] - a[2] * b[2];
}

// exp of the blended half twists (x y z 0, then the dual part), after the motion of the base joint.
template <int K, bool U>
inline Dual blend_twists(const float* table, const int32_t* index, const float* weight, int n, const float* bases,
                         const int32_t* base) {
    const Dual h = sum_rows<K, U>(table, index, weight, n);
    const f8 *v = h.v, *d = h.v + 4;
    const f8 length = v[0] * v[0] + v[1] * v[1] + v[2] * v[2];
    const f8 length_dual = 2.0f * (v[0] * d[0] + v[1] * d[1] + v[2] * d[2]);
    f8 cosine, sine, slope;
    cosine_sine(length, cosine, sine, slope);
    Dual e;
    for (int c = 0; c < 3; ++c) {
        e.v[c] = sine * v[c];
        e.v[4 + c] = sine * d[c] + slope * length_dual * v[c];
    }
    e.v[3] = cosine;
    e.v[7] = -0.5f * sine * length_dual;
    if (!bases) return e;
    const Dual b = gather<U>(bases, base);
    Dual out;
    f8 other[4];
    times(b.v, e.v, out.v);
    times(b.v, e.v + 4, out.v + 4);
    times(b.v + 4, e.v, other);
    for (int c = 0; c < 4; ++c) out.v[4 + c] += other[c];
    return out;
}

inline void write(const Bucket& bucket, int64_t place, int64_t last, const f8 moved[3], const float* mix, float* out) {
    const int64_t count = last - place < 8 ? last - place : 8;
    float v[3][8];
    if (mix) {
        for (int c = 0; c < 3; ++c) store8(v[c], moved[c]);
        for (int64_t l = 0; l < count; ++l) {
            const int64_t t = bucket.target ? bucket.target[place + l] : place + l;
            if (l && bucket.target && t == bucket.target[place + l - 1]) continue;  // padding
            for (int c = 0; c < 3; ++c) out[3 * t + c] += mix[t] * (v[c][l] - out[3 * t + c]);
        }
        return;
    }
    float xy[8][2];
    interleave(moved[0], moved[1], xy[0]);
    store8(v[2], moved[2]);
    for (int64_t l = 0; l < count; ++l) {
        float* o = out + 3 * (bucket.target ? bucket.target[place + l] : place + l);
        memcpy(o, xy[l], 8);
        o[2] = v[2][l];
    }
}

// p' = p + 2 (u x (u x p + w p + e_v) + w e_v - e_w u), u and w the vector and scalar of the real part, e the dual part;
// for any length of the real part, and whatever multiple of it the dual part contains.
VT_INLINE void move(const Dual& a, const float* rest, f8 out[3]) {
    const f8 *u = a.v, w = a.v[3], *e = a.v + 4, ew = a.v[7], two = 2.0f / dot(a.v, a.v);
    const f8 p[3] = {load8(rest), load8(rest + 8), load8(rest + 16)};
    f8 c[3];
    for (int i = 0; i < 3; ++i) {
        const int j = i == 2 ? 0 : i + 1, k = i == 0 ? 2 : i - 1;
        c[i] = u[j] * p[k] - u[k] * p[j] + w * p[i] + e[i];
    }
    for (int i = 0; i < 3; ++i) {
        const int j = i == 2 ? 0 : i + 1, k = i == 0 ? 2 : i - 1;
        out[i] = p[i] + two * (u[j] * c[k] - u[k] * c[j] + w * e[i] - ew * u[i]);
    }
}

inline void write_frames(const Bucket& bucket, int64_t place, int64_t last, const Dual& a, float* out) {
    const f8 x = a.v[0], y = a.v[1], z = a.v[2], w = a.v[3], ex = a.v[4], ey = a.v[5], ez = a.v[6], ew = a.v[7];
    const f8 two = 2.0f / dot(a.v, a.v);
    const f8 m[12] = {1.0f - two * (y * y + z * z), two * (x * y - z * w), two * (x * z + y * w),
                      two * (w * ex - ew * x + y * ez - z * ey),
                      two * (x * y + z * w), 1.0f - two * (x * x + z * z), two * (y * z - x * w),
                      two * (w * ey - ew * y + z * ex - x * ez),
                      two * (x * z - y * w), two * (y * z + x * w), 1.0f - two * (x * x + y * y),
                      two * (w * ez - ew * z + x * ey - y * ex)};
    float v[12][8];
    for (int c = 0; c < 12; ++c) store8(v[c], m[c]);
    for (int64_t l = 0; l < 8 && place + l < last; ++l) {
        float* o = out + 12 * (bucket.target ? bucket.target[place + l] : place + l);
        for (int c = 0; c < 12; ++c) o[c] = v[c][l];
    }
}

// Whether nothing of this group is wanted.
inline bool unwanted(const Bucket& bucket, int64_t place, int64_t last, const float* mix) {
    for (int64_t l = 0; l < 8 && place + l < last; ++l)
        if (mix[bucket.target ? bucket.target[place + l] : place + l] != 0.0f) return false;
    return true;
}

inline void finish(const Bucket& bucket, const RigidJob& job, int64_t f, int64_t place, int64_t last, const Dual& a) {
    float* out = job.out + f * job.vertices * (job.whole ? 12 : 3);
    if (job.whole) return write_frames(bucket, place, last, a, out);
    f8 moved[3];
    move(a, bucket.rest + place * 3, moved);
    write(bucket, place, last, moved, job.mix ? job.mix + f * job.vertices : nullptr, out);
}

// Up to kBatch groups, whose first vertices are `place`, in frame f.
template <int K>
void blend_batch(const Bucket& bucket, const RigidJob& job, int64_t f, const int64_t* place, int groups, int64_t last) {
    const float* table = job.table + f * job.rows * 8;
    const bool flip = job.agree && !job.agree[f];
    const int steps = K == 1 ? 0 : job.steps;
    Work<K> work[kBatch];
    for (int g = 0; g < groups; ++g) {
        Work<K>& w = work[g];
        w.joint = bucket.joint + place[g] * K;
        w.weight = bucket.weight + place[g] * K;
        w.uniform = bucket.uniform[place[g] / 8];
        if (w.uniform)
            w.template blend<true>(table, flip, steps > 0);
        else
            w.template blend<false>(table, flip, steps > 0);
    }
    for (int g = 0; g < groups; ++g) mend(work[g].a, table, work[g].joint, work[g].weight, K);
    for (int step = 0; step < steps; ++step) {
        for (int g = 0; g < groups; ++g) {
            if (step == 0) {
                normalise(work[g].a);
                perpendicular(work[g].a);
            }
            if (work[g].uniform)
                work[g].template compare<true>(table, flip);
            else
                work[g].template compare<false>(table, flip);
        }
        for (int g = 0; g < groups; ++g) {
            if (work[g].uniform)
                work[g].template blend_again<true>(table);
            else
                work[g].template blend_again<false>(table);
            work[g].advance();
        }
    }
    for (int g = 0; g < groups; ++g) finish(bucket, job, f, place[g], last, work[g].a);
}

// One group, if a short way to its motion is open.
template <int K>
VT_INLINE bool blend_one(const Bucket& bucket, const RigidJob& job, int64_t f, int64_t place, int64_t last, Near<K>& near) {
    const float* table = job.table + f * job.rows * 8;
    const int32_t* joint = bucket.joint + place * K;
    const float* weight = bucket.weight + place * K;
    Dual a;
    if constexpr (K == 1) {
        a = gather<false>(table, joint);
    } else {
        if (!bucket.uniform[place / 8] || (job.agree && !job.agree[f])) return false;
        if (job.steps == 0) {
            a = sum_rows<K, true>(table, joint, weight, K);
            mend(a, table, joint, weight, K);
        } else {
            if (job.steps > 1 || K > 8) return false;
            near.learn(table, joint);
            if (!near.blend(table, weight, a)) return false;
        }
    }
    finish(bucket, job, f, place, last, a);
    return true;
}

template <int K>
void twist_batch(const Bucket& bucket, const RigidJob& job, int64_t f, const int64_t* place, int groups, int64_t last) {
    const int n = bucket.influences;
    const float* table = job.table + f * job.rows * 8;
    const float* bases = job.bases ? job.bases + f * job.base_rows * 8 : nullptr;
    for (int g = 0; g < groups; ++g) {
        const int32_t* joint = bucket.joint + place[g] * n;
        const float* weight = bucket.weight + place[g] * n;
        const int32_t* base = job.base + place[g];
        finish(bucket, job, f, place[g], last,
               bucket.uniform[place[g] / 8] ? blend_twists<K, true>(table, joint, weight, n, bases, base)
                                            : blend_twists<K, false>(table, joint, weight, n, bases, base));
    }
}

template <int K>
void run(const Bucket& bucket, int64_t first, int64_t last, const RigidJob& job) {
    for (int64_t f = 0; f < job.frames; ++f) {
        const float* mix = job.mix ? job.mix + f * job.vertices : nullptr;
        int64_t place[kBatch];
        Near<K <= 8 ? K : 1> near;
        int groups = 0;
        const auto finish_batch = [&] {
            if (job.twists)
                twist_batch<K>(bucket, job, f, place, groups, last);
            else
                blend_batch<K>(bucket, job, f, place, groups, last);
            groups = 0;
        };
        for (int64_t p = first; p < last; p += 8) {
            if (mix && unwanted(bucket, p, last, mix)) continue;
            if constexpr (K <= 8)
                if (!job.twists && blend_one<K>(bucket, job, f, p, last, near)) continue;
            place[groups++] = p;
            if (groups == kBatch) finish_batch();
        }
        if (groups) finish_batch();
    }
}

}  // namespace

// Vertices [first, last) of a bucket in lane layout; `first` is a multiple of 8.
void rigid(const Bucket& bucket, int64_t first, int64_t last, const RigidJob& job) {
    switch (bucket.influences) {
        case 1: return run<1>(bucket, first, last, job);
        case 2: return run<2>(bucket, first, last, job);
        case 4: return run<4>(bucket, first, last, job);
        case 8: return run<8>(bucket, first, last, job);
        case 16: return run<16>(bucket, first, last, job);
        case 64: return run<64>(bucket, first, last, job);
        default: return;  // lane_buckets makes no others, the binding checks it
    }
}

}  // namespace vt::VT_NS
