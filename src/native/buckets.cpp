// The Python face of buckets: checks that arrays fit together, and keeps them.
#include "buckets.h"

namespace vt::face {

namespace {

void add_bucket(Buckets& all, int influences, int lanes, int64_t count, AnyArray<float> rest, AnyArray<int32_t> joint,
                AnyArray<float> weight, std::optional<Array<int32_t, 1>> row, std::optional<Array<int32_t, 1>> target,
                bool shared, std::optional<AnyArray<int32_t>> base, std::optional<AnyArray<int32_t>> set,
                std::optional<AnyArray<float>> center, std::optional<AnyArray<float>> carry) {
    const char* wrong = "bucket does not fit together";
    const int64_t places = lanes == 8 ? (count + 7) / 8 * 8 : count, width = influences;
    check(lanes == 1 || lanes == 8, wrong);
    check(int64_t(rest.size()) == places * 3 && (!target || int64_t(target->size()) >= count), wrong);
    if (lanes == 1) {
        check(joint.size() == weight.size() && int64_t(joint.size()) >= count * width && (width > 0) == !row, wrong);
        check(!row || int64_t(row->size()) == count + 1, wrong);
    } else {
        check(width == 1 || width == 2 || width == 4 || width == 8 || width == 16 || width == 64, "no kernel so wide");
        check(int64_t(weight.size()) == places * width, wrong);
        check(int64_t(joint.size()) == (shared ? places / 8 : places) * width, wrong);
    }
    check((!base || int64_t(base->size()) == places) && (!set || int64_t(set->size()) == places), wrong);
    check((!center || int64_t(center->size()) == places * 3) && (!center == !carry), wrong);
    check(!carry || carry->size() == weight.size(), wrong);
    const vt::Bucket bucket{influences, count, rest.data(), joint.data(), weight.data(), data(row), data(target), shared};
    all.laid.push_back({bucket, lanes == 8, data(base), data(set), data(center), data(carry)});
    all.arrays.push_back(keep(rest, joint, weight, row, target, base, set, center, carry));
    all.count += count;
}

}  // namespace

void bind_buckets(nb::module_& m) {
    nb::class_<Buckets>(m, "Buckets")
        .def(nb::init<>())
        .def("add", &add_bucket, nb::arg("influences"), nb::arg("lanes"), nb::arg("count"), nb::arg("rest"),
             nb::arg("joint"), nb::arg("weight"), nb::arg("row").none(), nb::arg("target").none(), nb::arg("shared"),
             nb::arg("base") = nb::none(), nb::arg("set") = nb::none(), nb::arg("center") = nb::none(),
             nb::arg("carry") = nb::none());
}

}  // namespace vt::face
