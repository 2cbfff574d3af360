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
#include "matrices.h"
#include "near.h"

namespace vt::VT_NS {

namespace {

// Where the real part has no length, the motion of the joint with the largest weight.
template <bool U>
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
        for (int c = 0; c < 8; ++c) v[c][l] = table[(U ? joint[best] : joint[best * 8 + l]) + c];
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
template <bool U>
inline void choose_signs(const float* table, const int32_t* joint, const float* weight, int n, f8* sign) {
    const int step = U ? 1 : 8;
    Dual best = gather<U>(table, joint);
    f8 most = load8(weight);
    for (int k = 1; k < n; ++k) {
        const f8 w = load8(weight + k * 8), less = most - w;
        const Dual q = gather<U>(table, joint + k * step);
        for (int c = 0; c < 4; ++c) best.v[c] = where_negative(less, q.v[c], best.v[c]);
        most = where_negative(less, w, most);
    }
    for (int k = 0; k < n; ++k)
        sign[k] = where_negative(dot(gather<U>(table, joint + k * step).v, best.v), all(-1.0f), all(1.0f));
}

const int kBatch = 4;  // groups that go through each phase before the next one: their chains of arithmetic overlap

// What is worked out about one group of eight vertices. Phases are short so that everything stays in registers.
template <int K, bool U>
struct Work {
    const int32_t* joint;
    const float* weight;
    static constexpr int n = K;
    Dual a, b;
    f8 real[K], dual[K];  // weights of the second blend: w f and w f' c'
    f8 sign[K];
    Dual kept[U ? 1 : K]; // gathered influences; those of shared joints are read from the table again

    Dual influence(const float* table, int k) const {
        return U ? gather<true>(table, joint + k) : kept[U ? 0 : k];
    }

    // The sum of weight times dual quaternion.
    void blend(const float* table, bool flip, bool keep) {
        if (flip) choose_signs<U>(table, joint, weight, n, sign);
        if (!U && keep)
            for (int k = 0; k < n; ++k) kept[U ? 0 : k] = gather<false>(table, joint + k * 8);
        if (!flip && (U || !keep)) {
            a = sum_rows<K, U>(table, joint, weight, n);
            return;
        }
        for (int k = 0; k < n; ++k) {
            const Dual q = U || keep ? influence(table, k) : gather<false>(table, joint + k * 8);
            const f8 w = flip ? load8(weight + k * 8) * sign[k] : load8(weight + k * 8);
            for (int c = 0; c < 8; ++c) a.v[c] = k ? a.v[c] + w * q.v[c] : w * q.v[c];
        }
    }

