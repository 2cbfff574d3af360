#include "near_cloth.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <utility>

#include "threads.h"

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
    float low[3], high[3], slow[3], fast[3];  // one after the other

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

Range range_of(const Surface& s, const float* v, const int32_t* index, int count) {
    Range r = Range::none();
    for (int k = 0; k < count; ++k) r.add(s.x + 4 * int64_t(index[k]), v + 4 * int64_t(index[k]));
    return r;
}

// Halves triangles along the longer side of where their middles are, until eight are left; the first half fills its leaves.
void halve(const std::vector<float>& middle, int32_t* begin, int32_t* end) {
    const int64_t count = end - begin;
    if (count <= 8) return;
    float low[3] = {3e38f, 3e38f, 3e38f}, high[3] = {-3e38f, -3e38f, -3e38f};
    for (const int32_t* t = begin; t < end; ++t)
        for (int j = 0; j < 3; ++j) {
            const float x = middle[size_t(3 * int64_t(*t) + j)];
            low[j] = std::min(low[j], x), high[j] = std::max(high[j], x);
        }
    int axis = 0;
    for (int j = 1; j < 3; ++j)
        if (high[j] - low[j] > high[axis] - low[axis]) axis = j;
    int64_t half = 8;
    while (2 * half < count) half *= 2;
    if (half >= count) half = count / 2;
    int32_t* const at = begin + half;
    std::nth_element(begin, at, end, [&](int32_t a, int32_t b) {
        const float x = middle[size_t(3 * int64_t(a) + axis)], y = middle[size_t(3 * int64_t(b) + axis)];
        return x < y || (x == y && a < b);
    });
    halve(middle, begin, at), halve(middle, at, end);
}

// Puts something into a lane.
void put(NearBlock& block, size_t lane, int32_t item, const Range& range) {
    block.item[lane] = item;
    for (int j = 0; j < 3; ++j) {
        block.box.value[j][lane] = range.low[j], block.box.value[3 + j][lane] = range.high[j];
        block.box.value[6 + j][lane] = range.slow[j], block.box.value[9 + j][lane] = range.fast[j];
    }
}

NearBlock nothing() {
    NearBlock out{};
    for (size_t l = 0; l < 8; ++l) {
        for (size_t j = 0; j < 3; ++j) {
            out.box.value[j][l] = out.box.value[6 + j][l] = 3e38f, out.box.value[3 + j][l] = out.box.value[9 + j][l] = -3e38f;
            out.same[j][l] = -1;
        }
        out.item[l] = -1;
    }
    return out;
}

V upright(const Surface& s, int32_t t) {
    const int32_t* c = s.triangle + 3 * int64_t(t);
    const V n = cross_product(at(s, c[1]) - at(s, c[0]), at(s, c[2]) - at(s, c[0]));
    return (1 / std::sqrt(dot(n, n) + 1e-60)) * n;
}

// Calls f(i) for i below count on some threads.
template <class F>
void each(int64_t count, int threads, F f) {
    share(count, threads, [](void* g, int64_t i) { (*static_cast<F*>(g))(i); }, &f);
}

constexpr int64_t kChunk = 32;  // leaves that one thread looks at in one go

// The tree of near_pairs.h, as it is now.
struct Tree {
    Tree(const NearKernels& kernels, int threads, const Surface& s, const float* v, const NearPlan& plan, double bent) {
        const int64_t n = s.triangles, leaves = (n + 7) / 8;
        const size_t vertices = size_t(plan.vertex_first[leaves]), edges = size_t(plan.edge_first[leaves]);
        triangle.reset(new NearBlock[size_t(leaves)]), vertex.reset(new NearBlock[vertices]), edge.reset(new NearBlock[edges]);
        const NearBlock none = nothing();
        each((leaves + kChunk - 1) / kChunk, threads, [&](int64_t chunk) {
            for (int64_t leaf = kChunk * chunk; leaf < std::min(leaves, kChunk * (chunk + 1)); ++leaf) {
                NearBlock& own = triangle[size_t(leaf)] = none;
                for (int64_t k = 8 * leaf; k < std::min(n, 8 * leaf + 8); ++k) {
                    const int32_t t = plan.order[k];
                    const size_t lane = size_t(k % 8);
                    put(own, lane, t, range_of(s, v, s.triangle + 3 * int64_t(t), 3));
                    for (int j = 0; j < 3; ++j) own.same[j][lane] = s.same[s.triangle[3 * int64_t(t) + j]];
                    const V normal = upright(s, t);
                    own.normal[0][lane] = float(normal.x), own.normal[1][lane] = float(normal.y);
                    own.normal[2][lane] = float(normal.z);
                }
                const auto fill = [&](NearBlock& block, const int32_t* item, const int32_t* of, const int32_t* index, int width) {
                    block = none;
                    for (size_t lane = 0; lane < 8 && item[lane] >= 0; ++lane) {
                        const int32_t i = item[lane];
                        put(block, lane, i, range_of(s, v, index ? index + width * int64_t(i) : &i, width));
                        size_t k = 0;  // where its triangle is among the leaf's
                        while (k < 7 && own.item[k] != of[i]) ++k;
                        for (int j = 0; j < 3; ++j)
                            block.same[j][lane] = own.same[j][k], block.normal[j][lane] = own.normal[j][k];
                    }
                };
                for (int32_t b = plan.vertex_first[leaf]; b < plan.vertex_first[leaf + 1]; ++b)
                    fill(vertex[size_t(b)], plan.vertex + 8 * int64_t(b), plan.vertex_of, nullptr, 1);
                for (int32_t b = plan.edge_first[leaf]; b < plan.edge_first[leaf + 1]; ++b)
                    fill(edge[size_t(b)], plan.edge + 8 * int64_t(b), plan.edge_of, s.edge, 2);
            }
        });
        int64_t before = 0;
        for (int64_t blocks = leaves; blocks > 1 || first.empty();) {
            blocks = (blocks + 7) / 8;
            first.push_back(before), before += blocks;
        }
        upper.assign(size_t(before), none.box);
        tree = {leaves, triangle.get(), vertex.get(), edge.get(), plan.vertex_first, plan.edge_first,
                int(first.size()), first.data(), upper.data(), float(bent)};
        kernels.boxes(tree);
    }
    NearTree tree;

private:
    std::unique_ptr<NearBlock[]> triangle, vertex, edge;
    std::vector<int64_t> first;
    std::vector<NearBoxes> upper;
};

