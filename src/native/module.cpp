// The Python face of the kernels: checks shapes, releases the GIL, chooses the instruction set once.
#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <string>
#include <vector>

#include "parse.h"

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

}  // namespace

NB_MODULE(_native, m) {
    m.doc() = "Kernels of vitruvian. Arrays belong to the caller, the GIL is released; see vitruvian.native.";
    m.def("parse_floats", &parse_floats, nb::arg("text"), nb::arg("expected") = -1);
}
