// What all files of the Python face share: kinds of arrays, checks, threads.
#pragma once
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>

#include <initializer_list>
#include <memory>
#include <optional>
#include <tuple>

#include "threads.h"

namespace nb = nanobind;

namespace vt::face {

template <class T, int N>
using Array = nb::ndarray<const T, nb::numpy, nb::ndim<N>, nb::c_contig, nb::device::cpu>;
template <class T, int N>
using Output = nb::ndarray<T, nb::numpy, nb::ndim<N>, nb::c_contig, nb::device::cpu>;

template <class A>
auto data(const std::optional<A>& array) {
    return array ? array->data() : nullptr;
}

// Whether the processor runs the kernels for x86-64-v3.
inline bool newer() {
#if defined(VT_HAVE_V3)
    __builtin_cpu_init();
    return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2");
#else
    return false;
#endif
}

inline void check(bool ok, const char* what) {
    if (!ok) throw nb::value_error(what);
}

// Runs work(i) for i in [0, count) on some threads, without the GIL.
template <class F>
void each(int64_t count, int threads, F&& work) {
    nb::gil_scoped_release release;
    vt::share(count, threads, [](void* f, int64_t i) { (*static_cast<F*>(f))(i); }, &work);
}

template <class T>
using AnyArray = nb::ndarray<const T, nb::numpy, nb::c_contig, nb::device::cpu>;

// What owns all of the arrays.
template <class... A>
std::shared_ptr<void> keep(const A&... arrays) {
    return std::make_shared<std::tuple<A...>>(arrays...);
}

// An uninitialised array that owns its memory.
template <class T>
nb::ndarray<nb::numpy, T> owned(std::initializer_list<size_t> shape) {
    size_t size = 1;
    for (size_t n : shape) size *= n;
    T* values = new T[size ? size : 1];
    nb::capsule owner(values, [](void* p) noexcept { delete[] static_cast<T*>(p); });
    return nb::ndarray<nb::numpy, T>(values, shape, owner);
}

}  // namespace vt::face