V speed(const float* v, int32_t i) { return {v[4 * int64_t(i)], v[4 * int64_t(i) + 1], v[4 * int64_t(i) + 2]}; }

constexpr double kBent = 0.5;  // cosine of the angle between neighbours that may touch in the coming frame

// Whether two of them that are `way` apart may meet before the frame ends, each pair of vertices moving straight on.
bool meet(V way, const float* v, const int32_t* a, int m, const int32_t* b, int n, const Reach& reach) {
    const double limit = double(reach.still) * reach.still;
    const double apart = dot(way, way);
    if (apart <= limit) return true;
    for (int i = 0; i < m; ++i)
        for (int j = 0; j < n; ++j) {
            const V moving = speed(v, a[i]) - speed(v, b[j]);
            const double fast = dot(moving, moving), closing = -dot(way, moving);
            // most never come so near, whatever the time they have: that is known without a root
            if (!(closing > 0) || (apart - limit) * fast > 1.000001 * closing * closing) continue;
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

NearOrder order_near(const Surface& s) {
    NearOrder out;
    std::vector<float> middle(size_t(3 * s.triangles));
    out.order.resize(size_t(s.triangles)), out.vertex_of.assign(size_t(s.vertices), -1), out.edge_of.assign(size_t(s.edges), -1);
    for (int64_t t = 0; t < s.triangles; ++t) {
        out.order[size_t(t)] = int32_t(t);
        const int32_t* c = s.triangle + 3 * t;
        for (int j = 0; j < 3; ++j) {
            middle[size_t(3 * t + j)] = s.x[4 * int64_t(c[0]) + j] + s.x[4 * int64_t(c[1]) + j] + s.x[4 * int64_t(c[2]) + j];
            int32_t &a = out.vertex_of[size_t(c[j])], &b = out.edge_of[size_t(s.sides[3 * t + j])];
            if (a < 0) a = int32_t(t);
            if (b < 0) b = int32_t(t);
        }
    }
    halve(middle, out.order.data(), out.order.data() + s.triangles);
    for (int64_t leaf = 0; leaf < (s.triangles + 7) / 8; ++leaf) {
        out.vertex_first.push_back(int32_t(out.vertex.size() / 8)), out.edge_first.push_back(int32_t(out.edge.size() / 8));
        for (int64_t k = 8 * leaf; k < std::min(s.triangles, 8 * leaf + 8); ++k)
            for (int j = 0; j < 3; ++j) {
                const int32_t t = out.order[size_t(k)], i = s.triangle[3 * int64_t(t) + j], e = s.sides[3 * int64_t(t) + j];
                if (out.vertex_of[size_t(i)] == t) out.vertex.push_back(i);
                if (out.edge_of[size_t(e)] == t) out.edge.push_back(e);
            }
        out.vertex.resize((out.vertex.size() + 7) / 8 * 8, -1), out.edge.resize((out.edge.size() + 7) / 8 * 8, -1);
    }
    out.vertex_first.push_back(int32_t(out.vertex.size() / 8)), out.edge_first.push_back(int32_t(out.edge.size() / 8));
    return out;
}

void find_near(const NearKernels& kernels, int threads, const Surface& s, const float* v, const NearPlan& plan,
               const Reach& reach, const int32_t* before, const float* side, int64_t known, Near& out) {
    if (!s.triangles) return;
    const auto one = [&s](int32_t a, int32_t b) { return s.same[a] == s.same[b]; };
    const auto free = [&s](int32_t i) { return s.x[4 * int64_t(i) + 3] > 0; };
    const Tree made(kernels, threads, s, v, plan, kBent);
    const NearTree& tree = made.tree;
    // triangles with a common vertex do not meet before they are bent
    const auto flat = [&](int32_t t, int32_t u) {
        if (dot(upright(s, t), upright(s, u)) < kBent) return false;
        const int32_t *a = s.triangle + 3 * int64_t(t), *b = s.triangle + 3 * int64_t(u);
        for (int k = 0; k < 9; ++k)
            if (one(a[k / 3], b[k % 3])) return true;
        return false;
    };
    struct Pair {
        int32_t a, b;
        float side;  // of a vertex and a triangle
        bool firm;
        bool operator<(const Pair& other) const { return a != other.a ? a < other.a : b < other.b; }
    };
    using Pairs = std::vector<Pair>;
    const auto side_of = [&](int32_t i, int32_t t, double above) {
        int64_t low = 0, high = known;  // the same pair in the frame before
        while (low < high) {
            const int64_t middle = (low + high) / 2;
            const int32_t* k = before + 2 * middle;
            if (k[0] < i || (k[0] == i && k[1] < t)) low = middle + 1;
            else high = middle;
        }
        if (low < known && before[2 * low] == i && before[2 * low + 1] == t) return side[low];
        return above < 0 ? -1.0f : 1.0f;
    };
    const auto try_corner = [&](int32_t i, int32_t t, Pairs& found) {
        const int32_t* c = s.triangle + 3 * int64_t(t);
        if (one(c[0], i) || one(c[1], i) || one(c[2], i) || !(free(i) || free(c[0]) || free(c[1]) || free(c[2]))) return;
        const V p = at(s, i), a = at(s, c[0]), b = at(s, c[1]), d = at(s, c[2]), way = p - nearest(p, a, b, d);
        if (!meet(way, v, &i, 1, c, 3, reach) || flat(plan.vertex_of[i], t)) return;
        found.push_back({i, t, side_of(i, t, dot(p - a, cross_product(b - a, d - a))),
                         dot(way, way) <= double(reach.firm) * reach.firm});
    };
    const auto try_cross = [&](int32_t e, int32_t f, Pairs& found) {
        const int32_t *p = s.edge + 2 * int64_t(e), *q = s.edge + 2 * int64_t(f);
        if (one(p[0], q[0]) || one(p[0], q[1]) || one(p[1], q[0]) || one(p[1], q[1])) return;
        if (!(free(p[0]) || free(p[1]) || free(q[0]) || free(q[1]))) return;
        V way;
        if (!between_edges(s, p, q, way) || !meet(way, v, p, 2, q, 2, reach)) return;
        if (!flat(plan.edge_of[e], plan.edge_of[f])) found.push_back({e, f, 0.0f, false});
    };
    struct Chunk {
        Pairs corner, cross;
    };
    std::vector<Chunk> chunks(size_t((tree.leaves + kChunk - 1) / kChunk));
    const auto work = [&](int64_t index) {
        Chunk& chunk = chunks[size_t(index)];
        const std::unique_ptr<int32_t[]> corner(new int32_t[size_t(2 * near_most(tree))]), cross(new int32_t[size_t(2 * near_most(tree))]);
        for (int64_t leaf = index * kChunk; leaf < std::min(tree.leaves, (index + 1) * kChunk); ++leaf) {
            int64_t corners = 0, crosses = 0;
            kernels.pairs(tree, reach, leaf, corner.get(), &corners, cross.get(), &crosses);
            for (int64_t n = 0; n < corners; ++n) try_corner(corner[2 * n], corner[2 * n + 1], chunk.corner);
            for (int64_t n = 0; n < crosses; ++n) {
                const int32_t e = cross[2 * n], f = cross[2 * n + 1];
                try_cross(std::min(e, f), std::max(e, f), chunk.cross);
            }
        }
    };
    each(int64_t(chunks.size()), threads, work);
    Pairs corner, cross;
    for (const Chunk& chunk : chunks) {
        corner.insert(corner.end(), chunk.corner.begin(), chunk.corner.end());
        cross.insert(cross.end(), chunk.cross.begin(), chunk.cross.end());
    }
    std::sort(corner.begin(), corner.end());
    std::sort(cross.begin(), cross.end());
    out.corner.reserve(4 * (corner.size() + cross.size()));  // edges come behind them
    out.side.reserve(corner.size()), out.cross.reserve(4 * cross.size());
    for (const Pair& found : corner) {
        const int32_t* c = s.triangle + 3 * int64_t(found.b);
        out.corner.insert(out.corner.end(), {found.a, c[0], c[1], c[2]});
        out.side.push_back(found.side);
        if (!found.firm) continue;
        out.key.insert(out.key.end(), {found.a, found.b});
        out.key_side.push_back(found.side);
    }
    for (const Pair& found : cross) {
        const int32_t *p = s.edge + 2 * int64_t(found.a), *q = s.edge + 2 * int64_t(found.b);
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
