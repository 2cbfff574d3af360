// Small-step XPBD (Macklin et al. 2019, "Small steps in physics simulation"): one pass over all constraints in each of
// many substeps, which begins with half of what the multipliers were.
#include "cloth.h"

#include "constraints.h"
#include "foot.h"
#include "kernels.h"

namespace vt::VT_NS {

namespace {

void sew(const ClothFrame& f, float share, float over) {
    for (int64_t k = 0; k < f.pairs; ++k) {
        float *a = f.x + 4 * int64_t(f.pair[2 * k]), *b = f.x + 4 * int64_t(f.pair[2 * k + 1]);
        const float* r = f.pair_rest + 3 * k;
        const float way[3] = {b[0] - a[0], b[1] - a[1], b[2] - a[2]};
        const float apart = sqrtf(way[0] * way[0] + way[1] * way[1] + way[2] * way[2]);
        const float both = a[3] + b[3] + r[2] * over, far = apart - (r[0] + share * (r[1] - r[0]));
        if (!(both > 0) || far <= 0 || apart < 1e-9f) continue;  // thread pulls, it does not push
        for (int j = 0; j < 3; ++j) {
            const float move = far / (apart * both) * way[j];
            a[j] += a[3] * move, b[j] -= b[3] * move;
        }
    }
}

// The plane of the triangle that a foot lies inside, and the metres from there to its rim: as long as nothing moves farther,
// that is the body for this vertex.
float level(const ClothBody& body, const Foot& foot, float s, float plane[4]) {
    float p[3][3], ab[3], ac[3], n[3], bc = 0, ca = 0, c = 0, least = 0;
    corners(body, foot.triangle, s, p);
    for (int j = 0; j < 3; ++j) ab[j] = p[1][j] - p[0][j], ac[j] = p[2][j] - p[0][j];
    n[0] = ab[1] * ac[2] - ab[2] * ac[1], n[1] = ab[2] * ac[0] - ab[0] * ac[2], n[2] = ab[0] * ac[1] - ab[1] * ac[0];
    const float size = sqrtf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    if (size < 1e-12f) return 0;
    plane[3] = 0;
    for (int j = 0; j < 3; ++j) {
        plane[j] = n[j] / size, plane[3] += plane[j] * p[0][j];
        bc += (ac[j] - ab[j]) * (ac[j] - ab[j]), ca += ac[j] * ac[j], c += ab[j] * ab[j];
    }
    const float far[3] = {foot.share[0] / sqrtf(bc), foot.share[1] / sqrtf(ca), foot.share[2] / sqrtf(c)};
    least = far[0] < far[1] ? far[0] : far[1];
    return (least < far[2] ? least : far[2]) * size;
}

// Vertices out of the body, after everything else: the body wins. Friction as in note cloth.md, 4.5.
void push(const ClothFrame& f, const ClothBody& body, int64_t n, float s0, float s1, float reach) {
    for (int64_t i = 0; i < n; ++i) {
        float *x = f.x + 4 * i, *p = f.p + 4 * i;
        if (!(x[3] > 0) || body.nearest[i] < 0) continue;
        const float moved = sqrtf((x[0] - p[0]) * (x[0] - p[0]) + (x[1] - p[1]) * (x[1] - p[1]) + (x[2] - p[2]) * (x[2] - p[2]));
        f.slack[i] -= moved + reach, f.room[i] -= moved;
        if (f.slack[i] > 0) continue;
        float *plane = f.plane + 4 * i, slip[3], along = 0, length = 0;
        if (f.room[i] > 0) {  // a body that stands still, flat where the vertex is
            const float away = x[0] * plane[0] + x[1] * plane[1] + x[2] * plane[2] - plane[3], c = body.offset - away;
            f.slack[i] = -c;
            if (c <= 0) continue;
            const float by = c < body.most ? c : body.most;
            for (int j = 0; j < 3; ++j) slip[j] = x[j] - p[j], along += slip[j] * plane[j];
            for (int j = 0; j < 3; ++j) slip[j] -= along * plane[j], length += slip[j] * slip[j];
            length = sqrtf(length);
            const float grip = body.friction[i] * by, share = length <= grip ? 1 : grip / length;
            for (int j = 0; j < 3; ++j) x[j] += by * plane[j] - share * slip[j];
            f.slack[i] = 0, f.room[i] -= share * length;
            continue;
        }
        Foot foot;
        const bool inside = walk(body, x, body.nearest[i], s1, foot);
        body.nearest[i] = foot.triangle;
        f.room[i] = inside && reach == 0 ? level(body, foot, s1, plane) : 0;
        float normal[3] = {0, 0, 0}, was[3] = {0, 0, 0};
        for (int k = 0; k < 3; ++k) {
            const int64_t v = 6 * int64_t(body.triangle[3 * int64_t(foot.triangle) + k]);
            for (int j = 0; j < 3; ++j) {
                const float a = body.before[v + 3 + j], b = body.after[v + 3 + j];
                normal[j] += foot.share[k] * (a + s1 * (b - a));
                was[j] += foot.share[k] * (body.before[v + j] + s0 * (body.after[v + j] - body.before[v + j]));
            }
        }
        const float size = sqrtf(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2]);
        if (size < 1e-9f) continue;
        float out = 0;
        for (int j = 0; j < 3; ++j) normal[j] /= size, out += (x[j] - foot.now[j]) * normal[j];
        const float apart = sqrtf(foot.squared);
        const float away = out < 0 ? -apart : apart, c = body.offset - away;
        f.slack[i] = away - body.offset;
        if (c <= 0) continue;
        if (apart > 1e-5f)  // straight away from the foot; on the surface itself along its normal
            for (int j = 0; j < 3; ++j) normal[j] = (x[j] - foot.now[j]) / away;
        const float by = c < body.most ? c : body.most;
        for (int j = 0; j < 3; ++j) slip[j] = (x[j] - p[j]) - (foot.now[j] - was[j]), along += slip[j] * normal[j];
        for (int j = 0; j < 3; ++j) slip[j] -= along * normal[j], length += slip[j] * slip[j];
        length = sqrtf(length);
        const float grip = body.friction[i] * by, share = length <= grip ? 1 : grip / length;
        for (int j = 0; j < 3; ++j) x[j] += by * normal[j] - share * slip[j];
        f.slack[i] = 0, f.room[i] -= share * length;
    }
}

// Shares of four vertices in the way between what is nearest of a vertex and a triangle, or of two edges; true where both
// are inside the triangle or the edges.
bool closest(const ClothTouch& t, int64_t k, float* const x[4], float share[4]) {
    if (k < t.corners) {
        float c[3][3], s[3];
        for (int i = 0; i < 3; ++i)
            for (int j = 0; j < 3; ++j) c[i][j] = x[i + 1][j];
        const bool inside = foot(x[0], c, s) < 0;
        share[0] = 1, share[1] = -s[0], share[2] = -s[1], share[3] = -s[2];
        return inside;
    }
    float d1[3], d2[3], a = 0, e = 0, b = 0, c = 0, g = 0;
    for (int j = 0; j < 3; ++j) {
        d1[j] = x[1][j] - x[0][j], d2[j] = x[3][j] - x[2][j];
        const float r = x[0][j] - x[2][j];
        a += d1[j] * d1[j], e += d2[j] * d2[j], b += d1[j] * d2[j], c += d1[j] * r, g += d2[j] * r;
    }
    const auto within = [](float value) { return value > 0 ? (value < 1 ? value : 1) : 0; };
    const float whole = a * e - b * b;
    const bool across = whole > 1e-6f * a * e;
    float s = across ? within((b * g - c * e) / whole) : 0.5f;
    const float q = e > 0 ? within((b * s + g) / e) : 0;
    s = a > 0 ? within((b * q - c) / a) : 0;
    share[0] = 1 - s, share[1] = s, share[2] = q - 1, share[3] = -q;
    return across && s > 0 && s < 1 && q > 0 && q < 1;
}

float blend(float* const x[4], const float share[4], float way[3]) {
    float squared = 0;
    for (int j = 0; j < 3; ++j) {
        way[j] = share[0] * x[0][j] + share[1] * x[1][j] + share[2] * x[2][j] + share[3] * x[3][j];
        squared += way[j] * way[j];
    }
    return sqrtf(squared);
}

// Cloth against cloth: pairs in their order, each moved apart to its gap, and rubbing. A pair is not looked at before its
// vertices have come as far as it was apart (due, of the paths that they have covered).
void part(const ClothFrame& f, const ClothTouch& t) {
    const auto path = [&f, &t](int64_t k) {
        const int32_t* i = t.vertex + 4 * k;
        const auto larger = [](float a, float b) { return a > b ? a : b; };
        const float *s = f.path, c = larger(s[i[2]], s[i[3]]);
        return k < t.corners ? s[i[0]] + larger(s[i[1]], c) : larger(s[i[0]], s[i[1]]) + c;
    };
    for (int64_t k = 0; k < t.count; ++k) {
        const float gone = path(k);
        if (gone < t.due[k]) continue;
        const int32_t* index = t.vertex + 4 * k;
        float *x[4], *p[4], share[4], way[3], n[3];
        for (int i = 0; i < 4; ++i) x[i] = f.x + 4 * int64_t(index[i]), p[i] = f.p + 4 * int64_t(index[i]);
        const bool inside = closest(t, k, x, share);
        const float gap = t.gap[k], apart = blend(x, share, way);
        float deep = gap - apart;
        if (k < t.corners && inside) {
            const float u[3] = {x[2][0] - x[1][0], x[2][1] - x[1][1], x[2][2] - x[1][2]};
            const float w[3] = {x[3][0] - x[1][0], x[3][1] - x[1][1], x[3][2] - x[1][2]};
            n[0] = u[1] * w[2] - u[2] * w[1], n[1] = u[2] * w[0] - u[0] * w[2], n[2] = u[0] * w[1] - u[1] * w[0];
            const float size = sqrtf(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
            if (size < 1e-14f) continue;
            float above = 0;
            for (int j = 0; j < 3; ++j) n[j] *= t.side[k] / size, above += way[j] * n[j];
            deep = gap - above;
        } else if (k >= t.corners && inside) {
            const float* first = t.first + 3 * (k - t.corners);  // where the one edge was, seen from the other
            const float sign = way[0] * first[0] + way[1] * first[1] + way[2] * first[2] < 0 ? -1.0f : 1.0f;
            const bool touching = apart < 1e-7f;
            for (int j = 0; j < 3; ++j) n[j] = touching ? first[j] : sign * way[j] / apart;
            deep = gap - sign * apart;
        }
        if (deep <= 0) {
            t.due[k] = gone - deep;
            continue;
        }
        if (!inside) {  // beside the triangle's rim, where others see to its side
            if (k >= t.corners || apart < 1e-7f) continue;
            for (int j = 0; j < 3; ++j) n[j] = way[j] / apart;
        }
        float both = 0, slip[3], along = 0, length = 0;
        for (int i = 0; i < 4; ++i) both += x[i][3] * share[i] * share[i];
        if (!(both > 0)) continue;
        const float by = (deep < 0.5f * gap ? deep : 0.5f * gap) / both;
        blend(p, share, slip);
        for (int j = 0; j < 3; ++j) slip[j] = way[j] - slip[j], along += slip[j] * n[j];
        for (int j = 0; j < 3; ++j) slip[j] -= along * n[j], length += slip[j] * slip[j];
        length = sqrtf(length);
        const float grip = t.friction[k] * by * both, rub = (length <= grip ? 1 : grip / length) / both;
        for (int i = 0; i < 4; ++i) {
            const float w = x[i][3] * share[i];
            for (int j = 0; j < 3; ++j) x[i][j] += w * (by * n[j] - rub * slip[j]);
        }
    }
}

// What a frame begins with: nothing is known of pairs, and how edges lie to each other.
void meet(const ClothFrame& f, const ClothTouch& t) {
    for (int64_t k = 0; k < t.count; ++k) {
        t.due[k] = 0;
        if (k < t.corners) continue;
        const int32_t* index = t.vertex + 4 * k;
        float *x[4], share[4], *first = t.first + 3 * (k - t.corners);
        for (int i = 0; i < 4; ++i) x[i] = f.x + 4 * int64_t(index[i]);
        closest(t, k, x, share);
        const float apart = blend(x, share, first);
        for (int j = 0; j < 3; ++j) first[j] = apart > 0 ? first[j] / apart : 0;
    }
}

// How far vertices have come, beside what all of them have in common.
void advance(const ClothFrame& f, int64_t n) {
    double mean[3] = {0, 0, 0};
    for (int64_t i = 0; i < n; ++i)
        for (int j = 0; j < 3; ++j) mean[j] += double(f.x[4 * i + j]) - double(f.seen[4 * i + j]);
    float common[3];
    for (int j = 0; j < 3; ++j) common[j] = float(mean[j] / double(n));
    for (int64_t i = 0; i < n; ++i) {
        float squared = 0;
        for (int j = 0; j < 3; ++j) {
            const float moved = f.x[4 * i + j] - f.seen[4 * i + j] - common[j];
            squared += moved * moved, f.seen[4 * i + j] = f.x[4 * i + j];
        }
        f.path[i] += sqrtf(squared);
    }
}

}  // namespace

void cloth_frame(const ClothProgram& program, const ClothFrame& f, const ClothBody& body, const ClothTouch& near) {
    const int64_t n = program.vertices;
    const float h = f.step, over = 1 / (h * h), keep = expf(-f.damping * h);
    for (int64_t i = 0; i < n; ++i) f.slack[i] = f.path[i] = f.room[i] = 0;
    if (near.count) meet(f, near), memcpy(f.seen, f.x, size_t(n) * 16);
    for (int s = 0; s < f.substeps; ++s) {
        const float s0 = float(s) / float(f.substeps), s1 = float(s + 1) / float(f.substeps);
        for (int64_t i = 0; i < n; ++i) {
            float *x = f.x + 4 * i, *v = f.v + 4 * i, *p = f.p + 4 * i, *q = f.q + 4 * i;
            for (int j = 0; j < 4; ++j) p[j] = q[j] = x[j];
            if (!(x[3] > 0)) continue;
            for (int j = 0; j < 3; ++j) v[j] = (v[j] + h * f.gravity[j]) * keep;
            if (f.limit > 0) {
                const float fast = sqrtf(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]) * h;
                if (fast > f.limit)
                    for (int j = 0; j < 3; ++j) v[j] *= f.limit / fast;
            }
            for (int j = 0; j < 3; ++j) q[j] = x[j] + h * v[j], x[j] = q[j];
        }
        for (int64_t k = 0; k < f.pins; ++k)
            for (int j = 0; j < 3; ++j) {
                const float a = f.pin_path[6 * k + j], b = f.pin_path[6 * k + 3 + j];
                f.x[4 * int64_t(f.pin[k]) + j] = a + s1 * (b - a);
            }
        if (s % f.bends == 0) {  // what bends is slow: pushed for several steps at once
            const int steps = f.substeps - s < f.bends ? f.substeps - s : f.bends;
            for (int64_t g = 0; g < program.hinges; ++g)
                hinge(f.x, program.hinge + 32 * g, program.hinge_rest + 40 * g, over / float(steps));
            for (int64_t g = 0; g < program.shapes; ++g)
                shape(f.x, program.shape + 48 * g, program.shape_rest + 152 * g, over / float(steps));
        }
        for (int64_t i = 0; i < n; ++i)
            for (int j = 0; j < 3; ++j) {
                float *x = f.x + 4 * i + j, *d = f.d + 4 * i + j;
                const float begin = *x;
                *x += f.carry * *d, *d = begin;
            }
        for (int64_t g = 0; g < program.membranes; ++g)
            membrane(f.x, program.membrane + 24 * g, program.membrane_rest + 64 * g, f.membrane_force + 24 * g, over, f.carry);
        for (int64_t i = 0; i < n; ++i)
            for (int j = 0; j < 3; ++j) f.d[4 * i + j] = f.x[4 * i + j] - f.d[4 * i + j];
        for (int64_t g = 0; g < program.tethers; ++g)
            tether(f.x, program.tether + 16 * g, program.tether_rest + 8 * g);
        if (f.pairs) sew(f, s1, over);
        if (near.count) advance(f, n), part(f, near);
        if (body.triangles) push(f, body, n, s0, s1, body.reach / float(f.substeps));
        for (int64_t i = 0; i < n; ++i) {
            float *x = f.x + 4 * i, *v = f.v + 4 * i, *q = f.q + 4 * i;
            if (x[3] > 0)
                for (int j = 0; j < 3; ++j) v[j] += (x[j] - q[j]) / h;  // not from p: that would round each time
        }
    }
}

}  // namespace vt::VT_NS
