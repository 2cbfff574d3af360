// Work shared by a few threads.
#pragma once
#include <cstdint>

namespace vt {

// Calls work(context, i) once for each i in [0, count), on up to `threads` threads, the caller's among them.
// Threads live for one call: starting one costs about 20 microseconds, nothing spins, and fork() stays safe. Returns when
// all the work is done, without waiting for helpers that the system has not let run.
void share(int64_t count, int threads, void (*work)(void*, int64_t), void* context);

// How many threads a job on `items` vertices deserves: 1 below 30000; `asked` > 0 decides by itself.
int threads_for(int64_t items, int asked);

}  // namespace vt
