// The cloth solver's substeps. Positions and velocities are rows of four floats: x, y, z, inverse mass (0: held). One row
// more than there are vertices: lanes without a constraint take it. See vitruvian.cloth.solver.
#pragma once
#include <cstdint>

namespace vt {

// Constraints in groups of eight that share no vertex; fixed order.
struct ClothProgram {
    int64_t vertices;
    int64_t membranes;              // groups
    const int32_t* membrane;        // (groups, 3, 8) vertices of triangles
    const float* membrane_rest;     // (groups, 8, 8) inverse rest matrix a b c d, compliance uu uv vv ss over the area
    int64_t hinges;                 // groups
    const int32_t* hinge;           // (groups, 4, 8) ends of the edge, then what is opposite on either side
    const float* hinge_rest;        // (groups, 5, 8) factors of the four, compliance
    int64_t shapes;                 // groups
    const int32_t* shape;           // (groups, 6, 8) corners of a triangle, then what is opposite across its edges
    const float* shape_rest;        // (groups, 19, 8) three sums of the six, compliance
    int64_t tethers;                // groups
    const int32_t* tether;          // (groups, 2, 8)
    const float* tether_rest;       // (groups, 1, 8) what they may be apart
};

// The body during one frame.
struct ClothBody {
    int64_t triangles;              // 0: none
    const int32_t* triangle;        // (t, 3)
    const int32_t* neighbour;       // (t, 3) across the edge from corner k to k + 1, or -1
    const float* before;            // (V, 6) position and normal at the frame's begin
    const float* after;             // (V, 6) at its end
    float offset;                   // metres kept from the skin
    float most;                     // metres that a vertex is pushed out a substep at most
    float reach;                    // metres: no vertex of the body moves farther in the frame
    int32_t* nearest;               // (n,) triangle that each vertex was nearest to
    const float* friction;          // (n,) of each vertex
};

// Cloth that is near cloth: vertex and triangle, or edge and edge.
struct ClothTouch {
    int64_t count;
    const int32_t* vertex;          // (count, 4) a vertex and a triangle, or the ends of two edges
    const float* side;              // (corners,) 1 or -1: on which side of the triangle
    const float* gap;               // (count,) metres to keep
    const float* friction;          // (count,)
    int64_t corners;                // the first of them are vertices and triangles
    float* due;                     // (count,) scratch: what their vertices may come before they can touch
    float* first;                   // (count - corners, 3) scratch: from the second edge to the first as the frame begins
};

struct ClothFrame {
    float* x;                       // (n + 1, 4)
    float* v;                       // (n + 1, 4)
    float* p;                       // (n + 1, 4) scratch: positions at a substep's begin
    float* q;                       // (n + 1, 4) scratch: where velocities alone would lead
    float* d;                       // (n + 1, 4) what the multipliers below move
    float* membrane_force;          // (groups, 3, 8) multipliers, kept from substep to substep
    int bends;                      // what bends is worked off in one of so many substeps
    float carry;                    // share of them that the next substep begins with
    float* slack;                   // (n,) scratch
    float* room;                    // (n,) scratch: metres to the rim of the body's triangle that a vertex lies on
    float* plane;                   // (n, 4) scratch: the plane of that triangle
    float* path;                    // (n,) scratch: how far vertices have come in this frame
    float* seen;                    // (n, 4) scratch: where they were when that was measured
    float step;                     // seconds of a substep
    int substeps;
    float gravity[3];
    float damping;                  // 1/s
    int64_t pins;
    const int32_t* pin;             // (pins,)
    const float* pin_path;          // (pins, 6) at the frame's begin and end
    int64_t pairs;
    const int32_t* pair;            // (pairs, 2)
    const float* pair_rest;         // (pairs, 3) metres apart at the frame's begin and end, compliance
    float limit;                    // metres that a vertex moves in a substep at most, 0: any
};

}  // namespace vt