    // Weights of the second blend.
    void compare(const float* table, bool flip) {
        VT_UNROLL for (int k = 0; k < n; ++k) {
            const Dual q = influence(table, k);
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

    void blend_again(const float* table) {
        Dual s;
        VT_UNROLL for (int k = 0; k < n; ++k) {
            const Dual q = influence(table, k);
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

// p' = p + 2 (u x (u x p + w p + e_v) + w e_v - e_w u), u and w the vector and scalar of the real part, e the dual part;
// for any length of the real part, and whatever multiple of it the dual part contains.
VT_INLINE void move(const Dual& a, const f8 p[3], f8 out[3]) {
    const f8 *u = a.v, w = a.v[3], *e = a.v + 4, ew = a.v[7], two = 2.0f / dot(a.v, a.v);
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

inline void frame(const Dual& a, f8 m[12]) {
    const f8 x = a.v[0], y = a.v[1], z = a.v[2], w = a.v[3], ex = a.v[4], ey = a.v[5], ez = a.v[6], ew = a.v[7];
    const f8 two = 2.0f / dot(a.v, a.v);
    const f8 rows[12] = {1.0f - two * (y * y + z * z), two * (x * y - z * w), two * (x * z + y * w),
                         two * (w * ex - ew * x + y * ez - z * ey),
                         two * (x * y + z * w), 1.0f - two * (x * x + z * z), two * (y * z - x * w),
                         two * (w * ey - ew * y + z * ex - x * ez),
                         two * (x * z - y * w), two * (y * z + x * w), 1.0f - two * (x * x + y * y),
                         two * (w * ez - ew * z + x * ey - y * ex)};
    for (int c = 0; c < 12; ++c) m[c] = rows[c];
}

// How much of the rigid motion each of eight vertices gets.
VT_INLINE f8 shares(const LinearShare& s, int64_t f, int64_t place) {
    const float* share = s.share + f * s.share_stride;
    float v[8];
    for (int l = 0; l < 8; ++l) v[l] = share[s.set[place + l]];
    return load8(v);
}

// Stores one group, given its blended motion.
template <int K, bool U>
inline void finish(const Bucket& bucket, const RigidJob& job, int64_t f, int64_t place, int64_t last, const Dual& a) {
    float* out = job.out + f * job.vertices * (job.whole ? 12 : 3);
    const LinearShare& s = job.linear;
    const float* table = s.table ? s.table + f * job.joints * 16 : nullptr;
    const int32_t* joint = bucket.joint + (U ? place / 8 : place) * K;
    const float* weight = bucket.weight + place * K;
    const float* rest = bucket.rest + place * 3;
    f8 p[3] = {load8(rest), load8(rest + 8), load8(rest + 16)};
    if (job.whole) {
        f8 m[12];
        frame(a, m);
        if (table && s.share) {
            const f8 t = shares(s, f, place);
            f8 other[12];
            blend_matrices<K, U>(table, joint, weight, other);
            for (int c = 0; c < 12; ++c) m[c] = other[c] + t * (m[c] - other[c]);
        }
        return write_frames(bucket.target, place, last, m, out);
    }
    f8 moved[3];
    if (table && s.center) {
        const float* c = s.center + place * 3;
        f8 center[3] = {load8(c), load8(c + 8), load8(c + 16)}, carried[3];
        for (int i = 0; i < 3; ++i) p[i] = p[i] - center[i];
        Dual turn = a;
        for (int i = 4; i < 8; ++i) turn.v[i] = all(0.0f);
        move(turn, p, moved);
        blend_points<K, U>(table, joint, s.carry + place * K, center, carried);
        for (int i = 0; i < 3; ++i) moved[i] = moved[i] + carried[i];
        if (s.share) {
            const f8 t = shares(s, f, place);
            if (any_below(t, 1.0f)) {
                f8 other[3];
                for (int i = 0; i < 3; ++i) p[i] = p[i] + center[i];
                move(a, p, other);
                for (int i = 0; i < 3; ++i) moved[i] = other[i] + t * (moved[i] - other[i]);
            }
        }
        return write_points(bucket.target, place, last, moved, out);
    }
    move(a, p, moved);
    if (table && s.share) {
        const f8 t = shares(s, f, place);
        if (any_below(t, 1.0f)) {
            f8 other[3];
            blend_points<K, U>(table, joint, weight, p, other);
            for (int i = 0; i < 3; ++i) moved[i] = other[i] + t * (moved[i] - other[i]);
        }
    }
    write_points(bucket.target, place, last, moved, out);
}

enum class Way { linear, rigid, mixed };

// How eight vertices move: without shares, and where all of them are one, rigidly.
VT_INLINE Way way_of(const LinearShare& s, int64_t f, int64_t place) {
    if (s.center) return Way::mixed;
    if (!s.share) return Way::rigid;
    const float* share = s.share + f * s.share_stride;
    const int32_t* set = s.set + place;
    int32_t others = 0;
    for (int l = 1; l < 8; ++l) others |= set[l] ^ set[0];
    const float one = share[set[0]];
    bool same = true;
    for (int l = 1; others && l < 8; ++l) same = same && share[set[l]] == one;
    return !same ? Way::mixed : one == 0.0f ? Way::linear : one == 1.0f ? Way::rigid : Way::mixed;
}

// Stores one group by linear blending.
template <int K, bool U>
VT_INLINE void blend_linear(const Bucket& bucket, const RigidJob& job, int64_t f, int64_t place, int64_t last) {
    const float* table = job.linear.table + f * job.joints * 16;
    const int32_t* joint = bucket.joint + (U ? place / 8 : place) * K;
    float* out = job.out + f * job.vertices * (job.whole ? 12 : 3);
    if (job.whole) {
        f8 m[12];
        blend_matrices<K, U>(table, joint, bucket.weight + place * K, m);
        return write_frames(bucket.target, place, last, m, out);
    }
    const float* rest = bucket.rest + place * 3;
    const f8 p[3] = {load8(rest), load8(rest + 8), load8(rest + 16)};
    f8 moved[3];
    blend_points<K, U>(table, joint, bucket.weight + place * K, p, moved);
    write_points(bucket.target, place, last, moved, out);
}

// Up to kBatch groups, whose first vertices are `place`, in frame f.
template <int K, bool U>
void blend_batch(const Bucket& bucket, const RigidJob& job, int64_t f, const int64_t* place, int groups, int64_t last) {
    const float* table = job.table + f * job.rows * 8;
    const bool flip = job.agree && !job.agree[f];
    const int steps = K == 1 ? 0 : job.steps;
    Work<K, U> work[kBatch];
    for (int g = 0; g < groups; ++g) {
        Work<K, U>& w = work[g];
        w.joint = bucket.joint + (U ? place[g] / 8 : place[g]) * K;
        w.weight = bucket.weight + place[g] * K;
        w.blend(table, flip, steps > 0);
    }
    for (int g = 0; g < groups; ++g) mend<U>(work[g].a, table, work[g].joint, work[g].weight, K);
    for (int step = 0; step < steps; ++step) {
        for (int g = 0; g < groups; ++g) {
            if (step == 0) {
                normalise(work[g].a);
                perpendicular(work[g].a);
            }
            work[g].compare(table, flip);
        }
        for (int g = 0; g < groups; ++g) {
            work[g].blend_again(table);
            work[g].advance();
        }
    }
    for (int g = 0; g < groups; ++g) finish<K, U>(bucket, job, f, place[g], last, work[g].a);
}

const int kRow = 16;  // groups that a short way takes through each of its phases before the next one

// Up to kRow groups in frame f; with `near`, which knows their joints, those that are near by the short way.
template <int K, bool U>
void blend_row(const Bucket& bucket, const RigidJob& job, int64_t f, const int64_t* place, int groups, int64_t last,
               const Near<K <= 8 ? K : 1>* near) {
    const float* table = job.table + f * job.rows * 8;
    Dual a[kRow];
    int64_t some[kRow], far[kRow];
    int n = 0, fars = 0;
    if constexpr (U && K > 1 && K <= 8) {
        alignas(32) float real[kRow][K * 8], dual[kRow][K * 8];
        for (int g = 0; near && g < groups; ++g) {
            if (near->weigh(bucket.weight + place[g] * K, real[n], dual[n]))
                some[n++] = place[g];
            else
                far[fars++] = place[g];
        }
        for (int g = 0; g < n; ++g) near->blend(table, real[g], dual[g], a[g].v);
    }
    if (!near) {
        const bool flip = job.agree && !job.agree[f];
        for (int g = 0; g < groups; ++g) {
            const int32_t* joint = bucket.joint + (U ? place[g] / 8 : place[g]) * K;
            if (K == 1) {
                a[n] = gather<U>(table, joint);
            } else if (job.steps == 0 && !flip) {
                const float* weight = bucket.weight + place[g] * K;
                a[n] = sum_rows<K, U>(table, joint, weight, K);
                mend<U>(a[n], table, joint, weight, K);
            } else {
                far[fars++] = place[g];
                continue;
            }
            some[n++] = place[g];
        }
    }
    const LinearShare& s = job.linear;
    if (job.whole || (s.table && (s.center || s.share))) {
        for (int g = 0; g < n; ++g) finish<K, U>(bucket, job, f, some[g], last, a[g]);
    } else {
        float* out = job.out + f * job.vertices * 3;
        for (int g = 0; g < n; ++g) {
            const float* rest = bucket.rest + some[g] * 3;
            const f8 p[3] = {load8(rest), load8(rest + 8), load8(rest + 16)};
            f8 moved[3];
            move(a[g], p, moved);
            write_points(bucket.target, some[g], last, moved, out);
        }
    }
    for (int g = 0; g < fars; g += kBatch)
        blend_batch<K, U>(bucket, job, f, far + g, fars - g < kBatch ? fars - g : kBatch, last);
}

template <int K, bool U>
void run(const Bucket& bucket, int64_t first, int64_t last, const RigidJob& job) {
    RigidJob plain = job;
    plain.linear = LinearShare();
    for (int64_t f = 0; f < job.frames; ++f) {
        const float* table = job.table + f * job.rows * 8;
        if (job.twists) {
            const float* bases = job.bases ? job.bases + f * job.base_rows * 8 : nullptr;
            for (int64_t p = first; p < last; p += 8)
                finish<K, U>(bucket, job, f, p, last,
                             blend_twists<K, U>(table, bucket.joint + (U ? p / 8 : p) * K, bucket.weight + p * K, K,
                                                bases, job.base + p));
            continue;
        }
        const bool closes = U && K > 1 && K <= 8 && job.steps == 1 && !(job.agree && !job.agree[f]);
        Near<K <= 8 ? K : 1> near;
        int64_t place[kRow];
        int groups = 0;
        Way way = Way::rigid;  // of the groups that wait
        const auto settle = [&] {
            blend_row<K, U>(bucket, way == Way::rigid ? plain : job, f, place, groups, last, closes ? &near : nullptr);
            groups = 0;
        };
        for (int64_t p = first; p < last; p += 8) {
            const Way mine = way_of(job.linear, f, p);
            if (mine == Way::linear) {
                blend_linear<K, U>(bucket, job, f, p, last);
                continue;
            }
            const int32_t* joint = bucket.joint + p / 8 * K;
            if (groups == kRow || (groups && (mine != way || (closes && !near.knows(joint))))) settle();
            way = mine;
            if (closes && !groups) near.learn(table, joint);
            place[groups++] = p;
        }
        if (groups) settle();
    }
}

template <int K>
void run(const Bucket& bucket, int64_t first, int64_t last, const RigidJob& job) {
    bucket.shared ? run<K, true>(bucket, first, last, job) : run<K, false>(bucket, first, last, job);
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
