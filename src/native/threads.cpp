#include "threads.h"

#include <atomic>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <system_error>
#include <thread>

namespace vt {
namespace {

// Outlives the call: a helper that the system starts late finds nothing left and touches nothing else.
struct Shared {
    std::atomic<int64_t> next{0}, done{0};
    int64_t count = 0;
    void (*work)(void*, int64_t) = nullptr;
    void* context = nullptr;
    std::mutex mutex;
    std::condition_variable finished;

    void run() {
        int64_t own = 0;
        for (int64_t i; (i = next.fetch_add(1, std::memory_order_relaxed)) < count; ++own) work(context, i);
        if (own && done.fetch_add(own, std::memory_order_acq_rel) + own == count) {
            std::lock_guard<std::mutex> lock(mutex);
            finished.notify_one();
        }
    }
};

}  // namespace

void share(int64_t count, int threads, void (*work)(void*, int64_t), void* context) {
    if (threads > count) threads = int(count);
    if (threads <= 1) {
        for (int64_t i = 0; i < count; ++i) work(context, i);
        return;
    }
    const auto shared = std::make_shared<Shared>();
    shared->count = count;
    shared->work = work;
    shared->context = context;
    for (int t = 1; t < threads; ++t) {
        try {
            std::thread([shared] { shared->run(); }).detach();
        } catch (const std::system_error&) {
            break;  // no more threads to be had: the ones there are do it all
        }
    }
    shared->run();
    std::unique_lock<std::mutex> lock(shared->mutex);
    shared->finished.wait(lock, [&] { return shared->done.load(std::memory_order_acquire) == count; });
}

int threads_for(int64_t items, int asked) {
    if (asked > 0) return asked;
    if (items < 30000) return 1;
    const unsigned cores = std::thread::hardware_concurrency();
    return cores < 1 ? 1 : cores > 8 ? 8 : int(cores);
}

}  // namespace vt
