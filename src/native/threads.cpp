#include "threads.h"

#include <atomic>
#include <system_error>
#include <thread>
#include <vector>

namespace vt {

void share(int64_t count, int threads, void (*work)(void*, int64_t), void* context) {
    if (threads > count) threads = int(count);
    std::atomic<int64_t> next{0};
    auto loop = [&] {
        for (int64_t i; (i = next.fetch_add(1, std::memory_order_relaxed)) < count;) work(context, i);
    };
    std::vector<std::thread> helpers;
    for (int t = 1; t < threads; ++t) {
        try {
            helpers.emplace_back(loop);
        } catch (const std::system_error&) {
            break;  // no more threads to be had: the ones there are do it all
        }
    }
    loop();
    for (auto& helper : helpers) helper.join();
}

int threads_for(int64_t items, int asked) {
    if (asked > 0) return asked;
    if (items < 30000) return 1;
    const unsigned cores = std::thread::hardware_concurrency();
    return cores < 1 ? 1 : cores > 8 ? 8 : int(cores);
}

}  // namespace vt
