#include "threads.h"

#include <atomic>
#include <chrono>
#include <condition_variable>
#include <memory>
#include <mutex>
#include <system_error>
#include <thread>
#include <vector>
#if !defined(_WIN32)
#include <pthread.h>
#endif
#if defined(__x86_64__) || defined(_M_X64)
#include <immintrin.h>
#endif

namespace vt {
namespace {

void pause() {
#if defined(__x86_64__) || defined(_M_X64)
    _mm_pause();
#elif defined(__aarch64__) && defined(__GNUC__)
    asm volatile("yield");
#endif
}

// Looks at `ready` for 20 microseconds: a system call to sleep and another to wake cost about as much.
template <class F>
bool soon(F&& ready) {
    const auto end = std::chrono::steady_clock::now() + std::chrono::microseconds(20);
    do {
        for (int i = 0; i < 16; ++i) {
            if (ready()) return true;
            pause();
        }
    } while (std::chrono::steady_clock::now() < end);
    return ready();
}

// Outlives the call: a helper that the system lets run late finds nothing left and touches nothing else.
struct Job {
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
    void wait() {
        const auto all = [this] { return done.load(std::memory_order_acquire) == count; };
        if (soon(all)) return;
        std::unique_lock<std::mutex> lock(mutex);
        finished.wait(lock, all);
    }
};

struct Pool {
    std::mutex mutex;  // guards all but `serial`, which is only written under it
    std::condition_variable wake;
    std::atomic<uint64_t> serial{0};  // changes with every job and at the end
    std::shared_ptr<Job> job;
    int places = 0;  // helpers that the job may still take
    int sleeping = 0;
    bool ended = false;
    std::vector<std::thread> helpers;

    void help() {
        uint64_t seen = 0;
        std::unique_lock<std::mutex> lock(mutex);
        while (!ended) {
            if (job && places > 0) {
                const std::shared_ptr<Job> mine = job;
                --places;
                seen = serial;
                lock.unlock();
                mine->run();
                lock.lock();
                continue;
            }
            seen = serial;
            lock.unlock();
            const bool called = soon([&] { return serial.load(std::memory_order_acquire) != seen; });
            lock.lock();
            if (called) continue;
            ++sleeping;
            wake.wait(lock, [&] { return serial != seen; });
            --sleeping;
        }
    }

    // False if the helpers are busy with another call's job.
    bool offer(const std::shared_ptr<Job>& offered, int wanted) {
        std::unique_lock<std::mutex> lock(mutex);
        if (job || ended) return false;
        while (int(helpers.size()) < wanted) {
            try {
                helpers.emplace_back([this] { help(); });
            } catch (const std::system_error&) {
                break;  // no more threads to be had: the ones there are do it all
            }
        }
        job = offered;
        places = wanted;
        serial.fetch_add(1, std::memory_order_release);
        const bool asleep = sleeping > 0;
        lock.unlock();
        if (asleep) wanted == 1 ? wake.notify_one() : wake.notify_all();
        return true;
    }
    void withdraw() {
        std::lock_guard<std::mutex> lock(mutex);
        job.reset();
        places = 0;
    }
    void end() {
        {
            std::lock_guard<std::mutex> lock(mutex);
            ended = true;
            serial.fetch_add(1, std::memory_order_release);
        }
        wake.notify_all();
        for (std::thread& helper : helpers) helper.join();
        helpers.clear();
    }
};

// Never freed: a thread may be in it when the process ends, and in the child of a fork nobody can say in what state
// its mutex is.
std::atomic<Pool*> pool{nullptr};
std::atomic<bool> stopped{false};

Pool* helpers() {
    Pool* now = pool.load(std::memory_order_acquire);
    if (now || stopped) return now;
    Pool* made = new Pool;
    if (!pool.compare_exchange_strong(now, made)) {
        delete made;
        return now;
    }
#if !defined(_WIN32)
    static const int registered = pthread_atfork(nullptr, nullptr, [] { pool.store(nullptr); });
    (void)registered;
#endif
    return made;
}

}  // namespace

void share(int64_t count, int threads, void (*work)(void*, int64_t), void* context) {
    if (threads > count) threads = int(count);
    Pool* const some = threads > 1 ? helpers() : nullptr;
    if (some) {
        const auto job = std::make_shared<Job>();
        job->count = count;
        job->work = work;
        job->context = context;
        if (some->offer(job, threads - 1)) {
            job->run();
            job->wait();
            some->withdraw();
            return;
        }
    }
    for (int64_t i = 0; i < count; ++i) work(context, i);
}

int threads_for(int64_t items, int asked) {
    if (asked > 0) return asked < 64 ? asked : 64;
    if (items < 30000) return 1;
    static const unsigned cores = std::thread::hardware_concurrency();
    return cores < 1 ? 1 : cores > 8 ? 8 : int(cores);
}

void stop_helpers() {
    stopped = true;
    if (Pool* last = pool.exchange(nullptr)) last->end();
}

}  // namespace vt
