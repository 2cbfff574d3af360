// The Python face of the kernels: checks shapes, releases the GIL, chooses the instruction set once.
#include <nanobind/stl/string.h>

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

#include "buckets.h"
#include "face.h"
#include "kernels.h"
#include "motions.h"
#include "parse.h"
#include "threads.h"

using namespace vt::face;

namespace vt::face {
void bind_cloth(nb::module_& m);  // module_cloth.cpp
}

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
    decltype(&vt::base::linear_table) linear_table;
    decltype(&vt::base::linear) linear;
    decltype(&vt::base::linear_lanes) linear_lanes;
    decltype(&vt::base::touch) touch;
    decltype(&vt::base::rigid) rigid;
    decltype(&vt::base::face_normals) face_normals;
    decltype(&vt::base::vertex_normals) vertex_normals;
    decltype(&vt::base::contour_links) contour_links;
    decltype(&vt::base::contour_turns) contour_turns;
    decltype(&vt::base::contour_motions) contour_motions;
    decltype(&vt::base::hand) hand;
    decltype(&vt::base::pose_room) pose_room;
    decltype(&vt::base::solve_pose) solve_pose;
};
#define VT_KERNELS(NS)                                                                                      \
    {                                                                                                       \
        #NS, vt::NS::forward_kinematics, vt::NS::linear_table, vt::NS::linear, vt::NS::linear_lanes,        \
            vt::NS::touch, vt::NS::rigid, vt::NS::face_normals, vt::NS::vertex_normals,                     \
            vt::NS::contour_links, vt::NS::contour_turns, vt::NS::contour_motions, vt::NS::hand,            \
            vt::NS::pose_room, vt::NS::solve_pose                                                           \
    }

Kernels best() {
#if defined(VT_HAVE_V3)
    if (newer()) return VT_KERNELS(v3);
#endif
    return VT_KERNELS(base);
}

Kernels use = best();

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

// (F,J,16), or with `still` (F,J+1,16), the last of which does not move.
nb::ndarray<nb::numpy, float> linear_table(Array<double, 4> matrices, bool still) {
    const size_t frames = matrices.shape(0), joints = matrices.shape(1), rows = joints + (still ? 1 : 0);
    auto out = owned<float>({frames, rows, 16});
    for (size_t f = 0; f < frames; ++f) {
        float* o = out.data() + f * rows * 16;
        use.linear_table(int64_t(joints), matrices.data() + f * joints * 16, o);
        if (still) std::fill(o + joints * 16, o + rows * 16, 0.0f);
    }
    return out;
}

// out (F,V,3) points or (F,V,12) transforms.
void linear(const Buckets& buckets, Array<float, 3> table, Output<float, 3> out, int threads) {
    check(out.shape(0) == table.shape(0) && (out.shape(2) == 3 || out.shape(2) == 12), "out does not fit");
    for (const Laid& l : buckets.laid)
        check(!l.lanes || (l.bucket.shared && l.bucket.influences <= 8), "no linear kernel for that bucket");
    const auto frames = int64_t(table.shape(0)), joints = int64_t(table.shape(1)), stride = int64_t(out.shape(1) * out.shape(2));
    buckets.each_part(frames, threads, 1, [&](const Laid& l, int64_t first, int64_t last) {
        (l.lanes ? use.linear_lanes : use.linear)(l.bucket, first, last, frames, joints, table.data(), out.data(),
                                                  stride, out.shape(2) == 12);
    });
}

void touch(std::optional<Array<float, 2>> table, Array<float, 3> rest, Array<int32_t, 2> joint, Array<float, 3> weight,
           std::optional<Array<int32_t, 1>> target, int64_t count, Output<float, 2> out, int threads) {
    const size_t groups = size_t(count + 7) / 8;
    check(rest.shape(0) == groups && joint.shape(0) == groups && weight.shape(0) == groups, "bucket does not fit together");
    check(joint.shape(1) == 4 && weight.shape(1) == 4 && weight.shape(2) == 8 && rest.shape(2) == 8, "does not fit");
    const vt::Bucket bucket{4, count, rest.data(), joint.data(), weight.data(), nullptr, data(target), true};
    each(blocks(count, kRun), vt::threads_for(count, threads),
         [&](int64_t i) { use.touch(bucket, i * kRun, stop(i, count, kRun), data(table), out.data()); });
}

double deviation(Array<double, 4> matrices) {
    return vt::deviation(int64_t(matrices.shape(0) * matrices.shape(1)), matrices.data());
}

