// What of a surface is near to what of it, and what cuts what.
#pragma once
#include <cstdint>
#include <vector>

#include "near_pairs.h"

namespace vt {

struct Surface {
    const float* x;  // (n, 4)
    int64_t vertices;
    const int32_t* triangle;  // (m, 3)
    int64_t triangles;
    const int32_t* edge;  // (e, 2)
    int64_t edges;
    const int32_t* sides;  // (m, 3) which edges a triangle has, corner k to k + 1; of what is near only
    const int32_t* same;  // (n,) vertices with the same number are sewn to each other, or will be
};

struct Near {
    std::vector<int32_t> corner;  // (c, 4) vertex and triangle's vertices, sorted by vertex, then triangle
    std::vector<int32_t> key;     // (r, 2) vertex and triangle of those nearer than `firm`, whose sides are to be remembered
    std::vector<float> key_side;  // (r,)
    std::vector<float> side;      // (c,) on which side of the triangle the vertex is
    std::vector<int32_t> cross;   // (k, 4) ends of two edges, sorted
};

// What the search works by: eight triangles a leaf, which lie side by side, and the vertices and edges that are looked at
// with each, eight a block. Any such plan finds the same.
struct NearPlan {
    const int32_t* order;                      // (m,) triangles
    const int32_t *vertex_first, *edge_first;  // (leaves + 1,) the first block of each leaf
    const int32_t *vertex, *edge;              // (blocks, 8), -1: none
    const int32_t *vertex_of, *edge_of;        // (n,), (e,) the triangle with which each is looked at: its first
};
struct NearOrder {
    std::vector<int32_t> order, vertex_first, edge_first, vertex, edge, vertex_of, edge_of;
};
NearOrder order_near(const Surface& surface);

// The two halves of the search that come in several instruction sets: see near_pairs.cpp.
struct NearKernels {
    void (*boxes)(const NearTree& tree);
    void (*pairs)(const NearTree& tree, const Reach& reach, int64_t leaf, int32_t* corner, int64_t* corners, int32_t* cross,
                  int64_t* crosses);
};

// Vertices and triangles without a common vertex, or one that is the `same`, that are within reach, and such edges; v
// (n, 4) m/s. `before` (b, 2) sorted keys with their sides (b,): a pair that is among them keeps its side.
// The same for any number of threads.
void find_near(const NearKernels& kernels, int threads, const Surface& surface, const float* v, const NearPlan& plan,
               const Reach& reach, const int32_t* before, const float* side, int64_t known, Near& out);

// (k, 2) edges and triangles without a common vertex that cut each other.
void find_cuts(const Surface& surface, std::vector<int32_t>& out);

}  // namespace vt
