// Joint matrices to dual quaternions whose signs agree.
#pragma once
#include <cstdint>

namespace vt {

// Largest deviation of the 3x3 parts of (count,4,4) from rotations; 2 or more where one mirrors.
double deviation(int64_t count, const double* matrix);

// What the operators blend, of matrices (frames, joints, 4, 4). Pointers to results may be null where not wanted.
struct MotionJob {
    int64_t frames, joints, edges, lefts, pairs;
    const double* matrix;
    const int32_t* tree;  // (edges, 2) along which signs are made to agree, ordered outward
    const int32_t* left;  // (lefts, 2) pairs that are looked at besides
    const int32_t* pair;  // (pairs, 2)
    bool follow;          // see choose_signs in deform/motions.py, the twin
    double* memory;       // (edges, 4) relative turns of the frame before, the first NaN when there was none; updated
    float* dual;          // (frames, joints + 1, 8) dual quaternions, the last of which does not move
    float* twist;         // (frames, pairs, 8) half of log(M_a^-1 M_b)
    uint8_t* agree;       // (frames,) whether signs agree on all pairs
};

// The doubles that `motion_tables` needs for itself.
int64_t motion_scratch(const MotionJob& job);
void motion_tables(const MotionJob& job, double* scratch);

// How much of the motion each set of joint pairs gets, (frames, sets): from 0 to 1 as the largest angle between two of
// its joints goes from `low` to `high` (pairs,), smoothly, or at once with `hard`. Sets are rows (sets + 1,) of `member`.
void turn_shares(const MotionJob& job, const double* low, const double* high, bool hard, int64_t sets, const int32_t* row,
                 const int32_t* member, double* scratch, float* out);

}  // namespace vt
