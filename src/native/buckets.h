// Vertices laid out for the kernels of skinning, as Python holds them.
#pragma once
#include <vector>

#include "face.h"
#include "kernels.h"

namespace vt::face {

// Vertices whose positions and weights stay in the first level cache for all frames; of one frame a longer run, which
// the processor reads ahead in.
const int64_t kBlock = 512, kRun = 2048;

inline int64_t blocks(int64_t count, int64_t block) { return (count + block - 1) / block; }
inline int64_t stop(int64_t i, int64_t count, int64_t block) { return (i + 1) * block < count ? (i + 1) * block : count; }

// Buckets with what operators hang on them, and the arrays that they point into.
struct Laid {
    vt::Bucket bucket;
    bool lanes;
    const int32_t *base, *set;  // of each place
    const float *center, *carry;
};

struct Buckets {
    std::vector<Laid> laid;
    std::vector<std::shared_ptr<void>> arrays;
    int64_t count = 0;

    // Calls work(laid, first vertex, stop) for all parts, on some threads; a vertex costs `cost` times as much as in linear
    // blending.
    template <class F>
    void each_part(int64_t frames, int threads, int cost, F&& work) const {
        const int64_t block = frames > 1 ? kBlock : kRun;
        int64_t parts = 0;
        for (const Laid& l : laid) parts += blocks(l.bucket.count, block);
        each(parts, vt::threads_for(count * cost * (frames < 4 ? frames : 4), threads), [&](int64_t i) {
            const Laid* l = laid.data();
            for (int64_t n; i >= (n = blocks(l->bucket.count, block)); ++l) i -= n;
            work(*l, i * block, stop(i, l->bucket.count, block));
        });
    }
};

// Adds the class to the module.
void bind_buckets(nb::module_& m);

}  // namespace vt::face
