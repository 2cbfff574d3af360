// Work shared by a few threads.
#pragma once
#include <cstdint>

namespace vt {

// Calls work(context, i) once for each i in [0, count), on up to `threads` threads, the caller's among them. Returns when
// all the work is done, without waiting for helpers that the system has not let run.
// Helpers are started when first needed and stay. One that has nothing to do looks out for 20 microseconds, then sleeps.
// They serve one call at a time: a call that comes meanwhile, from another thread, works alone. After fork() the child
// starts its own.
void share(int64_t count, int threads, void (*work)(void*, int64_t), void* context);

// How many threads a job on `items` vertices deserves: 1 below 30000; `asked` > 0 decides by itself.
int threads_for(int64_t items, int asked);

// Ends the helpers and waits for them; from then on every call works alone. For the end of the process.
void stop_helpers();

}  // namespace vt