using Memory = std::optional<Output<double, 2>>;

vt::MotionJob motion_job(const Array<double, 4>& matrices, const Array<int32_t, 2>& tree, const Array<int32_t, 2>& left,
                         bool follow, const Memory& memory, const Array<int32_t, 2>& pairs) {
    check(!memory || (memory->shape(0) == tree.shape(0) && memory->shape(1) == 4), "memory does not fit");
    check(tree.shape(1) == 2 && left.shape(1) == 2 && pairs.shape(1) == 2, "expected pairs of joints");
    vt::MotionJob job{};
    job.frames = int64_t(matrices.shape(0));
    job.joints = int64_t(matrices.shape(1));
    job.edges = int64_t(tree.shape(0));
    job.lefts = int64_t(left.shape(0));
    job.pairs = int64_t(pairs.shape(0));
    job.matrix = matrices.data();
    job.tree = tree.data();
    job.left = left.data();
    job.pair = pairs.data();
    job.follow = follow;
    job.memory = memory ? memory->data() : nullptr;
    return job;
}

nb::tuple dual_table(Array<double, 4> matrices, Array<int32_t, 2> tree, Array<int32_t, 2> left, bool follow,
                     Memory memory) {
    vt::MotionJob job = motion_job(matrices, tree, left, follow, memory, left);
    auto out = owned<float>({matrices.shape(0), matrices.shape(1) + 1, 8});
    auto agree = owned<uint8_t>({matrices.shape(0)});
    job.pairs = 0;
    job.dual = out.data();
    job.agree = agree.data();
    std::vector<double> scratch(size_t(vt::motion_scratch(job)));
    vt::motion_tables(job, scratch.data());
    return nb::make_tuple(out, agree);
}

// Half twists (F,P,8) of pairs, and the dual quaternions (F,J+1,8).
nb::tuple twist_table(Array<double, 4> matrices, Array<int32_t, 2> tree, Array<int32_t, 2> left, bool follow,
                      Memory memory, Array<int32_t, 2> pairs) {
    vt::MotionJob job = motion_job(matrices, tree, left, follow, memory, pairs);
    auto dual = owned<float>({matrices.shape(0), matrices.shape(1) + 1, 8});
    auto out = owned<float>({matrices.shape(0), pairs.shape(0), 8});
    job.dual = dual.data();
    job.twist = out.data();
    std::vector<double> scratch(size_t(vt::motion_scratch(job)));
    vt::motion_tables(job, scratch.data());
    return nb::make_tuple(out, dual);
}

nb::ndarray<nb::numpy, float> turn_shares(Array<double, 4> matrices, Array<int32_t, 2> tree, Array<int32_t, 2> left,
                                          bool follow, Memory memory, Array<int32_t, 2> pairs, Array<double, 1> low,
                                          Array<double, 1> high, bool hard, Array<int32_t, 1> row,
                                          Array<int32_t, 1> member) {
    const vt::MotionJob job = motion_job(matrices, tree, left, follow, memory, pairs);
    check(low.shape(0) == pairs.shape(0) && high.shape(0) == pairs.shape(0), "limits do not fit");
    const size_t sets = row.shape(0) - 1;
    auto out = owned<float>({matrices.shape(0), sets});
    std::vector<double> scratch(size_t(vt::motion_scratch(job)));
    vt::turn_shares(job, low.data(), high.data(), hard, int64_t(sets), row.data(), member.data(), scratch.data(),
                    out.data());
    return out;
}

