// Signatures of the kernels, and what they take. Pointers are C-contiguous arrays that belong to the caller; nothing is
// checked here. VT_NS is the namespace of one instruction set.
#pragma once
#include <cstdint>

#include "cloth.h"
#include "layers.h"
#include "near_pairs.h"

namespace vt {

// Vertices with the same padded number of influences, put together at bind time. Plain layout (linear): a row per
// vertex. Lane layout: groups of eight vertices, each value of the row as eight lanes.
struct Bucket {
    int influences;         // per vertex, padded with weight 0; 0 (plain only): rows of any length
    int64_t count;          // vertices
    const float* rest;      // (count, 3) or (groups, 3, 8)
    const int32_t* joint;   // (count, influences), (row[count],), (groups, influences, 8), or when shared
                            // (groups, influences): place of the joint in the table, in floats
    const float* weight;    // (count, influences), (row[count],) or (groups, influences, 8)
    const int32_t* row;     // (count + 1,) when influences is 0
    const int32_t* target;  // (count,) output vertex of each, or null: vertex i is output i; a repeated one is padding
    bool shared;            // lane layout: the eight vertices of a group have the same joints
};

// What `rigid` mixes with linear blending, or hangs on it; tables of linear blending have one joint more, which rests.
struct LinearShare {
    const float* table = nullptr;    // (frames, joints, 16), or null: nothing of the following is used
    const float* share = nullptr;    // (frames, sets) of the rigid motion in the result, or null; with centres, of the
                                     // motion about them in a result that is else the rigid motion alone
    int64_t share_stride = 0;        // between frames
    const int32_t* set = nullptr;    // (groups, 8) the set of each vertex
    const float* center = nullptr;   // (groups, 3, 8) or null: the rigid motion only turns p about this point, which
    const float* carry = nullptr;    // (groups, influences, 8) linear blending with these weights moves
};

// Rigid blending of `frames` frames into out (frames, vertices, 3), or (frames, vertices, 12) with `whole`.
struct RigidJob {
    int64_t frames, vertices;
    const float* table;      // (frames, rows, 8): dual quaternions of joints, or half twists
    int64_t rows;
    int steps;               // Karcher steps after the dual quaternion blend
    const uint8_t* agree;    // (frames,) whether signs agree already; null: they do
    bool twists;             // exp of the sum of the table's half twists, after the base motion
    const float* bases;      // (frames, base_rows, 8) dual quaternions, or null for none
    int64_t base_rows;
    const int32_t* base;     // (groups, 8) place in `bases` of each vertex
    LinearShare linear;      // not with twists
    int64_t joints;          // of the table of linear blending
    float* out;
    bool whole;
};

// Contours that take shares of the rotations of chains of joints; see vitruvian.deform.contours.
struct ContourProgram {
    int64_t links, contours, steps;
    const double* center;        // (joints, 3)
    const int32_t* link;         // (links, 2) a joint or -1, and the joint that turns against it
    const double* axis;          // (links, 3) unit: of its twist
    const double* bone;          // (links, 3) unit: along the limb
    const int32_t* base;         // (contours,) the joint that moves all of the contour, or -1
    const int32_t* row;          // (contours + 1,) its steps
    const int32_t* step;         // (n,) link of each step
    const double* swing;         // (n,) share of the rotation
    const double* twist;         // (n,) share of its part about the axis; NaN: not split
    const double* middle;        // (contours, 3) centre at rest
    const double* along;         // (contours, 3) unit normal at rest
    const int32_t* frame;        // (contours,) joint that the surface hangs on
    const double* diversion;     // (contours,)
    const double* mitre;         // (contours,)
    const int32_t* mitre_link;   // (contours,)
    const double* mitre_share;   // (contours,) part of the bend that the contour lacks to the bone it lies on
    const double* bulge;         // (contours,)
    const int32_t* bulge_link;   // (contours,)
    const double* recentre;      // (contours,)
    const int32_t* limb;         // (contours,) the joint that turns the bone that the contour lies on, or -1
    const double* way;           // (contours, 3) unit: along that bone
    const double* aside;         // (contours, 3) from the bone to the contour's centre, across it
    const double* seam;          // (contours,) where the ramp's seam is along that bone, from the joint on
    const int32_t* same;         // (contours,) an earlier contour that takes the same steps from the same base, or -1
    const uint8_t* whole;        // (links,) whether some step takes a share of the turn as a whole, not split
};

// One hand; see vitruvian.deform.hands.HandProgram.
struct HandJob {
    int64_t links, vertices, blocks, gaps;
    const int32_t *before, *near, *far, *previous;  // (links,) joints, -1: none; the link that ends where one begins
    const double *start, *end, *axis_near, *axis_far, *normal_near, *normal_far;  // (links, 3)
    const int32_t* vertex;                                                        // (vertices,)
    const double* whole;                                                          // (vertices,) share of the hand
    const int32_t *block_link, *block_vertex;  // (blocks,), (blocks, 8): terms of one link
    const float* term;                         // (blocks, 13, 8): share, along, two shifts, coefficients of the frames at
                                               // the near and the far end, local x y z, three swells, press
    const int32_t *pair, *gap_vertex;          // (gaps, 2), (gaps, 8): gap terms of two links
    const float* gap;                          // (gaps, 13, 8): share, across, along both links, coefficients of the frames
                                               // at the near and the far end of both, local x y z, fold, width
};

// What poses are asked for and what may change; see vitruvian.motion.solver.
struct PoseProblem {
    int64_t joints, columns, wishes;
    const int32_t* parent;      // (joints,) parents first; joint 0 is the one that shifts
    const double* center;       // (joints, 3)
    const double* translation;  // (joints, 3); the first is not used
    const double* stretch;      // (joints, 3, 3) or null
    const double* frame;        // (joints, 4) limitOrientation
    const double* box;          // (joints, 3, 2) limits
    const uint8_t* limited;     // (joints,) described by angles
    const int32_t* column;      // (columns, 2) joint, or -1 for the shift, and axis; those of a joint are neighbours
    const double* give;         // (columns,) share of a step each takes
    const int32_t *kind, *joint;  // (wishes,) 0 point, 1 plane, 2 turn, 3 look
    const double *point, *axis;   // (wishes, 3)
    const double* prior;          // (columns,) weights, or null
    double tolerance, damping, idle;
    int iterations;
};

// One frame of it: rotation (joints, 4), shift (3) and angle (joints, 3) are changed.
struct PoseFrame {
    double *rotation, *shift, *angle;
    const double *place, *weight;                             // (wishes, 4), (wishes,)
    const double *prior_rotation, *prior_angle, *prior_shift;  // as the state, or null
    double* error;                                            // (wishes, 3) out
};

}  // namespace vt

