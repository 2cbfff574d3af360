// Cloth that does not have to be simulated: bound to the skin, or hanging about limbs. See vitruvian.cloth.worn.
#include "foot.h"
#include "kernels.h"
#include "lanes.h"

namespace vt::VT_NS {

namespace {

struct Vector {
    float x, y, z;
};
inline Vector at(const float* p) { return {p[0], p[1], p[2]}; }
inline Vector operator+(Vector a, Vector b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
inline Vector operator-(Vector a, Vector b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
inline Vector operator*(float s, Vector a) { return {s * a.x, s * a.y, s * a.z}; }
inline float dot(Vector a, Vector b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
inline Vector cross(Vector a, Vector b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }
inline Vector unit(Vector a) {
    const float size = sqrtf(dot(a, a));
    return size > 1e-20f ? (1 / size) * a : Vector{0, 0, 0};
}
inline void put(float* p, Vector a) {
    p[0] = a.x;
    p[1] = a.y;
    p[2] = a.z;
}

// r brought into the half-ball about its foot: at least `least` along n, at most `reach` long.
inline Vector within(Vector r, Vector n, float least, float reach, bool& touched) {
    float up = dot(r, n);
    touched = up < least;
    if (touched) r = r + (least - up) * n;
    const float size = dot(r, r);
    if (size <= reach * reach) return r;
    r = (reach / sqrtf(size)) * r;
    up = dot(r, n);
    if (up >= least) return r;
    const Vector flat = r - up * n;
    const float wide = sqrtf(dot(flat, flat)), room = sqrtf(fmaxf(reach * reach - least * least, 0.0f));
    return least * n + (wide > room ? room / wide : 1.0f) * flat;
}

}  // namespace

void cloth_feet(const ClothFeet& feet, int64_t first, int64_t last) {
    for (int64_t i = first; i < last; ++i) {
        const int32_t* c = feet.corner + 3 * i;
        const float* w = feet.share + 3 * i;
        const float* o = feet.offset + 3 * i;
        const Vector a = at(feet.point + 3 * int64_t(c[0])), b = at(feet.point + 3 * int64_t(c[1]));
        const Vector s = w[0] * a + w[1] * b + w[2] * at(feet.point + 3 * int64_t(c[2]));
        const Vector n = unit(w[0] * at(feet.normal + 3 * int64_t(c[0])) + w[1] * at(feet.normal + 3 * int64_t(c[1])) +
                              w[2] * at(feet.normal + 3 * int64_t(c[2])));
        const Vector edge = b - a, t = unit(edge - dot(edge, n) * n);
        put(feet.foot + 3 * i, s);
        put(feet.up + 3 * i, n);
        put(feet.out + 3 * i, s + o[0] * t + o[1] * cross(n, t) + o[2] * n);
    }
}

void cloth_limbs(const ClothLimbs& job) {
    const float h = job.step, keep = expf(-job.damping * h);
    const Vector g = at(job.gravity), air = at(job.wind);
    const float pull = sqrtf(dot(g, g));
    const Vector down = pull > 1e-9f ? (1 / pull) * g : Vector{0, 0, 0};
    for (int64_t k = 0; k < job.count; ++k) {
        const int64_t i = job.vertex[k];
        const Vector s = at(job.foot + 3 * i), n = at(job.up + 3 * i), axis = at(job.axis + 3 * int64_t(job.bone[k]));
        const Vector sdot = (1 / h) * (s - at(job.foot_before + 3 * i));
        const Vector r = at(job.r + 3 * k);
        // how far cloth that hangs about the limb as a wider ring can be from the skin here
        const float within_limb = job.radius[k], room = job.room[k], wide = within_limb + room, least = job.least[k];
        const Vector across = down - dot(down, axis) * axis;
        const float m = sqrtf(dot(across, across));
        float reach = room;
        if (m > 1e-6f) {
            const float cosine = fminf(fmaxf(dot(n, across) / m, -1.0f), 1.0f);
            const float gap = room * cosine + sqrtf(fmaxf(wide * wide - room * room * (1 - cosine * cosine), 0.0f)) - within_limb;
            reach = m * gap + (1 - m) * room;
        }
        reach = fmaxf(reach, least);
        Vector v = sdot + keep * (at(job.v + 3 * k) - sdot) + h * g;
        if (job.density > 0) {
            const float meet = dot(air - v, n);
            v = v + (fminf(job.drag * fabsf(meet) * h / job.density, 1.0f) * meet) * n;
        }
        bool touched;
        Vector to = within(r + h * (v - sdot), n, least, reach, touched);
        Vector slide = (1 / h) * (to - r);
        if (touched) {
            const float along = dot(slide, n);
            slide = along * n + (1 - job.friction) * (slide - along * n);
        }
        put(job.next + 3 * k, to);
        put(job.v + 3 * k, sdot + slide);
        job.reach[k] = reach;
    }
    // neighbours fold together
    for (int64_t k = 0; k < job.count; ++k) {
        const int32_t start = job.row[k], stop = job.row[k + 1];
        const Vector n = at(job.up + 3 * int64_t(job.vertex[k]));
        Vector to = at(job.next + 3 * k);
        if (stop > start) {
            Vector sum{0, 0, 0};
            for (int32_t j = start; j < stop; ++j) sum = sum + at(job.next + 3 * int64_t(job.neighbour[j]));
            to = (1 - job.smooth) * to + (job.smooth / float(stop - start)) * sum;
        }
        bool touched;
        put(job.r + 3 * k, within(to, n, job.least[k], job.reach[k], touched));
    }
}

namespace {

constexpr float OUT = 0.005f, RISING = 0.3f;  // metres over the plane of a triangle, and for each metre from it
constexpr float ALIKE = 0.7f;                 // product of normals of skin that cannot pinch what is between

// Whether x is so far over the plane in a corner of a triangle that what is nearest need not be looked for.
inline bool well_out(const ClothBody& body, int32_t triangle, const Vector& x) {
    const float* corner = body.after + 6 * int64_t(body.triangle[3 * int64_t(triangle)]);
    const Vector way = x - at(corner);
    const float high = dot(way, at(corner + 3)) - OUT;
    return high > 0 && high * high > RISING * RISING * dot(way, way);
}

}  // namespace

// Puts vertices that are nearer to the body, as it is at the frame's end, than they may be straight away from it.
void cloth_clear(const ClothBody& body, int64_t count, const int32_t* vertex, float deep, float* x) {
    for (int64_t i = 0; i < count; ++i) {
        if (body.nearest[i] < 0) continue;
        float* at = x + 3 * int64_t(vertex[i]);
        if (well_out(body, body.nearest[i], {at[0], at[1], at[2]})) continue;
        Foot foot;
        walk(body, at, body.nearest[i], 1.0f, foot);
        float normal[3] = {0, 0, 0}, size = 0, out = 0;
        for (int k = 0; k < 3; ++k) {
            const float* v = body.after + 6 * int64_t(body.triangle[3 * int64_t(foot.triangle) + k]) + 3;
            for (int j = 0; j < 3; ++j) normal[j] += foot.share[k] * v[j];
        }
        for (int j = 0; j < 3; ++j) size += normal[j] * normal[j];
        size = sqrtf(size);
        if (size < 1e-9f) continue;
        for (int j = 0; j < 3; ++j) normal[j] /= size, out += (at[j] - foot.now[j]) * normal[j];
        const float apart = sqrtf(foot.squared), away = out < 0 ? -apart : apart;
        if (away >= body.offset || away < -deep) continue;
        if (apart > 1e-5f)
            for (int j = 0; j < 3; ++j) normal[j] = (at[j] - foot.now[j]) / away;
        const float share = 1.5f * (1 + away / deep);  // less and less from a third of the depth on, so that nothing jumps
        for (int j = 0; j < 3; ++j) at[j] += (share < 1 ? share : 1) * (foot.now[j] + body.offset * normal[j] - at[j]);
    }
}

namespace {

// How far x is out of the body, by what is nearest to it; goes on from triangle `near` and leaves there which that is.
// Beyond where a part of the body ends it is out of it.
inline float out_of(const ClothBody& body, const Vector& x, int32_t& near, Foot& foot, Vector& m) {
    walk(body, &x.x, near, 1.0f, foot);
    near = foot.triangle;
    m = {0, 0, 0};
    for (int k = 0; k < 3; ++k) {
        const int32_t across = body.neighbour[3 * int64_t(near) + k];
        if (across < 0 && foot.share[(k + 2) % 3] <= 0) return body.offset;
        m = m + foot.share[k] * at(body.after + 6 * int64_t(body.triangle[3 * int64_t(near) + k]) + 3);
    }
    m = unit(m);
    return dot(x - at(foot.now), m);
}

}  // namespace

// Draws vertices that other skin has closed in on towards their feet, until they are out of it: between both where there is
// less room than that. They come back from there bit by bit.
void cloth_pinch(const ClothBody& body, const ClothPinch& job) {
    for (int64_t i = 0; i < job.count;) {
        const int64_t v = job.vertex[i];
        const Vector foot = at(job.foot + 3 * v), whole = at(job.x + 3 * v) - foot;
        float part = fminf(job.part[v] + job.back, 1.0f);
        for (; i < job.count && job.vertex[i] == v; ++i) {
            if (body.nearest[i] < 0) continue;
            const Vector way = part * whole, here = foot + way;
            int32_t near = body.nearest[i];
            const float* normal = body.after + 6 * int64_t(body.triangle[3 * int64_t(near)]) + 3;
            if (dot(at(normal), at(job.up + 3 * v)) > ALIKE || well_out(body, near, here)) continue;
            Foot other;
            Vector m;
            int edge = -1;
            if (measure(body, &here.x, near, 1.0f, other, edge) > job.far * job.far) continue;
            float now = out_of(body, here, near, other, m), share = 1;
            if (now >= body.offset) continue;
            if (now < 0) {
                float low = 0;
                for (int pass = 0; pass < 5; ++pass) {
                    const float half = 0.5f * (low + share);
                    now = out_of(body, foot + half * way, near, other, m);
                    (now < 0 ? share : low) = half;
                }
                share = low;
                now = out_of(body, foot + share * way, near, other, m);
            }
            const float high = dot(foot - at(other.now), m), least = high < 2 * body.offset ? 0.5f * high : body.offset;
            if (high > now && now < least) share *= high > 0 ? fmaxf(high - least, 0.0f) / (high - now) : 0;
            part *= share;
        }
        job.part[v] = part;
        if (part < 1) put(job.x + 3 * v, foot + part * whole);
    }
}

}  // namespace vt::VT_NS
