#include "near_cloth.h"

#include <algorithm>
#include <cmath>

namespace vt {

namespace {

struct Box {
    int32_t low[3], high[3];
};

// Lists of items by cell of a grid, hashed into a table: an item may be listed where it is not, never the other way.
class Grid {
public:
    Grid(const std::vector<Box>& boxes) {
        size_t entries = 0;
        for (const Box& b : boxes) entries += count(b);
        while (mask_ + 1 < entries) mask_ = mask_ * 2 + 1;
        start_.assign(mask_ + 2, 0);
        for (const Box& b : boxes) visit(b, [&](uint32_t h) { ++start_[h + 1]; });
        for (size_t i = 0; i <= mask_; ++i) start_[i + 1] += start_[i];
        item_.resize(entries);
        std::vector<uint32_t> next(start_.begin(), start_.end() - 1);
        for (size_t i = 0; i < boxes.size(); ++i) visit(boxes[i], [&](uint32_t h) { item_[next[h]++] = int32_t(i); });
    }
    template <class F>
    void at(const Box& box, F&& f) const {
        visit(box, [&](uint32_t h) {
            for (uint32_t k = start_[h]; k < start_[h + 1]; ++k) f(item_[k]);
        });
    }

private:
    static size_t count(const Box& b) {
        size_t n = 1;
        for (int j = 0; j < 3; ++j) n *= size_t(b.high[j] - b.low[j] + 1);
        return n;
    }
    template <class F>
    void visit(const Box& b, F&& f) const {
        for (int32_t i = b.low[0]; i <= b.high[0]; ++i)
            for (int32_t j = b.low[1]; j <= b.high[1]; ++j)
                for (int32_t k = b.low[2]; k <= b.high[2]; ++k)
                    f((uint32_t(i) * 73856093u ^ uint32_t(j) * 19349663u ^ uint32_t(k) * 83492791u) & uint32_t(mask_));
    }
    size_t mask_ = 1023;
    std::vector<uint32_t> start_;
    std::vector<int32_t> item_;
};

Box box_of(const float* x, const int32_t* index, int corners, float wider, float cell) {
    Box b;
    for (int j = 0; j < 3; ++j) {
        float low = x[4 * int64_t(index[0]) + j], high = low;
        for (int k = 1; k < corners; ++k) {
            const float value = x[4 * int64_t(index[k]) + j];
            low = std::min(low, value), high = std::max(high, value);
        }
        b.low[j] = int32_t(std::floor((low - wider) / cell)), b.high[j] = int32_t(std::floor((high + wider) / cell));
    }
    return b;
}

float length_of(const Surface& s) {
    double total = 0;
    for (int64_t e = 0; e < s.edges; ++e) {
        const float *a = s.x + 4 * int64_t(s.edge[2 * e]), *b = s.x + 4 * int64_t(s.edge[2 * e + 1]);
        total += std::sqrt(double(a[0] - b[0]) * (a[0] - b[0]) + double(a[1] - b[1]) * (a[1] - b[1]) +
                           double(a[2] - b[2]) * (a[2] - b[2]));
    }
    return s.edges ? float(total / double(s.edges)) : 1.0f;
}

struct V {
    double x, y, z;
};
V at(const Surface& s, int32_t i) { return {s.x[4 * int64_t(i)], s.x[4 * int64_t(i) + 1], s.x[4 * int64_t(i) + 2]}; }
V operator-(V a, V b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
V operator+(V a, V b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
V operator*(double k, V a) { return {k * a.x, k * a.y, k * a.z}; }
double dot(V a, V b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
V cross(V a, V b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }

V nearest(V p, V a, V b, V c) {  // of a triangle (Ericson 2005, 5.1.5)
    const V ab = b - a, ac = c - a, ap = p - a, bp = p - b, cp = p - c;
    const double d1 = dot(ab, ap), d2 = dot(ac, ap), d3 = dot(ab, bp), d4 = dot(ac, bp), d5 = dot(ab, cp), d6 = dot(ac, cp);
    if (d1 <= 0 && d2 <= 0) return a;
    if (d3 >= 0 && d4 <= d3) return b;
    if (d6 >= 0 && d5 <= d6) return c;
    const double va = d3 * d6 - d5 * d4, vb = d5 * d2 - d1 * d6, vc = d1 * d4 - d3 * d2;
    if (vc <= 0 && d1 >= 0 && d3 <= 0) return a + (d1 - d3 > 0 ? d1 / (d1 - d3) : 0) * ab;
    if (vb <= 0 && d2 >= 0 && d6 <= 0) return a + (d2 - d6 > 0 ? d2 / (d2 - d6) : 0) * ac;
    if (va <= 0 && d4 - d3 >= 0 && d5 - d6 >= 0) return b + (d4 - d3) / ((d4 - d3) + (d5 - d6)) * (c - b);
    const double whole = va + vb + vc;
    if (!(whole != 0)) return a;
    return a + (vb / whole) * ab + (vc / whole) * ac;
}

}  // namespace

namespace {

// What surrounds a triangle or an edge, and the fastest of its vertices beside the mean of all.
struct Ball {
    V center;
    double radius;
    float wider;  // metres that its box is widened by
};

V speed(const float* v, int32_t i) {
    return {v[4 * int64_t(i)], v[4 * int64_t(i) + 1], v[4 * int64_t(i) + 2]};
}

V average(const Surface& s, const float* v) {
    V sum{0, 0, 0};
    for (int32_t i = 0; i < int32_t(s.vertices); ++i) sum = sum + speed(v, i);
    return (1.0 / double(std::max<int64_t>(s.vertices, 1))) * sum;
}

}  // namespace

void find_near(const Surface& s, const float* v, const Reach& reach, const int32_t* before, const float* side, int64_t known,
               Near& out) {
    const auto one = [&s](int32_t a, int32_t b) { return s.same[a] == s.same[b]; };
    const V mean = average(s, v);
    const auto ball = [&](const int32_t* index, int corners) {
        Ball b{{0, 0, 0}, 0, 0};
        double fast = 0;
        for (int k = 0; k < corners; ++k) b.center = b.center + (1.0 / corners) * at(s, index[k]);
        for (int k = 0; k < corners; ++k) {
            const V way = at(s, index[k]) - b.center, moving = speed(v, index[k]) - mean;
            b.radius = std::max(b.radius, dot(way, way)), fast = std::max(fast, dot(moving, moving));
        }
        b.radius = std::sqrt(b.radius);
        b.wider = float(0.5 * reach.still + std::min(reach.time * std::sqrt(fast), 0.5 * reach.moving));
        return b;
    };
    // how far apart two of them may be that meet before the frame ends
    const auto allowed = [&](const int32_t* a, int m, const int32_t* b, int n) {
        double fast = 0;
        for (int i = 0; i < m; ++i)
            for (int j = 0; j < n; ++j) {
                const V way = speed(v, a[i]) - speed(v, b[j]);
                fast = std::max(fast, dot(way, way));
            }
        return reach.still + std::min(reach.time * std::sqrt(fast), double(reach.moving));
    };
    const float cell = std::max(length_of(s), reach.still);
    std::vector<Box> boxes(static_cast<size_t>(s.triangles));
    std::vector<Ball> balls(static_cast<size_t>(s.triangles));
    for (int64_t t = 0; t < s.triangles; ++t) {
        balls[size_t(t)] = ball(s.triangle + 3 * t, 3);
        boxes[size_t(t)] = box_of(s.x, s.triangle + 3 * t, 3, balls[size_t(t)].wider, cell);
    }
    std::vector<int32_t> found;
    std::vector<int32_t> seen(size_t(std::max(s.triangles, s.edges)), -1);
    {
        const Grid grid(boxes);
        for (int32_t i = 0; i < int32_t(s.vertices); ++i) {
            found.clear();
            const V p = at(s, i);
            const Ball own = ball(&i, 1);
            grid.at(box_of(s.x, &i, 1, own.wider, cell), [&](int32_t t) {
                if (seen[size_t(t)] == i) return;
                seen[size_t(t)] = i;
                const Ball& b = balls[size_t(t)];
                const V way = p - b.center;
                const double most = b.radius + b.wider + own.wider;
                if (dot(way, way) <= most * most) found.push_back(t);
            });
            std::sort(found.begin(), found.end());
            for (int32_t t : found) {
                const int32_t* c = s.triangle + 3 * int64_t(t);
                if (one(c[0], i) || one(c[1], i) || one(c[2], i)) continue;
                const V a = at(s, c[0]), b = at(s, c[1]), d = at(s, c[2]), way = p - nearest(p, a, b, d);
                const double apart = dot(way, way), limit = allowed(&i, 1, c, 3);
                if (apart > limit * limit) continue;
                const V n = cross(b - a, d - a);
                float which = dot(p - a, n) < 0 ? -1.0f : 1.0f;
                int64_t low = 0, high = known;  // the same pair in the frame before
                while (low < high) {
                    const int64_t middle = (low + high) / 2;
                    const int32_t* k = before + 2 * middle;
                    if (k[0] < i || (k[0] == i && k[1] < t)) low = middle + 1;
                    else high = middle;
                }
                if (low < known && before[2 * low] == i && before[2 * low + 1] == t) which = side[low];
                out.corner.insert(out.corner.end(), {i, c[0], c[1], c[2]});
                out.side.push_back(which);
                ++out.corners;
                if (apart > double(reach.firm) * reach.firm) continue;
                out.key.insert(out.key.end(), {i, t});
                out.key_side.push_back(which);
            }
        }
    }
    boxes.resize(size_t(s.edges)), balls.resize(size_t(s.edges));
    for (int64_t e = 0; e < s.edges; ++e) {
        balls[size_t(e)] = ball(s.edge + 2 * e, 2);
        boxes[size_t(e)] = box_of(s.x, s.edge + 2 * e, 2, balls[size_t(e)].wider, cell);
    }
    const Grid grid(boxes);
    std::fill(seen.begin(), seen.end(), -1);
    for (int32_t e = 0; e < int32_t(s.edges); ++e) {
        const int32_t *p = s.edge + 2 * int64_t(e);
        found.clear();
        const Ball& own = balls[size_t(e)];
        grid.at(boxes[size_t(e)], [&](int32_t f) {
            if (f <= e || seen[size_t(f)] == e) return;
            seen[size_t(f)] = e;
            const Ball& b = balls[size_t(f)];
            const V way = own.center - b.center;
            const double most = own.radius + own.wider + b.radius + b.wider;
            if (dot(way, way) <= most * most) found.push_back(f);
        });
        std::sort(found.begin(), found.end());
        for (int32_t f : found) {
            const int32_t* q = s.edge + 2 * int64_t(f);
            if (one(p[0], q[0]) || one(p[0], q[1]) || one(p[1], q[0]) || one(p[1], q[1])) continue;
            const V a = at(s, p[0]), d1 = at(s, p[1]) - a, b = at(s, q[0]), d2 = at(s, q[1]) - b, r = a - b;
            const double aa = dot(d1, d1), ee = dot(d2, d2), ab = dot(d1, d2), c = dot(d1, r), g = dot(d2, r);
            const double whole = aa * ee - ab * ab;
            if (!(whole > 1e-6 * aa * ee)) continue;
            const double t = std::min(1.0, std::max(0.0, (ab * g - c * ee) / whole));
            const double u = std::min(1.0, std::max(0.0, (ab * t + g) / ee));
            const double t2 = std::min(1.0, std::max(0.0, (ab * u - c) / aa));
            const V way = r + t2 * d1 - u * d2;
            const double limit = allowed(p, 2, q, 2);
            if (dot(way, way) <= limit * limit) out.cross.insert(out.cross.end(), {p[0], p[1], q[0], q[1]});
        }
    }
}

void find_cuts(const Surface& s, std::vector<int32_t>& out) {
    const auto one = [&s](int32_t a, int32_t b) { return s.same[a] == s.same[b]; };
    const float cell = length_of(s);
    std::vector<Box> boxes(static_cast<size_t>(s.triangles));
    for (int64_t t = 0; t < s.triangles; ++t) boxes[size_t(t)] = box_of(s.x, s.triangle + 3 * t, 3, 1e-7f, cell);
    const Grid grid(boxes);
    std::vector<int32_t> seen(size_t(s.triangles), -1), found;
    for (int32_t e = 0; e < int32_t(s.edges); ++e) {
        const int32_t* p = s.edge + 2 * int64_t(e);
        found.clear();
        grid.at(box_of(s.x, p, 2, 1e-7f, cell), [&](int32_t t) {
            if (seen[size_t(t)] == e) return;
            seen[size_t(t)] = e;
            found.push_back(t);
        });
        std::sort(found.begin(), found.end());
        const V a = at(s, p[0]), b = at(s, p[1]), way = b - a;
        for (int32_t t : found) {
            const int32_t* c = s.triangle + 3 * int64_t(t);
            bool common = false;
            for (int k = 0; k < 3; ++k) common |= one(c[k], p[0]) || one(c[k], p[1]);
            if (common) continue;
            const V u = at(s, c[0]), v = at(s, c[1]), w = at(s, c[2]), n = cross(v - u, w - u);
            const double begin = dot(n, a - u), end = dot(n, b - u);
            if ((begin > 0) == (end > 0) || begin == end) continue;
            // signed volumes of the edge with each side of the triangle
            const double x = dot(way, cross(u - a, v - a)), y = dot(way, cross(v - a, w - a)), z = dot(way, cross(w - a, u - a));
            if ((x > 0 && y > 0 && z > 0) || (x < 0 && y < 0 && z < 0)) out.insert(out.end(), {e, t});
        }
    }
}

}  // namespace vt
