// A tree over the triangles of a surface: boxes of places and velocities, eight side by side.
#pragma once
#include <cstdint>

namespace vt {

// What is near: things that are, or come, within so many metres of each other when they move straight on for a time, or as
// far as the limit.
struct Reach {
    float still;   // metres
    float time;    // seconds
    float moving;  // metres
    float firm;    // metres: sides of what is nearer are remembered
};

// Lowest and highest places, then velocities, of eight things: x y z each. Lanes without one are boxes of nothing.
struct NearBoxes {
    float value[12][8];
};

// Eight triangles, or vertices, or edges, and of each the triangle that stands for it.
struct NearBlock {
    NearBoxes box;
    float normal[3][8];
    int32_t same[3][8];  // numbers of its corners: triangles with a common one are neighbours
    int32_t item[8];     // -1: none
};

struct NearTree {
    int64_t leaves;
    const NearBlock* triangle;  // (leaves,)
    const NearBlock* vertex;    // those of each leaf's triangles one after the other: from vertex_first[leaf]
    const NearBlock* edge;
    const int32_t *vertex_first, *edge_first;  // (leaves + 1,)
    int levels;            // above the leaves; the highest is one block
    const int64_t* first;  // (levels,) blocks before each level
    NearBoxes* upper;      // eight leaves a block, then eight of those
    float bent;            // cosine: neighbours that are less bent do not meet
};

// What near_pairs may find at most of one leaf, of vertices with triangles and of edges with edges.
inline int64_t near_most(const NearTree& tree) { return 576 * tree.leaves; }

}  // namespace vt
