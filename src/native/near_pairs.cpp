// Which parts of a surface may meet: boxes against eight boxes at a time. All tests err on the side of meeting.
#include "near_pairs.h"

#include "kernels.h"
#include "lanes.h"

namespace vt::VT_NS {

namespace {

const float kUnsure = 1e-5f;  // rounding of a cosine
const float kLoose = 2e-6f;   // metres: rounding of places

struct Box {
    float low[3], high[3], slow[3], fast[3];
};

VT_INLINE Box take(const NearBoxes& boxes, int lane) {
    Box out;
    for (int j = 0; j < 3; ++j) {
        out.low[j] = boxes.value[j][lane], out.high[j] = boxes.value[3 + j][lane];
        out.slow[j] = boxes.value[6 + j][lane], out.fast[j] = boxes.value[9 + j][lane];
    }
    return out;
}

// Which of eight boxes one may meet, a bit each.
VT_INLINE uint32_t meets(const Box& a, const NearBoxes& b, const Reach& reach) {
    f8 apart = all(-3e38f);
    const f8 none = all(0.0f), most = all(reach.moving);
    for (int j = 0; j < 3; ++j) {
        const f8 low = load8(b.value[j]), high = load8(b.value[3 + j]);
        const f8 slow = load8(b.value[6 + j]), fast = load8(b.value[9 + j]);
        // how far it may come back, and how far on, seen from the eight; neither is less than nothing
        const f8 back = larger(none, smaller(most, reach.time * (fast - all(a.slow[j]))));
        const f8 on = larger(none, smaller(most, reach.time * (all(a.fast[j]) - slow)));
        apart = larger(apart, larger(all(a.low[j]) - high - back, low - all(a.high[j]) - on));
    }
    return at_most(apart, reach.still);
}

// Which of eight stand on neighbours of the one's triangle that are not bent against it.
VT_INLINE uint32_t flat(const NearBlock& a, int lane, const NearBlock& b, float bent) {
    const f8 cosine = a.normal[0][lane] * load8(b.normal[0]) + a.normal[1][lane] * load8(b.normal[1]) +
                      a.normal[2][lane] * load8(b.normal[2]);
    const uint32_t even = at_most(all(0.0f) - cosine, -bent - kUnsure);
    if (!even) return 0;
    const int32_t own[3] = {a.same[0][lane], a.same[1][lane], a.same[2][lane]};
    return even & in_common(own, b.same);
}

VT_INLINE int next(uint32_t& bits) {
#if defined(__GNUC__) || defined(__clang__)
    const int lane = __builtin_ctz(bits);
#else
    int lane = 0;
    while (!(bits >> lane & 1)) ++lane;
#endif
    bits &= bits - 1;
    return lane;
}

// How far what is in two boxes may come towards each other in the end, back and on along each axis.
struct Way {
    float back[3], on[3];
};

Way way(const Box& a, const Box& b, const Reach& reach) {
    Way out;
    for (int j = 0; j < 3; ++j) {
        const float back = reach.time * (b.fast[j] - a.slow[j]), on = reach.time * (a.fast[j] - b.slow[j]);
        out.back[j] = back > 0 ? (back < reach.moving ? back : reach.moving) : 0;
        out.on[j] = on > 0 ? (on < reach.moving ? on : reach.moving) : 0;
    }
    return out;
}

// As `meets`, where no part moves otherwise than the wholes do.
VT_INLINE uint32_t within(const float low[3], const float high[3], const NearBoxes& b, float still) {
    f8 apart = larger(all(low[0]) - load8(b.value[3]), load8(b.value[0]) - all(high[0]));
    for (int j = 1; j < 3; ++j)
        apart = larger(apart, larger(all(low[j]) - load8(b.value[3 + j]), load8(b.value[j]) - all(high[j])));
    return at_most(apart, still + kLoose);
}

// Of some blocks and some others, which lie in `whole`, pairs that may meet; of a block with itself each pair once.
VT_INLINE int32_t* between(const NearTree& tree, const Reach& reach, const Box& whole, const Way& way, const NearBlock* a,
                           const NearBlock* a_end, const NearBlock* b, const NearBlock* b_end, bool once, int32_t* out) {
    float low[3], high[3];
    for (; a < a_end; ++a) {
        for (int j = 0; j < 3; ++j) low[j] = whole.low[j] - way.on[j], high[j] = whole.high[j] + way.back[j];
        uint32_t rows = within(low, high, a->box, reach.still);
        while (rows) {
            const int lane = next(rows);
            for (int j = 0; j < 3; ++j) {
                low[j] = a->box.value[j][lane] - way.back[j], high[j] = a->box.value[3 + j][lane] + way.on[j];
            }
            for (const NearBlock* c = once ? a : b; c < b_end; ++c) {
                uint32_t some = within(low, high, c->box, reach.still);
                if (once && c == a) some &= ~0u << (lane + 1);
                if (some) some &= ~flat(*a, lane, *c, tree.bent);
                if (some) some &= meets(take(a->box, lane), c->box, reach);
                while (some) {
                    const int32_t other = c->item[next(some)];
                    out[0] = a->item[lane], out[1] = other;
                    out += 2;
                }
            }
        }
    }
    return out;
}

void join(const NearBoxes& from, NearBoxes& to, int lane) {
    for (int c = 0; c < 12; ++c) {
        float value = from.value[c][0];
        const bool least = c / 3 % 2 == 0;
        for (int l = 1; l < 8; ++l) {
            const float other = from.value[c][l];
            value = (least ? other < value : other > value) ? other : value;
        }
        to.value[c][lane] = value;
    }
}

}  // namespace

void near_boxes(const NearTree& tree) {
    for (int64_t k = 0; k < tree.leaves; ++k) join(tree.triangle[k].box, tree.upper[k / 8], int(k % 8));
    for (int level = 1; level < tree.levels; ++level) {
        const int64_t begin = tree.first[level - 1], count = tree.first[level] - begin;
        for (int64_t k = 0; k < count; ++k) join(tree.upper[begin + k], tree.upper[tree.first[level] + k / 8], int(k % 8));
    }
}

void near_pairs(const NearTree& tree, const Reach& reach, int64_t leaf, int32_t* corner, int64_t* corners, int32_t* cross,
                int64_t* crosses) {
    struct Place {
        int level;
        int64_t block;
    } stack[8 * 24];
    const NearBlock *t = tree.triangle + leaf, *v = tree.vertex + tree.vertex_first[leaf];
    const NearBlock *v_end = tree.vertex + tree.vertex_first[leaf + 1];
    const NearBlock *e = tree.edge + tree.edge_first[leaf], *e_end = tree.edge + tree.edge_first[leaf + 1];
    const Box own = take(tree.upper[leaf / 8], int(leaf % 8));
    int32_t *c = corner, *x = cross;
    int depth = 0;
    stack[depth++] = {tree.levels - 1, 0};
    while (depth) {
        const Place place = stack[--depth];
        const NearBoxes& boxes = tree.upper[tree.first[place.level] + place.block];
        uint32_t some = meets(own, boxes, reach);
        while (some) {
            const int lane = next(some);
            const int64_t child = 8 * place.block + lane;
            if (((child + 1) << 3 * place.level) - 1 < leaf) continue;  // each pair once: all leaves below it are earlier
            if (place.level) {
                stack[depth++] = {place.level - 1, child};
            } else if (child == leaf) {
                const Way to = way(own, own, reach);
                c = between(tree, reach, own, to, v, v_end, t, t + 1, false, c);
                x = between(tree, reach, own, to, e, e_end, e, e_end, true, x);
            } else {
                const Box other = take(boxes, lane);
                const Way to = way(own, other, reach), from = way(other, own, reach);
                const NearBlock *u = tree.triangle + child, *i = tree.vertex + tree.vertex_first[child];
                const NearBlock *i_end = tree.vertex + tree.vertex_first[child + 1];
                const NearBlock *f = tree.edge + tree.edge_first[child], *f_end = tree.edge + tree.edge_first[child + 1];
                c = between(tree, reach, other, to, v, v_end, u, u + 1, false, c);
                c = between(tree, reach, own, from, i, i_end, t, t + 1, false, c);
                x = between(tree, reach, other, to, e, e_end, f, f_end, false, x);
            }
        }
    }
    *corners = (c - corner) / 2, *crosses = (x - cross) / 2;
}

}  // namespace vt::VT_NS
