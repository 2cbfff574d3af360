// Signatures of the kernels; VT_NS is the namespace of one instruction set. Pointers are C-contiguous arrays that belong
// to the caller; nothing is checked here.
#pragma once
#include <cstdint>

namespace vt {

// Vertices with the same padded number of influences, joined up at bind time. `influences` 0: rows of any length.
struct Bucket {
    int influences;        // 1, 2, 4, 8; 0 for rows
    int64_t count;         // vertices
    const float* rest;     // (count, 3)
    const int32_t* joint;  // (count, influences), or (rows[count],); the largest weight first
    const float* weight;   // as joint
    const int32_t* row;    // (count + 1,) when influences is 0
    const int32_t* target; // (count,) output vertex of each, or null: vertex i is output i
};

// Which vertices of a bucket to do, and how much of the result to use.
struct Choice {
    const int32_t* pick;  // (picked,) into the bucket, or null for all
    int64_t picked;
    const float* mix;     // (picked,) out = (1 - mix) out + mix result; null: out = result
};

}  // namespace vt

#define VT_DECLARE(NS)                                                                                                \
    namespace vt::NS {                                                                                                \
    void forward_kinematics(int64_t first, int64_t last, int64_t joints, const int32_t* parent, const double* center, \
                            const double* rotation, const double* translation, int64_t translation_stride,            \
                            const double* root, const double* stretch, const double* binding, double* out);           \
    }
VT_DECLARE(base)
VT_DECLARE(v3)