// out (F,V,3) points or (F,V,12) transforms; `steps` -1 means that the table holds half twists. `linear` (F,J+1,16) with
// `share` (F or 1, S) and `set` (8 G) fades from linear blending; with `center` and `carry` it moves centres.
void rigid(const Buckets& buckets, Array<float, 3> table, int steps, std::optional<Array<uint8_t, 1>> agree,
           std::optional<Array<float, 3>> bases, Output<float, 3> out, int threads,
           std::optional<Array<float, 3>> linear, std::optional<Array<float, 2>> share) {
    check(out.shape(0) == table.shape(0) && (out.shape(2) == 3 || out.shape(2) == 12), "out does not fit");
    check(!linear || (linear->shape(0) == table.shape(0) && steps >= 0), "linear does not fit");
    check(!share || (linear && (share->shape(0) == 1 || share->shape(0) == table.shape(0))), "share does not fit");
    for (const Laid& l : buckets.laid)
        check(l.lanes && (!bases || l.base) && (!share || l.set) && (!l.center || linear), "bucket does not fit");
    vt::RigidJob job{};
    job.frames = int64_t(out.shape(0));
    job.vertices = int64_t(out.shape(1));
    job.table = table.data();
    job.rows = int64_t(table.shape(1));
    job.steps = steps < 0 ? 0 : steps;
    job.agree = data(agree);
    job.twists = steps < 0;
    job.bases = data(bases);
    job.base_rows = bases ? int64_t(bases->shape(1)) : 0;
    job.linear.table = data(linear);
    job.linear.share = data(share);
    job.linear.share_stride = share && share->shape(0) > 1 ? int64_t(share->shape(1)) : 0;
    job.joints = linear ? int64_t(linear->shape(1)) : 0;
    job.out = out.data();
    job.whole = out.shape(2) == 12;
    buckets.each_part(job.frames, threads, 3, [&](const Laid& l, int64_t first, int64_t last) {
        vt::RigidJob own = job;
        own.base = l.base;
        own.linear.set = l.set;
        own.linear.center = l.center;
        own.linear.carry = l.carry;
        use.rigid(l.bucket, first, last, own);
    });
}

// Unit normals out (F,V,3) of points (F,V,3).
void normals(Array<float, 3> points, Array<int32_t, 2> triangles, Array<int32_t, 1> row, Array<int32_t, 1> face,
             Array<int32_t, 1> point, Array<int32_t, 1> order, Output<float, 3> out, int threads) {
    const int64_t frames = int64_t(points.shape(0)), vertices = int64_t(points.shape(1));
    const int64_t count = int64_t(triangles.shape(0));
    check(out.shape(0) == points.shape(0) && out.shape(1) == points.shape(1), "out does not fit");
    check(int64_t(point.size()) == vertices && int64_t(order.size()) == vertices, "incidence does not fit");
    std::unique_ptr<float[]> faces(new float[size_t(count) * 4]);
    const int workers = vt::threads_for(vertices * 3, threads);  // a vertex costs more here than in skinning
    for (int64_t f = 0; f < frames; ++f) {
        const float* p = points.data() + f * vertices * 3;
        float* o = out.data() + f * vertices * 3;
        each(blocks(count, kRun), workers, [&](int64_t i) {
            use.face_normals(i * kRun, stop(i, count, kRun), vertices, p, triangles.data(), faces.get());
        });
        each(blocks(vertices, kRun), workers, [&](int64_t i) {
            use.vertex_normals(i * kRun, stop(i, vertices, kRun), faces.get(), row.data(), face.data(), point.data(),
                               order.data(), o);
        });
    }
}

// What does not change between frames, with the arrays that it points into.
template <class Program>
struct Bound {
    Program program;
    std::shared_ptr<void> arrays;
    int64_t joints;
};

template <class Program, class... A>
Bound<Program> bind(const Program& program, int64_t joints, A&&... arrays) {
    return {program, keep(std::forward<A>(arrays)...), joints};
}

Bound<vt::ContourProgram> bind_contours(
    Array<double, 2> center, Array<int32_t, 2> link, Array<double, 2> axis, Array<double, 2> bone,
    Array<int32_t, 1> base, Array<int32_t, 1> row, Array<int32_t, 1> step, Array<double, 1> swing,
    Array<double, 1> twist, Array<double, 2> middle, Array<double, 2> along, Array<int32_t, 1> frame,
    Array<double, 1> diversion, Array<double, 1> mitre, Array<int32_t, 1> mitre_link, Array<double, 1> mitre_share,
    Array<double, 1> bulge, Array<int32_t, 1> bulge_link, Array<double, 1> recentre, Array<int32_t, 1> limb,
    Array<double, 2> way, Array<double, 2> aside, Array<double, 1> seam, Array<int32_t, 1> same,
    Array<uint8_t, 1> whole) {
    const int64_t links = int64_t(link.shape(0)), contours = int64_t(base.shape(0));
    check(axis.shape(0) == link.shape(0) && bone.shape(0) == link.shape(0), "program does not fit together");
    check(int64_t(row.shape(0)) == contours + 1 && swing.shape(0) == step.shape(0), "program does not fit together");
    check(twist.shape(0) == step.shape(0), "program does not fit together");
    check(recentre.shape(0) == base.shape(0) && limb.shape(0) == base.shape(0), "program does not fit together");
    check(way.shape(0) == base.shape(0) && aside.shape(0) == base.shape(0), "program does not fit together");
    check(seam.shape(0) == base.shape(0) && same.shape(0) == base.shape(0), "program does not fit together");
    check(whole.shape(0) == link.shape(0), "program does not fit together");
    const vt::ContourProgram program{links, contours, int64_t(step.shape(0)), center.data(), link.data(), axis.data(),
                                     bone.data(), base.data(), row.data(), step.data(), swing.data(), twist.data(),
                                     middle.data(), along.data(), frame.data(), diversion.data(), mitre.data(),
                                     mitre_link.data(), mitre_share.data(), bulge.data(), bulge_link.data(),
                                     recentre.data(), limb.data(), way.data(), aside.data(), seam.data(), same.data(),
                                     whole.data()};
    return bind(program, int64_t(center.shape(0)), center, link, axis, bone, base, row, step, swing, twist, middle,
                along, frame, diversion, mitre, mitre_link, mitre_share, bulge, bulge_link, recentre, limb, way, aside,
                seam, same, whole);
}

