#include "near_cloth.h"

#include <algorithm>
#include <cmath>
#include <utility>

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
V cross_product(V a, V b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }

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

// Where something is, and the range of its velocities.
struct Range {
    float low[3], high[3], slow[3], fast[3];

    static Range none() {
        Range r;
        for (int j = 0; j < 3; ++j) r.low[j] = r.slow[j] = 3e38f, r.high[j] = r.fast[j] = -3e38f;
        return r;
    }
    void add(const float* x, const float* v) {
        for (int j = 0; j < 3; ++j) {
            low[j] = std::min(low[j], x[j]), high[j] = std::max(high[j], x[j]);
            slow[j] = std::min(slow[j], v[j]), fast[j] = std::max(fast[j], v[j]);
        }
    }
    void add(const Range& r) { add(r.low, r.slow), add(r.high, r.fast); }
};

bool may_meet(const Range& a, const Range& b, const Reach& reach) {
    for (int j = 0; j < 3; ++j) {
        const float back = std::max(-reach.moving, reach.time * (a.slow[j] - b.fast[j]));
        const float on = std::min(reach.moving, reach.time * (a.fast[j] - b.slow[j]));
        if (a.low[j] - b.high[j] + std::min(0.0f, back) > reach.still) return false;
        if (a.high[j] - b.low[j] + std::max(0.0f, on) < -reach.still) return false;
    }
    return true;
}

Range range_of(const Surface& s, const float* v, const int32_t* index, int count) {
    Range r = Range::none();
    for (int k = 0; k < count; ++k) r.add(s.x + 4 * int64_t(index[k]), v + 4 * int64_t(index[k]));
    return r;
}

// A tree of ranges of triangles, halved along the longer side of their places.
class Tree {
public:
    Tree(const Surface& s, const float* v) : range(size_t(s.triangles)), order(size_t(s.triangles)) {
        for (int64_t t = 0; t < s.triangles; ++t) {
            range[size_t(t)] = range_of(s, v, s.triangle + 3 * t, 3);
            order[size_t(t)] = int32_t(t);
        }
        if (s.triangles) node.reserve(size_t(s.triangles)), split(0, int32_t(s.triangles));
    }
    // Calls f(t, u), t < u, for triangles that may meet.
    template <class F>
    void pairs(const Reach& reach, F&& f) const {
        if (!node.empty()) inside(0, reach, f);
    }

    std::vector<Range> range;  // of each triangle

private:
    static constexpr int32_t kLeaf = 4;
    struct Node {
        Range range;
        int32_t begin, end, left, right;  // left < 0: a leaf
    };
    int32_t split(int32_t begin, int32_t end) {
        const int32_t self = int32_t(node.size());
        node.push_back({Range::none(), begin, end, -1, -1});
        Range r = Range::none();
        for (int32_t k = begin; k < end; ++k) r.add(range[size_t(order[size_t(k)])]);
        node[size_t(self)].range = r;
        if (end - begin <= kLeaf) return self;
        int axis = 0;
        for (int j = 1; j < 3; ++j)
            if (r.high[j] - r.low[j] > r.high[axis] - r.low[axis]) axis = j;
        const int32_t middle = (begin + end) / 2;
        std::nth_element(order.begin() + begin, order.begin() + middle, order.begin() + end, [&](int32_t a, int32_t b) {
            const float x = range[size_t(a)].low[axis] + range[size_t(a)].high[axis];
            const float y = range[size_t(b)].low[axis] + range[size_t(b)].high[axis];
            return x < y || (x == y && a < b);
        });
        const int32_t left = split(begin, middle), right = split(middle, end);
        node[size_t(self)].left = left, node[size_t(self)].right = right;
        return self;
    }
    template <class F>
    void one(int32_t i, int32_t j, const Reach& reach, F&& f) const {
        const int32_t t = order[size_t(i)], u = order[size_t(j)];
        if (may_meet(range[size_t(t)], range[size_t(u)], reach)) f(std::min(t, u), std::max(t, u));
    }
    template <class F>
    void inside(int32_t k, const Reach& reach, F&& f) const {
        const Node& n = node[size_t(k)];
        if (n.left < 0) {
            for (int32_t i = n.begin; i < n.end; ++i)
                for (int32_t j = i + 1; j < n.end; ++j) one(i, j, reach, f);
            return;
        }
        inside(n.left, reach, f), inside(n.right, reach, f), between(n.left, n.right, reach, f);
    }
    template <class F>
    void between(int32_t k, int32_t l, const Reach& reach, F&& f) const {
        const Node &a = node[size_t(k)], &b = node[size_t(l)];
        if (!may_meet(a.range, b.range, reach)) return;
        if (a.left < 0 && b.left < 0) {
            for (int32_t i = a.begin; i < a.end; ++i)
                for (int32_t j = b.begin; j < b.end; ++j) one(i, j, reach, f);
        } else if (b.left < 0 || (a.left >= 0 && a.end - a.begin >= b.end - b.begin)) {
            between(a.left, l, reach, f), between(a.right, l, reach, f);
        } else {
            between(k, b.left, reach, f), between(k, b.right, reach, f);
        }
    }
    std::vector<int32_t> order;
    std::vector<Node> node;
};

