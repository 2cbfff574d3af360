// The Python face of the kernels: checks shapes, releases the GIL, chooses the instruction set once.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <optional>
#include <string>
#include <vector>

#include "kernels.h"
#include "parse.h"
#include "threads.h"

namespace nb = nanobind;

namespace {

// An array that owns what `values` holds.
nb::object floats(std::vector<double>&& values) {
    auto* kept = new std::vector<double>(std::move(values));
    nb::capsule owner(kept, [](void* p) noexcept { delete static_cast<std::vector<double>*>(p); });
    return nb::cast(nb::ndarray<nb::numpy, double, nb::ndim<1>>(kept->data(), {kept->size()}, owner));
}

nb::object parse_floats(nb::object text, int64_t expected) {
    Py_buffer view;
    if (PyObject_GetBuffer(text.ptr(), &view, PyBUF_SIMPLE) != 0) throw nb::python_error();
    std::vector<double> values;
    vt::BadToken bad;
    {
        nb::gil_scoped_release release;
        values.reserve(expected >= 0 && expected <= view.len ? size_t(expected) : size_t(view.len) / 8 + 1);
        bad = vt::parse_floats(static_cast<const char*>(view.buf), size_t(view.len), values);
    }
    PyBuffer_Release(&view);
    if (!bad.text.empty()) {
        nb::object shown = nb::steal(PyUnicode_DecodeLatin1(bad.text.data(), Py_ssize_t(bad.text.size()), nullptr));
        nb::object message =
            nb::str("byte {}: expected a finite number, found {!r}").attr("format")(bad.offset, shown);
        nb::object error = nb::handle(PyExc_ValueError)(message);
        error.attr("offset") = bad.offset;
        PyErr_SetObject(PyExc_ValueError, error.ptr());
        throw nb::python_error();
    }
    if (expected >= 0 && int64_t(values.size()) != expected) {
        const std::string message =
            "expected " + std::to_string(expected) + " numbers, found " + std::to_string(values.size());
        throw nb::value_error(message.c_str());
    }
    values.shrink_to_fit();
    return floats(std::move(values));
}

// The kernels of one instruction set.
struct Kernels {
    const char* name;
    decltype(&vt::base::forward_kinematics) forward_kinematics;
};
#define VT_KERNELS(NS) {#NS, vt::NS::forward_kinematics}

Kernels best() {
#if defined(VT_HAVE_V3)
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") && __builtin_cpu_supports("bmi2"))
        return VT_KERNELS(v3);
#endif
    return VT_KERNELS(base);
}

Kernels use = best();

template <class T, int N>
using Array = nb::ndarray<const T, nb::numpy, nb::ndim<N>, nb::c_contig, nb::device::cpu>;
template <class T, int N>
using Output = nb::ndarray<T, nb::numpy, nb::ndim<N>, nb::c_contig, nb::device::cpu>;

template <class A>
auto data(const std::optional<A>& array) {
    return array ? array->data() : nullptr;
}

void check(bool ok, const char* what) {
    if (!ok) throw nb::value_error(what);
}

// Runs work(i) for i in [0, count) on some threads, without the GIL.
template <class F>
void each(int64_t count, int threads, F&& work) {
    nb::gil_scoped_release release;
    vt::share(count, threads, [](void* f, int64_t i) { (*static_cast<F*>(f))(i); }, &work);
}

void forward_kinematics(Array<int32_t, 1> parent, Array<double, 2> center, Array<double, 3> rotation,
                        Array<double, 3> translation, std::optional<Array<double, 2>> root,
                        std::optional<Array<double, 3>> stretch, std::optional<Array<double, 3>> binding,
                        Output<double, 4> out, int threads) {
    const int64_t frames = int64_t(rotation.shape(0)), joints = int64_t(parent.shape(0));
    check(int64_t(center.shape(0)) == joints && int64_t(rotation.shape(1)) == joints, "joint counts differ");
    check(int64_t(out.shape(0)) == frames && int64_t(out.shape(1)) == joints, "out does not fit");
    const bool still = translation.shape(0) == 1 && frames != 1;
    check(still || int64_t(translation.shape(0)) == frames, "translation does not fit");
    const int64_t chunk = 256;
    each((frames + chunk - 1) / chunk, vt::threads_for(frames * joints / 4, threads), [&](int64_t i) {
        const int64_t last = (i + 1) * chunk < frames ? (i + 1) * chunk : frames;
        use.forward_kinematics(i * chunk, last, joints, parent.data(), center.data(), rotation.data(),
                               translation.data(), still ? 0 : joints * 3, data(root), data(stretch), data(binding),
                               out.data());
    });
}

}  // namespace

NB_MODULE(_native, m) {
    m.doc() = "Kernels of vitruvian. Arrays belong to the caller, the GIL is released; see vitruvian.native.";
    m.def("instruction_set", [] { return use.name; });
    m.def("use_instruction_set", [](const std::string& name) {
        const Kernels wanted = name == "base" ? Kernels VT_KERNELS(base) : best();
        check(name == wanted.name, "this processor or build does not have that instruction set");
        use = wanted;
    });
    m.def("forward_kinematics", &forward_kinematics, nb::arg("parent"), nb::arg("center"), nb::arg("rotation"),
          nb::arg("translation"), nb::arg("root").none(), nb::arg("stretch").none(), nb::arg("binding").none(),
          nb::arg("out"), nb::arg("threads") = 0);
    m.def("parse_floats", &parse_floats, nb::arg("text"), nb::arg("expected") = -1);
}
