// Joint matrices to dual quaternions whose signs agree.
#pragma once
#include <cstdint>

namespace vt {

// Largest deviation of the 3x3 parts of (count,4,4) from rotations; 2 or more where one mirrors.
double deviation(int64_t count, const double* matrix);

// Matrices (frames, joints, 4, 4) to dual quaternions (frames, joints + 1, 8), the last of which does not move. Signs
// agree along `tree` (edges, 2), ordered outward. agree[f] says whether they do on the pairs `left` (lefts, 2) as well.
// `follow`: see choose_signs in deform/motions.py, the twin. `scratch` holds 4 (joints + 1) + 8 edges doubles.
void dual_table(int64_t frames, int64_t joints, const double* matrix, int64_t edges, const int32_t* tree, int64_t lefts,
                const int32_t* left, bool follow, float* out, uint8_t* agree, double* scratch);

}  // namespace vt