// The joint matrices (F,J,4,4), unless they are left out, followed by the motions of the contours: (F,J+C,4,4) or (F,C,4,4).
nb::ndarray<nb::numpy, double> contour_motions(const Bound<vt::ContourProgram>& bound, Array<double, 4> matrices,
                                               bool follow, bool with_joints) {
    const vt::ContourProgram& p = bound.program;
    const int64_t frames = int64_t(matrices.shape(0)), joints = int64_t(matrices.shape(1));
    check(joints == bound.joints, "matrices do not fit");
    const int64_t before_them = with_joints ? joints : 0;
    auto out = owned<double>({size_t(frames), size_t(before_them + p.contours), 4, 4});
    double* result = out.data();
    std::unique_ptr<double[]> scratch(new double[size_t(p.links * 16 + (p.steps + 7) / 8 * 32)]);
    double *before = scratch.get(), *links = before + p.links * 4, *turns = links + p.links * 12;
    nb::gil_scoped_release release;
    for (int64_t f = 0; f < frames; ++f) {
        const double* m = matrices.data() + f * joints * 16;
        use.contour_links(m, p, follow, f == 0, before, links);
        use.contour_turns(p, links, turns);
        double* o = result + f * (before_them + p.contours) * 16;
        std::copy(m, m + before_them * 16, o);
        use.contour_motions(m, p, links, turns, o + before_them * 16);
    }
    return out;
}

Bound<vt::HandJob> bind_hand(
    Array<int32_t, 1> before, Array<int32_t, 1> near, Array<int32_t, 1> far, Array<int32_t, 1> previous,
    Array<double, 2> start, Array<double, 2> end, Array<double, 2> axis_near, Array<double, 2> axis_far,
    Array<double, 2> normal_near, Array<double, 2> normal_far, Array<int32_t, 1> vertex, Array<double, 1> whole,
    Array<int32_t, 1> block_link, Array<int32_t, 2> block_vertex, Array<float, 3> term, Array<int32_t, 2> pair,
    Array<int32_t, 2> gap_vertex, Array<float, 3> gap) {
    check(term.shape(0) == block_link.shape(0) && gap.shape(0) == pair.shape(0), "program does not fit together");
    check(vertex.shape(0) == whole.shape(0) && near.shape(0) == previous.shape(0), "program does not fit together");
    int64_t joints = 0;
    for (const auto& some : {before, near, far})
        for (size_t i = 0; i < some.shape(0); ++i) joints = std::max(joints, int64_t(some.data()[i]) + 1);
    const vt::HandJob job{int64_t(near.shape(0)), int64_t(vertex.shape(0)), int64_t(block_link.shape(0)),
                          int64_t(pair.shape(0)), before.data(), near.data(), far.data(), previous.data(),
                          start.data(), end.data(), axis_near.data(), axis_far.data(), normal_near.data(),
                          normal_far.data(), vertex.data(), whole.data(), block_link.data(), block_vertex.data(),
                          term.data(), pair.data(), gap_vertex.data(), gap.data()};
    return bind(job, joints, before, near, far, previous, start, end, axis_near, axis_far, normal_near, normal_far,
                vertex, whole, block_link, block_vertex, term, pair, gap_vertex, gap);
}