V speed(const float* v, int32_t i) { return {v[4 * int64_t(i)], v[4 * int64_t(i) + 1], v[4 * int64_t(i) + 2]}; }

constexpr double kBent = 0.5;  // cosine of the angle between neighbours that may touch in the coming frame

// Whether two of them that are `way` apart may meet before the frame ends, each pair of vertices moving straight on.
bool meet(V way, const float* v, const int32_t* a, int m, const int32_t* b, int n, const Reach& reach) {
    const double limit = double(reach.still) * reach.still;
    if (dot(way, way) <= limit) return true;
    for (int i = 0; i < m; ++i)
        for (int j = 0; j < n; ++j) {
            const V moving = speed(v, a[i]) - speed(v, b[j]);
            const double fast = dot(moving, moving), closing = -dot(way, moving);
            if (!(closing > 0)) continue;
            const double time = std::min({closing / fast, double(reach.time), reach.moving / std::sqrt(fast)});
            const V then = way + time * moving;
            if (dot(then, then) <= limit) return true;
        }
    return false;
}

// From the second edge to the first where both are nearest; false where they are parallel.
bool between_edges(const Surface& s, const int32_t* p, const int32_t* q, V& way) {
    const V a = at(s, p[0]), d1 = at(s, p[1]) - a, b = at(s, q[0]), d2 = at(s, q[1]) - b, r = a - b;
    const double aa = dot(d1, d1), ee = dot(d2, d2), ab = dot(d1, d2), c = dot(d1, r), g = dot(d2, r);
    const double whole = aa * ee - ab * ab;
    if (!(whole > 1e-6 * aa * ee)) return false;
    const double t = std::min(1.0, std::max(0.0, (ab * g - c * ee) / whole));
    const double u = std::min(1.0, std::max(0.0, (ab * t + g) / ee));
    const double t2 = std::min(1.0, std::max(0.0, (ab * u - c) / aa));
    way = r + t2 * d1 - u * d2;
    return true;
}

}  // namespace