#define VT_DECLARE(NS)                                                                                                \
    namespace vt::NS {                                                                                                \
    void forward_kinematics(int64_t first, int64_t last, int64_t joints, const int32_t* parent, const double* center, \
                            const double* rotation, const double* translation, int64_t translation_stride,            \
                            const double* root, const double* stretch, const double* binding, double* out);           \
    void linear_table(int64_t count, const double* matrix, float* out);                                               \
    void linear(const Bucket& bucket, int64_t first, int64_t last, int64_t frames, int64_t joints, const float* table, \
                float* out, int64_t stride, bool whole);                                                              \
    void linear_lanes(const Bucket& bucket, int64_t first, int64_t last, int64_t frames, int64_t joints,             \
                      const float* table, float* out, int64_t stride, bool whole);                                    \
    void touch(const Bucket& bucket, int64_t first, int64_t last, const float* table, float* out);                    \
    void rigid(const Bucket& bucket, int64_t first, int64_t last, const RigidJob& job);                               \
    void face_normals(int64_t first, int64_t last, int64_t count, const float* points, const int32_t* triangle,       \
                      float* out);                                                                                    \
    void vertex_normals(int64_t first, int64_t last, const float* normal, const int32_t* row, const int32_t* face,    \
                        const int32_t* point, const int32_t* order, float* out);                                      \
    void contour_links(const double* matrix, const ContourProgram& program, bool follow, bool fresh, double* before,  \
                       double* out);                                                                                  \
    void contour_turns(const ContourProgram& program, const double* links, double* out);                              \
    void contour_motions(const double* matrix, const ContourProgram& program, const double* links,                    \
                         const double* turns, double* out);                                                           \
    void hand(const double* matrix, const HandJob& job, double* scratch, float* out);                                 \
    int64_t pose_room(const PoseProblem& problem);                                                                    \
    int solve_pose(const PoseProblem& problem, const PoseFrame& frame, double* room);                                 \
    void cloth_frame(const ClothProgram& program, const ClothFrame& frame, const ClothBody& body,                     \
                     const ClothTouch& touch);                                                                        \
    void cloth_clear(const ClothBody& body, int64_t count, const int32_t* vertex, float deep, float* x);              \
    void cloth_feet(const ClothFeet& feet, int64_t first, int64_t last);                                              \
    void cloth_limbs(const ClothLimbs& job);                                                                          \
    void cloth_pinch(const ClothBody& body, const ClothPinch& job);                                                   \
    void near_boxes(const NearTree& tree);                                                                            \
    void near_pairs(const NearTree& tree, const Reach& reach, int64_t leaf, int32_t* corner, int64_t* corners,        \
                    int32_t* cross, int64_t* crosses);                                                                \
    }
VT_DECLARE(base)
VT_DECLARE(v3)
