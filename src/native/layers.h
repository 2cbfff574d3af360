// Cloth in layers one and two: what each frame of it takes. See vitruvian.cloth.worn.
#pragma once
#include <cstdint>

namespace vt {

// Vertices in the frames of their feet on a surface.
struct ClothFeet {
    const float *point, *normal;    // (V, 3)
    const int32_t* corner;          // (n, 3) of the triangle
    const float *share, *offset;    // (n, 3)
    float *foot, *up, *out;         // (n, 3) where the feet are, their normals, where the vertices are
};

// Vertices that hang about limbs, each in a half-ball about its foot.
struct ClothLimbs {
    int64_t count;
    const int32_t *vertex, *bone;   // (count,) which row of foot and up, which of axis
    const float *radius, *room, *least;  // (count,) metres: of the limb, to the cloth around it, and at least from the skin
    const float *foot_before, *foot, *up;  // (n, 3)
    const float* axis;              // (bones, 3)
    const int32_t *row, *neighbour; // (count + 1,), (row[count],) those that each folds with
    float step, damping, friction, smooth, drag, density;
    float gravity[3], wind[3];
    float *r, *v;                   // (count, 3) from the foot, and m/s; changed
    float *next, *reach;            // (count, 3), (count,) scratch
};

// Vertices between the skin that they are bound to and skin that comes to face it.
struct ClothPinch {
    int64_t count;
    const int32_t* vertex;          // (count,) those of one vertex follow each other
    const float *foot, *up;         // (n, 3)
    float far, back;                // metres from where it is looked for beyond which it is left; share that comes back
    float *part, *x;                // (n,) share of the way from its foot that each had, (n, 3); changed
};

}  // namespace vt