void find_near(const Surface& s, const float* v, const Reach& reach, const int32_t* before, const float* side, int64_t known,
               Near& out) {
    const auto one = [&s](int32_t a, int32_t b) { return s.same[a] == s.same[b]; };
    const auto free = [&s](int32_t i) { return s.x[4 * int64_t(i) + 3] > 0; };
    // each vertex and edge is looked at with one of its triangles, the first
    std::vector<int32_t> vertex_of(size_t(s.vertices), -1), edge_of(size_t(s.edges), -1);
    for (int64_t t = 0; t < s.triangles; ++t)
        for (int k = 0; k < 3; ++k) {
            int32_t &a = vertex_of[size_t(s.triangle[3 * t + k])], &b = edge_of[size_t(s.sides[3 * t + k])];
            if (a < 0) a = int32_t(t);
            if (b < 0) b = int32_t(t);
        }
    const Tree tree(s, v);
    std::vector<Range> line(static_cast<size_t>(s.edges));
    for (int64_t e = 0; e < s.edges; ++e) line[size_t(e)] = range_of(s, v, s.edge + 2 * e, 2);
    std::vector<std::pair<int32_t, int32_t>> corner, cross;
    const auto try_corner = [&](int32_t i, int32_t t) {
        const int32_t* c = s.triangle + 3 * int64_t(t);
        if (one(c[0], i) || one(c[1], i) || one(c[2], i) || !(free(i) || free(c[0]) || free(c[1]) || free(c[2]))) return;
        if (!may_meet(range_of(s, v, &i, 1), tree.range[size_t(t)], reach)) return;
        const V p = at(s, i);
        if (meet(p - nearest(p, at(s, c[0]), at(s, c[1]), at(s, c[2])), v, &i, 1, c, 3, reach)) corner.push_back({i, t});
    };
    const auto try_cross = [&](int32_t e, int32_t f) {
        const int32_t *p = s.edge + 2 * int64_t(e), *q = s.edge + 2 * int64_t(f);
        if (one(p[0], q[0]) || one(p[0], q[1]) || one(p[1], q[0]) || one(p[1], q[1])) return;
        if (!(free(p[0]) || free(p[1]) || free(q[0]) || free(q[1]))) return;
        V way;
        if (!may_meet(line[size_t(e)], line[size_t(f)], reach) || !between_edges(s, p, q, way)) return;
        if (meet(way, v, p, 2, q, 2, reach)) cross.push_back({e, f});
    };
    std::vector<V> normal(static_cast<size_t>(s.triangles));
    for (int64_t t = 0; t < s.triangles; ++t) {
        const int32_t* c = s.triangle + 3 * t;
        const V n = cross_product(at(s, c[1]) - at(s, c[0]), at(s, c[2]) - at(s, c[0]));
        normal[size_t(t)] = (1 / std::sqrt(dot(n, n) + 1e-60)) * n;
    }
    // triangles with a common vertex do not meet before they are bent
    const auto flat = [&](int32_t t, int32_t u) {
        if (dot(normal[size_t(t)], normal[size_t(u)]) < kBent) return false;
        const int32_t *a = s.triangle + 3 * int64_t(t), *b = s.triangle + 3 * int64_t(u);
        for (int k = 0; k < 9; ++k)
            if (one(a[k / 3], b[k % 3])) return true;
        return false;
    };
    tree.pairs(reach, [&](int32_t t, int32_t u) {
        if (flat(t, u)) return;
        for (int k = 0; k < 3; ++k) {
            const int32_t a = s.triangle[3 * int64_t(t) + k], b = s.triangle[3 * int64_t(u) + k];
            if (vertex_of[size_t(a)] == t) try_corner(a, u);
            if (vertex_of[size_t(b)] == u) try_corner(b, t);
        }
        for (int k = 0; k < 3; ++k) {
            const int32_t e = s.sides[3 * int64_t(t) + k];
            if (edge_of[size_t(e)] != t) continue;
            for (int l = 0; l < 3; ++l) {
                const int32_t f = s.sides[3 * int64_t(u) + l];
                if (edge_of[size_t(f)] == u) try_cross(std::min(e, f), std::max(e, f));
            }
        }
    });
    std::sort(corner.begin(), corner.end());
    std::sort(cross.begin(), cross.end());
    for (const auto& [i, t] : corner) {
        const int32_t* c = s.triangle + 3 * int64_t(t);
        const V p = at(s, i), a = at(s, c[0]), b = at(s, c[1]), d = at(s, c[2]), way = p - nearest(p, a, b, d);
        float which = dot(p - a, cross_product(b - a, d - a)) < 0 ? -1.0f : 1.0f;
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
        if (dot(way, way) > double(reach.firm) * reach.firm) continue;
        out.key.insert(out.key.end(), {i, t});
        out.key_side.push_back(which);
    }
    for (const auto& [e, f] : cross) {
        const int32_t *p = s.edge + 2 * int64_t(e), *q = s.edge + 2 * int64_t(f);
        out.cross.insert(out.cross.end(), {p[0], p[1], q[0], q[1]});
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
            const V u = at(s, c[0]), v = at(s, c[1]), w = at(s, c[2]), n = cross_product(v - u, w - u);
            const double begin = dot(n, a - u), end = dot(n, b - u);
            if ((begin > 0) == (end > 0) || begin == end) continue;
            // signed volumes of the edge with each side of the triangle
            const double x = dot(way, cross_product(u - a, v - a)), y = dot(way, cross_product(v - a, w - a)), z = dot(way, cross_product(w - a, u - a));
            if ((x > 0 && y > 0 && z > 0) || (x < 0 && y < 0 && z < 0)) out.insert(out.end(), {e, t});
        }
    }
}

}  // namespace vt
