// The Python face of the cloth solver.
#include <algorithm>
#include <memory>

#include "face.h"
#include "kernels.h"
#include "near_cloth.h"

namespace vt::face {

namespace {

template <class T>
auto lasting(std::vector<T>&& values, std::initializer_list<size_t> shape) {
    auto out = owned<T>(shape);
    std::copy(values.begin(), values.end(), out.data());
    return out;
}

// Advances x (n+1,4) and v (n+1,4) by one frame, in place.
void cloth_frame(Output<float, 2> x, Output<float, 2> v, Output<float, 2> d, Output<float, 3> membrane_force,
                 int bends, float carry, Array<int32_t, 3> membrane, Array<float, 3> membrane_rest,
                 Array<int32_t, 3> hinge, Array<float, 3> hinge_rest, Array<int32_t, 3> shape,
                 Array<float, 3> shape_rest, Array<int32_t, 3> tether, Array<float, 3> tether_rest, double dt,
                 int substeps, Array<float, 1> gravity, float damping, float limit, Array<int32_t, 1> pin,
                 Array<float, 2> pin_path, Array<int32_t, 2> pair, Array<float, 2> pair_rest,
                 Array<int32_t, 2> triangle, Array<int32_t, 2> neighbour, Array<float, 2> before,
                 Array<float, 2> after, float offset, float most, float reach,
                 Output<int32_t, 1> nearest, Array<float, 1> friction, Array<int32_t, 2> near, Array<float, 1> side,
                 Array<float, 1> gap, Array<float, 1> rub, int64_t corners) {
    const int64_t n = int64_t(x.shape(0)) - 1;
    check(n >= 0 && x.shape(1) == 4 && v.shape(0) == x.shape(0) && v.shape(1) == 4, "positions do not fit");
    check(int64_t(nearest.shape(0)) == n && int64_t(friction.shape(0)) == n, "vertices do not fit");
    check(membrane.shape(0) == membrane_rest.shape(0) && hinge.shape(0) == hinge_rest.shape(0), "constraints do not fit");
    check(shape.shape(0) == shape_rest.shape(0), "constraints do not fit");
    check(d.shape(0) == x.shape(0) && d.shape(1) == 4, "multipliers do not fit");
    check(membrane_force.shape(0) == membrane.shape(0), "multipliers do not fit");
    const int64_t contacts = int64_t(near.shape(0));
    check(corners >= 0 && corners <= contacts && int64_t(side.shape(0)) == corners, "contacts do not fit");
    check(gap.shape(0) == near.shape(0) && rub.shape(0) == near.shape(0), "contacts do not fit");
    check(substeps > 0 && bends > 0 && gravity.shape(0) == 3, "substeps and gravity do not fit");
    const vt::ClothProgram program{n, int64_t(membrane.shape(0)), membrane.data(), membrane_rest.data(),
                                   int64_t(hinge.shape(0)), hinge.data(), hinge_rest.data(),
                                   int64_t(shape.shape(0)), shape.data(), shape_rest.data(),
                                   int64_t(tether.shape(0)), tether.data(), tether_rest.data()};
    std::unique_ptr<float[]> scratch(new float[size_t(n + 1) * 19]);
    const float* g = gravity.data();
    const vt::ClothFrame frame{x.data(), v.data(), scratch.get(), scratch.get() + 4 * (n + 1),
                               d.data(), membrane_force.data(), bends, carry,
                               scratch.get() + 8 * (n + 1), scratch.get() + 9 * (n + 1), scratch.get() + 10 * (n + 1),
                               scratch.get() + 14 * (n + 1), scratch.get() + 15 * (n + 1),
                               float(dt / substeps), substeps, {g[0], g[1], g[2]}, damping,
                               int64_t(pin.shape(0)), pin.data(), pin_path.data(),
                               int64_t(pair.shape(0)), pair.data(), pair_rest.data(), limit};
    const vt::ClothBody body{int64_t(triangle.shape(0)), triangle.data(), neighbour.data(), before.data(), after.data(),
                             offset, most, reach, nearest.data(), friction.data()};
    std::unique_ptr<float[]> pairs(new float[size_t(contacts + 3 * (contacts - corners)) + 1]);
    const vt::ClothTouch touch{contacts, near.data(), side.data(), gap.data(), rub.data(), corners,
                               pairs.get(), pairs.get() + contacts};
    nb::gil_scoped_release release;
#if defined(VT_HAVE_V3)
    if (newer()) {
        vt::v3::cloth_frame(program, frame, body, touch);
        return;
    }
#endif
    vt::base::cloth_frame(program, frame, body, touch);
}

vt::Surface surface(const Array<float, 2>& x, const Array<int32_t, 2>& triangle, const Array<int32_t, 2>& edge,
                    const Array<int32_t, 1>& same) {
    check(x.shape(1) == 4 && triangle.shape(1) == 3 && edge.shape(1) == 2, "surface does not fit");
    check(same.shape(0) == x.shape(0), "surface does not fit");
    return {x.data(), int64_t(x.shape(0)), triangle.data(), int64_t(triangle.shape(0)), edge.data(),
            int64_t(edge.shape(0)), nullptr, same.data()};
}

// See vt::NearPlan, whose arrays these are.
nb::tuple near_plan(Array<float, 2> x, Array<int32_t, 2> triangle, Array<int32_t, 2> edge, Array<int32_t, 2> sides) {
    check(x.shape(1) == 4 && triangle.shape(1) == 3 && edge.shape(1) == 2, "surface does not fit");
    check(sides.shape(0) == triangle.shape(0) && sides.shape(1) == 3, "sides of triangles do not fit");
    vt::NearOrder out;
    {
        nb::gil_scoped_release release;
        out = vt::order_near({x.data(), int64_t(x.shape(0)), triangle.data(), int64_t(triangle.shape(0)), edge.data(),
                              int64_t(edge.shape(0)), sides.data(), nullptr});
    }
    const auto give = [](std::vector<int32_t>& values) {
        const size_t count = values.size();
        return lasting(std::move(values), {count});
    };
    return nb::make_tuple(give(out.order), give(out.vertex_first), give(out.edge_first), give(out.vertex), give(out.edge),
                          give(out.vertex_of), give(out.edge_of));
}

// Pairs (k,4), first those of vertices and triangles, of which there are c, with their sides (c,), then those of edges;
// keys (r,2) and sides (r,) of those to be remembered. limits: the four of vt::Reach.
nb::tuple near_cloth(Array<float, 2> x, Array<float, 2> v, Array<int32_t, 2> triangle, Array<int32_t, 2> edge,
                     Array<int32_t, 2> sides, Array<int32_t, 1> same, Array<float, 1> limits, Array<int32_t, 2> before, Array<float, 1> side,
                     nb::tuple plan, int threads) {
    vt::Surface s = surface(x, triangle, edge, same);
    check(sides.shape(0) == triangle.shape(0) && sides.shape(1) == 3, "sides of triangles do not fit");
    s.sides = sides.data();
    check(v.shape(0) == x.shape(0) && v.shape(1) == 4, "velocities do not fit");
    check(limits.shape(0) == 4 && before.shape(1) == 2 && side.shape(0) == before.shape(0), "what is known does not fit");
    check(plan.size() == 7, "the plan does not fit");
    using Rows = Array<int32_t, 1>;
    const Rows order = nb::cast<Rows>(plan[0]), vertex_first = nb::cast<Rows>(plan[1]), edge_first = nb::cast<Rows>(plan[2]);
    const Rows vertex = nb::cast<Rows>(plan[3]), edges = nb::cast<Rows>(plan[4]);
    const Rows vertex_of = nb::cast<Rows>(plan[5]), edge_of = nb::cast<Rows>(plan[6]);
    const size_t leaves = (triangle.shape(0) + 7) / 8;
    check(order.shape(0) == triangle.shape(0) && vertex_of.shape(0) == x.shape(0) && edge_of.shape(0) == edge.shape(0) &&
              vertex_first.shape(0) == leaves + 1 && edge_first.shape(0) == leaves + 1 &&
              int64_t(vertex.shape(0)) == 8 * int64_t(vertex_first.data()[leaves]) &&
              int64_t(edges.shape(0)) == 8 * int64_t(edge_first.data()[leaves]),
          "the plan does not fit");
    const vt::NearPlan by{order.data(), vertex_first.data(), edge_first.data(), vertex.data(), edges.data(),
                          vertex_of.data(), edge_of.data()};
    const float* l = limits.data();
    vt::Near out;
    {
        nb::gil_scoped_release release;
        vt::NearKernels kernels{vt::base::near_boxes, vt::base::near_pairs};
#if defined(VT_HAVE_V3)
        if (newer()) kernels = {vt::v3::near_boxes, vt::v3::near_pairs};
#endif
        // looking for what is near is most of a frame: helpers pay earlier than elsewhere
        const int many = threads > 0 || s.triangles < 4000 ? vt::threads_for(0, threads) : vt::threads_for(1 << 20, 0);
        vt::find_near(kernels, many, s, v.data(), by, {l[0], l[1], l[2], l[3]}, before.data(), side.data(),
                      int64_t(before.shape(0)), out);
        out.corner.insert(out.corner.end(), out.cross.begin(), out.cross.end());
    }
    const size_t all = out.corner.size() / 4, corners = out.side.size(), kept = out.key_side.size();
    return nb::make_tuple(lasting(std::move(out.corner), {all, 4}), lasting(std::move(out.side), {corners}),
                          lasting(std::move(out.key), {kept, 2}), lasting(std::move(out.key_side), {kept}));
}

nb::ndarray<nb::numpy, int32_t> cloth_cuts(Array<float, 2> x, Array<int32_t, 2> triangle, Array<int32_t, 2> edge,
                                             Array<int32_t, 1> same) {
    const vt::Surface s = surface(x, triangle, edge, same);
    std::vector<int32_t> out;
    {
        nb::gil_scoped_release release;
        vt::find_cuts(s, out);
    }
    const size_t count = out.size() / 2;
    return lasting(std::move(out), {count, 2});
}

// Feet (n,3) of vertices on a surface, point and normal (V,3), their normals (n,3), and the vertices (n,3).
void cloth_feet(Array<float, 2> point, Array<float, 2> normal, Array<int32_t, 2> corner, Array<float, 2> share,
                Array<float, 2> offset, Output<float, 2> foot, Output<float, 2> up, Output<float, 2> out) {
    const size_t n = corner.shape(0);
    for (const auto& a : {share.shape(0), offset.shape(0), foot.shape(0), up.shape(0), out.shape(0)})
        check(a == n, "vertices do not fit");
    check(point.shape(0) == normal.shape(0), "surface does not fit");
    for (const auto& a : {point.shape(1), normal.shape(1), corner.shape(1), share.shape(1), offset.shape(1),
                          foot.shape(1), up.shape(1), out.shape(1)})
        check(a == 3, "vertices do not fit");
    const vt::ClothFeet feet{point.data(), normal.data(), corner.data(), share.data(),
                             offset.data(), foot.data(), up.data(), out.data()};
    nb::gil_scoped_release release;
#if defined(VT_HAVE_V3)
    if (newer()) {
        vt::v3::cloth_feet(feet, 0, int64_t(n));
        return;
    }
#endif
    vt::base::cloth_feet(feet, 0, int64_t(n));
}

// Moves x (n,3) of some vertices (k,), in place: away from a body, surface (V,6) points and normals, from which they keep
// offset metres, if they are not deeper than that. nearest (k,): triangles (t,3) to look from.
void cloth_clear(Output<float, 2> x, Array<int32_t, 1> vertex, Output<int32_t, 1> nearest, Array<int32_t, 2> triangle,
                 Array<int32_t, 2> neighbour, Array<float, 2> surface, float offset, float deep) {
    check(nearest.shape(0) == vertex.shape(0) && x.shape(1) == 3, "vertices do not fit");
    check(triangle.shape(0) == neighbour.shape(0) && triangle.shape(1) == 3 && neighbour.shape(1) == 3 &&
          surface.shape(1) == 6, "surface does not fit");
    const vt::ClothBody body{int64_t(triangle.shape(0)), triangle.data(), neighbour.data(), surface.data(),
                             surface.data(), offset, 0, 0, nearest.data(), nullptr};
    nb::gil_scoped_release release;
#if defined(VT_HAVE_V3)
    if (newer()) {
        vt::v3::cloth_clear(body, int64_t(vertex.shape(0)), vertex.data(), deep, x.data());
        return;
    }
#endif
    vt::base::cloth_clear(body, int64_t(vertex.shape(0)), vertex.data(), deep, x.data());
}

// Draws some vertices (k,) of x (n,3) towards their feet (n,3), normals there up (n,3), out of skin that faces them: that
// round `nearest` (k,), from which they keep offset metres, if it is not farther than `far`. part (n,): see vt::ClothPinch.
void cloth_pinch(Output<float, 2> x, Output<float, 1> part, Array<float, 2> foot, Array<float, 2> up,
                 Array<int32_t, 1> vertex, Output<int32_t, 1> nearest, Array<int32_t, 2> triangle,
                 Array<int32_t, 2> neighbour, Array<float, 2> surface, float offset, float far, float back) {
    check(nearest.shape(0) == vertex.shape(0) && x.shape(1) == 3 && foot.shape(0) == x.shape(0) && foot.shape(1) == 3 &&
          up.shape(0) == x.shape(0) && up.shape(1) == 3 && part.shape(0) == x.shape(0), "vertices do not fit");
    check(triangle.shape(0) == neighbour.shape(0) && triangle.shape(1) == 3 && neighbour.shape(1) == 3 &&
          surface.shape(1) == 6, "surface does not fit");
    const vt::ClothBody body{int64_t(triangle.shape(0)), triangle.data(), neighbour.data(), surface.data(),
                             surface.data(), offset, 0, 0, nearest.data(), nullptr};
    const vt::ClothPinch job{int64_t(vertex.shape(0)), vertex.data(), foot.data(), up.data(), far, back, part.data(), x.data()};
    nb::gil_scoped_release release;
#if defined(VT_HAVE_V3)
    if (newer()) {
        vt::v3::cloth_pinch(body, job);
        return;
    }
#endif
    vt::base::cloth_pinch(body, job);
}

// One frame of r and v (k,3); see vt::ClothLimbs. numbers: step, damping, friction, smooth, drag, density, gravity, wind.
void cloth_limbs(Output<float, 2> r, Output<float, 2> v, Array<int32_t, 1> vertex, Array<int32_t, 1> bone,
                 Array<float, 1> radius, Array<float, 1> room, Array<float, 1> least, Array<int32_t, 1> row,
                 Array<int32_t, 1> neighbour, Array<float, 2> foot_before, Array<float, 2> foot, Array<float, 2> up,
                 Array<float, 2> axis, Array<float, 1> numbers) {
    const size_t k = vertex.shape(0);
    check(r.shape(0) == k && v.shape(0) == k && r.shape(1) == 3 && v.shape(1) == 3, "vertices do not fit");
    check(bone.shape(0) == k && radius.shape(0) == k && room.shape(0) == k && least.shape(0) == k &&
          row.shape(0) == k + 1, "vertices do not fit");
    check(foot.shape(0) == up.shape(0) && foot.shape(0) == foot_before.shape(0), "feet do not fit");
    check(numbers.shape(0) == 12, "numbers do not fit");
    const float* q = numbers.data();
    std::unique_ptr<float[]> scratch(new float[4 * k + 1]);
    const vt::ClothLimbs job{int64_t(k), vertex.data(), bone.data(), radius.data(), room.data(), least.data(),
                             foot_before.data(), foot.data(), up.data(), axis.data(), row.data(), neighbour.data(),
                             q[0], q[1], q[2], q[3], q[4], q[5], {q[6], q[7], q[8]}, {q[9], q[10], q[11]},
                             r.data(), v.data(), scratch.get(), scratch.get() + 3 * k};
    nb::gil_scoped_release release;
#if defined(VT_HAVE_V3)
    if (newer()) {
        vt::v3::cloth_limbs(job);
        return;
    }
#endif
    vt::base::cloth_limbs(job);
}

}  // namespace

void bind_cloth(nb::module_& m) {
    m.def("cloth_frame", &cloth_frame);
    m.def("near_plan", &near_plan);
    m.def("near_cloth", &near_cloth, nb::arg("x"), nb::arg("v"), nb::arg("triangles"), nb::arg("edges"), nb::arg("sides"), nb::arg("same"), nb::arg("limits"), nb::arg("before"),
          nb::arg("side"), nb::arg("plan"), nb::arg("threads") = 0);
    m.def("cloth_cuts", &cloth_cuts);
    m.def("cloth_clear", &cloth_clear);
    m.def("cloth_feet", &cloth_feet);
    m.def("cloth_limbs", &cloth_limbs);
    m.def("cloth_pinch", &cloth_pinch);
}

}  // namespace vt::face