// Moves the points of a hand in out (F,V,3).
void hand(const Bound<vt::HandJob>& bound, Array<double, 4> matrices, Output<float, 3> out) {
    const vt::HandJob& job = bound.program;
    const int64_t frames = int64_t(matrices.shape(0)), stride = int64_t(matrices.shape(1)) * 16;
    check(int64_t(matrices.shape(1)) >= bound.joints, "matrices do not fit");
    check(int64_t(out.shape(0)) == frames && out.shape(2) == 3, "out does not fit");
    std::unique_ptr<double[]> scratch(new double[size_t(job.links) * 33]);
    nb::gil_scoped_release release;
    for (int64_t f = 0; f < frames; ++f)
        use.hand(matrices.data() + f * stride, job, scratch.get(), out.data() + f * int64_t(out.shape(1)) * 3);
}

// The part of a problem that does not change between frames or calls; keeps its arrays.
Bound<vt::PoseProblem> bind_poses(Array<int32_t, 1> parent, Array<double, 2> center, Array<double, 2> translation,
                                  std::optional<Array<double, 3>> stretch, Array<double, 2> frame,
                                  Array<double, 3> box, Array<uint8_t, 1> limited, Array<int32_t, 2> column,
                                  Array<double, 1> give, Array<int32_t, 1> kind,
                                  Array<int32_t, 1> joint, Array<double, 2> point, Array<double, 2> axis,
                                  std::optional<Array<double, 1>> prior) {
    const auto joints = int64_t(parent.shape(0)), columns = int64_t(column.shape(0));
    check(int64_t(center.shape(0)) == joints && int64_t(limited.shape(0)) == joints, "joint counts differ");
    check(int64_t(give.shape(0)) == columns, "column counts differ");
    check(kind.shape(0) == joint.shape(0) && kind.shape(0) == point.shape(0), "wish counts differ");
    const vt::PoseProblem problem{joints, columns, int64_t(kind.shape(0)), parent.data(), center.data(),
                                  translation.data(), data(stretch), frame.data(), box.data(), limited.data(),
                                  column.data(), give.data(), kind.data(), joint.data(), point.data(),
                                  axis.data(), data(prior), 0.0, 0.0, 0.0, 0};
    return bind(problem, joints, parent, center, translation, stretch, frame, box, limited, column, give, kind,
                joint, point, axis, prior);
}

// Changes rotation (F,J,4), shift (F,3) and angle (F,J,3); error (F,K,3) and steps (F,) are filled.
void solve_poses(const Bound<vt::PoseProblem>& bound, Output<double, 3> rotation, Output<double, 2> shift,
                 Output<double, 3> angle, Array<double, 3> place, Array<double, 2> weight,
                 std::optional<Array<double, 3>> prior_rotation, std::optional<Array<double, 3>> prior_angle,
                 std::optional<Array<double, 2>> prior_shift, double tolerance, double damping, double idle,
                 int iterations, Output<double, 3> error, Output<int32_t, 1> steps, int threads) {
    vt::PoseProblem problem = bound.program;
    problem.tolerance = tolerance;
    problem.damping = damping;
    problem.idle = idle;
    problem.iterations = iterations;
    const int64_t frames = int64_t(rotation.shape(0)), j = problem.joints, k = problem.wishes;
    check(int64_t(rotation.shape(1)) == j && int64_t(angle.shape(1)) == j, "joint counts differ");
    check(int64_t(place.shape(1)) == k && int64_t(error.shape(1)) == k, "wish counts differ");
    check(int64_t(place.shape(0)) == frames && int64_t(steps.shape(0)) == frames, "frame counts differ");
    check(bool(problem.prior) == bool(prior_rotation), "a prior wants weights and a pose");
    const int64_t chunk = 8, room = use.pose_room(problem);
    each((frames + chunk - 1) / chunk, vt::threads_for(frames * j * 100, threads), [&](int64_t i) {
        std::vector<double> work(static_cast<size_t>(room));
        for (int64_t f = i * chunk; f < std::min((i + 1) * chunk, frames); ++f) {
            const vt::PoseFrame frame{rotation.data() + f * j * 4, shift.data() + f * 3, angle.data() + f * j * 3,
                                      place.data() + f * k * 4, weight.data() + f * k,
                                      prior_rotation ? prior_rotation->data() + f * j * 4 : nullptr,
                                      prior_angle ? prior_angle->data() + f * j * 3 : nullptr,
                                      prior_shift ? prior_shift->data() + f * 3 : nullptr, error.data() + f * k * 3};
            steps.data()[f] = use.solve_pose(problem, frame, work.data());
        }
    });
}

}  // namespace

NB_MODULE(_native, m) {
    m.doc() = "Kernels of vitruvian. Arrays belong to the caller, the GIL is released; see vitruvian.native.";
    nb::module_::import_("atexit").attr("register")(
        nb::cpp_function(&vt::stop_helpers, nb::call_guard<nb::gil_scoped_release>()));
    m.def("instruction_set", [] { return use.name; });
    m.def("use_instruction_set", [](const std::string& name) {
        const Kernels wanted = name == "base" ? Kernels VT_KERNELS(base) : best();
        check(name == wanted.name, "this processor or build does not have that instruction set");
        use = wanted;
    });
    m.def("forward_kinematics", &forward_kinematics, nb::arg("parent"), nb::arg("center"), nb::arg("rotation"),
          nb::arg("translation"), nb::arg("root").none(), nb::arg("stretch").none(), nb::arg("binding").none(),
          nb::arg("out"), nb::arg("threads") = 0);
    m.def("linear_table", &linear_table, nb::arg("matrices"), nb::arg("still") = false);
    vt::face::bind_buckets(m);
    m.def("linear", &linear, nb::arg("buckets"), nb::arg("table"), nb::arg("out"), nb::arg("threads") = 0);
    m.def("touch", &touch, nb::arg("table").none(), nb::arg("rest"), nb::arg("joint"), nb::arg("weight"),
          nb::arg("target").none(), nb::arg("count"), nb::arg("out"), nb::arg("threads") = 0);
    m.def("deviation", &deviation, nb::arg("matrices"));
    m.def("dual_table", &dual_table, nb::arg("matrices"), nb::arg("tree"), nb::arg("left"), nb::arg("follow"),
          nb::arg("memory") = nb::none());
    m.def("twist_table", &twist_table, nb::arg("matrices"), nb::arg("tree"), nb::arg("left"), nb::arg("follow"),
          nb::arg("memory").none(), nb::arg("pairs"));
    m.def("turn_shares", &turn_shares, nb::arg("matrices"), nb::arg("tree"), nb::arg("left"), nb::arg("follow"),
          nb::arg("memory").none(), nb::arg("pairs"), nb::arg("low"), nb::arg("high"), nb::arg("hard"), nb::arg("row"),
          nb::arg("member"));
    m.def("rigid", &rigid, nb::arg("buckets"), nb::arg("table"), nb::arg("steps"), nb::arg("agree").none(),
          nb::arg("bases").none(), nb::arg("out"), nb::arg("threads") = 0, nb::arg("linear") = nb::none(),
          nb::arg("share") = nb::none());
    m.def("normals", &normals, nb::arg("points"), nb::arg("triangles"), nb::arg("row"), nb::arg("face"),
          nb::arg("point"), nb::arg("order"), nb::arg("out"), nb::arg("threads") = 0);
    nb::set_leak_warnings(false);  // programs bound by objects that live until the interpreter ends
    nb::class_<Bound<vt::ContourProgram>>(m, "Contours");
    m.def("bind_contours", &bind_contours);
    m.def("contour_motions", &contour_motions, nb::arg("program"), nb::arg("matrices"), nb::arg("follow"),
          nb::arg("with_joints") = true);
    nb::class_<Bound<vt::HandJob>>(m, "Hand");
    m.def("bind_hand", &bind_hand);
    m.def("hand", &hand, nb::arg("program"), nb::arg("matrices"), nb::arg("out"));
    nb::class_<Bound<vt::PoseProblem>>(m, "Poses");
    m.def("bind_poses", &bind_poses, nb::arg("parent"), nb::arg("center"), nb::arg("translation"),
          nb::arg("stretch").none(), nb::arg("frame"), nb::arg("box"), nb::arg("limited"), nb::arg("column"),
          nb::arg("give"), nb::arg("kind"), nb::arg("joint"), nb::arg("point"), nb::arg("axis"),
          nb::arg("prior").none());
    m.def("solve_poses", &solve_poses, nb::arg("problem"), nb::arg("rotation"), nb::arg("shift"), nb::arg("angle"),
          nb::arg("place"), nb::arg("weight"), nb::arg("prior_rotation").none(), nb::arg("prior_angle").none(),
          nb::arg("prior_shift").none(), nb::arg("tolerance"), nb::arg("damping"), nb::arg("idle"),
          nb::arg("iterations"), nb::arg("error"), nb::arg("steps"), nb::arg("threads") = 0);
    vt::face::bind_cloth(m);
    m.def("parse_floats", &parse_floats, nb::arg("text"), nb::arg("expected") = -1);
}
