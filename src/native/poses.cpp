// Least squares over joint angles within limits; see vitruvian.motion.solver, the twin of every function here.
#include <cmath>

#include "chain.h"
#include "kernels.h"
#include "turns.h"

namespace vt::VT_NS {
namespace {

constexpr int sweeps = 3;
constexpr double longest = 0.7, stuck = 1e12, pi = 3.14159265358979323846;

struct State {
    double *rotation, *angle, *shift, *matrix, *error;  // (J,4) (J,3) (3) (J,12) (K,3)
};

void forward(const PoseProblem& p, State& s) {
    for (int64_t j = 0; j < p.joints; ++j) {
        double r[9], l[12];
        to_matrix(s.rotation + j * 4, r);
        if (p.stretch) {
            const double* e = p.stretch + j * 9;
            for (int i = 0; i < 3; ++i) {
                const double a = r[i * 3], b = r[i * 3 + 1], c = r[i * 3 + 2];
                for (int k = 0; k < 3; ++k) r[i * 3 + k] = a * e[k] + b * e[3 + k] + c * e[6 + k];
            }
        }
        const double *c = p.center + j * 3, *t = j ? p.translation + j * 3 : s.shift;
        for (int i = 0; i < 3; ++i) {
            for (int k = 0; k < 3; ++k) l[i * 4 + k] = r[i * 3 + k];
            l[i * 4 + 3] = t[i] + c[i] - dot(r + i * 3, c);
        }
        double* m = s.matrix + j * 12;
        if (p.parent[j] < 0) {
            for (int i = 0; i < 12; ++i) m[i] = l[i];
            continue;
        }
        const double* a = s.matrix + int64_t(p.parent[j]) * 12;
        for (int i = 0; i < 3; ++i)
            for (int k = 0; k < 4; ++k)
                m[i * 4 + k] = a[i * 4] * l[k] + a[i * 4 + 1] * l[4 + k] + a[i * 4 + 2] * l[8 + k] +
                               (k == 3 ? a[i * 4 + 3] : 0.0);
    }
}

void carried(const double* m, const double* point, double* out) {
    for (int i = 0; i < 3; ++i) out[i] = dot(m + i * 4, point) + m[i * 4 + 3];
}

bool asked(const double* place) {
    return std::isfinite(place[0]) && std::isfinite(place[1]) && std::isfinite(place[2]) && std::isfinite(place[3]);
}

void looking(const PoseProblem& p, const double* m, int64_t k, double* out) {
    for (int i = 0; i < 3; ++i) out[i] = dot(m + i * 4, p.axis + k * 3);
    make_unit(out);
}

// The shortest rotation vector between unit directions; straight behind: one of the ways round.
void turn_to(const double* now, const double* want, double* out) {
    cross(now, want, out);
    const double size = length(out), angle = std::atan2(size, dot(now, want));
    if (size > 1e-9) {
        for (int i = 0; i < 3; ++i) out[i] *= angle / size;
        return;
    }
    const double other[3] = {std::fabs(now[1]) < 0.9 ? 0.0 : 1.0, std::fabs(now[1]) < 0.9 ? 1.0 : 0.0, 0.0};
    cross(now, other, out);
    make_unit(out);
    for (int i = 0; i < 3; ++i) out[i] *= angle;
}

void errors(const PoseProblem& p, State& s, const PoseFrame& f) {
    for (int64_t k = 0; k < p.wishes; ++k) {
        double* e = s.error + k * 3;
        e[0] = e[1] = e[2] = 0.0;
        const double* place = f.place + k * 4;
        if (!asked(place)) continue;
        const double* m = s.matrix + int64_t(p.joint[k]) * 12;
        double point[3];
        carried(m, p.point + k * 3, point);
        for (int i = 0; i < 3; ++i) e[i] = place[i] - point[i];
        if (p.kind[k] == 1) {
            const double along = dot(e, p.axis + k * 3);
            for (int i = 0; i < 3; ++i) e[i] = along * p.axis[k * 3 + i];
        } else if (p.kind[k] == 2) {
            double q[4];
            to_quaternion(m, q);
            turn_between(place, q, e);
        } else if (p.kind[k] == 3) {
            double now[3], want[3] = {e[0], e[1], e[2]};
            looking(p, m, k, now);
            make_unit(want);
            turn_to(now, want, e);
        }
        const double w = std::sqrt(f.weight[k]);
        for (int i = 0; i < 3; ++i) e[i] *= w;
    }
}

// Twists (D,6) of the numbers, scaled by what each gives: the world axis it turns about and the velocity of the origin
// of the body, where joint 0 is.
void twists(const PoseProblem& p, const State& s, const double* origin, double* twist) {
    for (int64_t d = 0; d < p.columns; ++d) {
        const int64_t j = p.column[d * 2], a = p.column[d * 2 + 1];
        double* w = twist + d * 6;
        for (int i = 0; i < 6; ++i) w[i] = 0.0;
        const double g = std::sqrt(p.give[d]);
        if (j < 0) {
            w[3 + a] = g;
            continue;
        }
        double local[3] = {a == 0 ? g : 0.0, a == 1 ? g : 0.0, a == 2 ? g : 0.0};
        if (p.limited[j]) {
            const double y = s.angle[j * 3 + 1], z = s.angle[j * 3 + 2];
            double t[3] = {0.0, 0.0, g};
            if (a == 0) {
                t[0] = g * std::cos(z) * std::cos(y);
                t[1] = g * std::sin(z) * std::cos(y);
                t[2] = -g * std::sin(y);
            } else if (a == 1) {
                t[0] = -g * std::sin(z);
                t[1] = g * std::cos(z);
                t[2] = 0.0;
            }
            double o[9];
            to_matrix(p.frame + j * 4, o);
            for (int i = 0; i < 3; ++i) local[i] = dot(o + i * 3, t);
        }
        const int64_t up = p.parent[j];
        if (up < 0) {
            for (int i = 0; i < 3; ++i) w[i] = local[i];
        } else {
            const double* m = s.matrix + up * 12;
            for (int c = 0; c < 3; ++c) {
                double v[3] = {m[c], m[4 + c], m[8 + c]};
                make_unit(v);
                for (int i = 0; i < 3; ++i) w[i] += v[i] * local[c];
            }
        }
        double center[3];
        carried(s.matrix + j * 12, p.center + j * 3, center);
        for (int i = 0; i < 3; ++i) center[i] -= origin[i];
        cross(center, w, w + 3);
    }
}

// J^T J, packed, and J^T e (D) of numbers scaled by what they give.
void normal_equations(const PoseProblem& p, const State& s, const PoseFrame& f, const Tree& tree, double* twist,
                      double* mass, double* normal, double* pull) {
    double origin[3];
    carried(s.matrix, p.center, origin);
    twists(p, s, origin, twist);
    for (int64_t i = 0; i < p.joints * 42; ++i) mass[i] = 0.0;
    for (int64_t k = 0; k < p.wishes; ++k) {
        if (!asked(f.place + k * 4)) continue;
        const double w = std::sqrt(f.weight[k]);
        const double* m = s.matrix + int64_t(p.joint[k]) * 12;
        double x[3], e[3];
        carried(m, p.point + k * 3, x);
        for (int i = 0; i < 3; ++i) x[i] -= origin[i];
        for (int i = 0; i < 3; ++i) e[i] = w * s.error[k * 3 + i];
        double rows[18] = {0.0, x[2], -x[1], 1.0, 0.0, 0.0, -x[2], 0.0, x[0], 0.0, 1.0, 0.0, x[1], -x[0], 0.0, 0.0, 0.0, 1.0};
        if (p.kind[k] >= 2) {
            double now[3] = {0.0, 0.0, 0.0};
            if (p.kind[k] == 3) looking(p, m, k, now);
            for (int i = 0; i < 3; ++i)
                for (int c = 0; c < 6; ++c) rows[i * 6 + c] = c < 3 ? (i == c ? 1.0 : 0.0) - now[i] * now[c] : 0.0;
        } else if (p.kind[k] == 1) {
            const double* n = p.axis + k * 3;
            for (int c = 0; c < 6; ++c) {
                const double along = n[0] * rows[c] + n[1] * rows[6 + c] + n[2] * rows[12 + c];
                for (int i = 0; i < 3; ++i) rows[i * 6 + c] = n[i] * along;
            }
        }
        ask(mass + int64_t(p.joint[k]) * 42, rows, f.weight[k], e);
    }
    meet(p, tree, mass, twist, normal, pull);
}

// How far the state is from the prior, in numbers (D).
void drift_from(const PoseProblem& p, const State& s, const PoseFrame& f, double* out) {
    for (int64_t d = 0; d < p.columns; ++d) {
        const int64_t j = p.column[d * 2], a = p.column[d * 2 + 1];
        if (j < 0) {
            out[d] = s.shift[a] - f.prior_shift[a];
        } else if (p.limited[j]) {
            const double gap = s.angle[j * 3 + a] - f.prior_angle[j * 3 + a];
            out[d] = gap - 2 * pi * std::floor((gap + pi) / (2 * pi));
        } else {
            double v[3];
            turn_between(s.rotation + j * 4, f.prior_rotation + j * 4, v);
            out[d] = v[a];
        }
    }
}

double cost_of(const PoseProblem& p, const State& s, const double* drift) {
    double sum = 0.0;
    for (int64_t i = 0; i < p.wishes * 3; ++i) sum += s.error[i] * s.error[i];
    if (p.prior)
        for (int64_t d = 0; d < p.columns; ++d) sum += p.prior[d] * drift[d] * drift[d];
    return sum;
}

bool unmet(const PoseProblem& p, const State& s) {
    for (int64_t k = 0; k < p.wishes; ++k)
        if (length(s.error + k * 3) > p.tolerance) return true;
    return false;
}

// The state moved by a step: angles within their bounds, free joints turned in their parents' frames.
void moved(const PoseProblem& p, const State& s, const double* step, const double* low, const double* high, State& out) {
    for (int64_t i = 0; i < p.joints * 4; ++i) out.rotation[i] = s.rotation[i];
    for (int64_t i = 0; i < p.joints * 3; ++i) out.angle[i] = s.angle[i];
    for (int i = 0; i < 3; ++i) out.shift[i] = s.shift[i];
    for (int64_t d = 0; d < p.columns;) {
        const int64_t j = p.column[d * 2];
        double turn[3] = {0.0, 0.0, 0.0};
        for (; d < p.columns && p.column[d * 2] == j; ++d) {
            const int64_t a = p.column[d * 2 + 1];
            if (j < 0) {
                out.shift[a] += step[d];
            } else if (p.limited[j]) {
                const double v = s.angle[j * 3 + a] + step[d];
                out.angle[j * 3 + a] = v < low[d] ? low[d] : v > high[d] ? high[d] : v;
            } else {
                turn[a] = step[d];
            }
        }
        if (j < 0) continue;
        double* q = out.rotation + j * 4;
        if (p.limited[j]) {
            const double *a = out.angle + j * 3, *o = p.frame + j * 4, back[4] = {-o[0], -o[1], -o[2], o[3]};
            const double x[4] = {std::sin(a[0] / 2), 0, 0, std::cos(a[0] / 2)};
            const double y[4] = {0, std::sin(a[1] / 2), 0, std::cos(a[1] / 2)};
            const double z[4] = {0, 0, std::sin(a[2] / 2), std::cos(a[2] / 2)};
            multiply(o, z, q);
            multiply(q, y, q);
            multiply(q, x, q);
            multiply(q, back, q);
        } else {
            double r[4];
            from_vector(turn, r);
            multiply(r, q, q);
            const double n = std::sqrt(dot(q, q) + q[3] * q[3]);
            for (int i = 0; i < 4; ++i) q[i] /= n;
        }
    }
}

}  // namespace

int64_t pose_room(const PoseProblem& p) {
    const int64_t n = p.columns, j = p.joints, k = p.wishes;
    return 2 * (j * 22 + k * 3 + 3) + n * 20 + j * 43 + n * (n + 1) * 3 / 2 + 8;
}

// One frame. room: `pose_room` doubles. Gives how many steps were tried.
int solve_pose(const PoseProblem& p, const PoseFrame& f, double* room) {
    const int64_t n = p.columns;
    auto take = [&room](int64_t count) {
        double* out = room;
        room += count;
        return out;
    };
    State now{take(p.joints * 4), take(p.joints * 3), take(3), take(p.joints * 12), take(p.wishes * 3)};
    State next{take(p.joints * 4), take(p.joints * 3), take(3), take(p.joints * 12), take(p.wishes * 3)};
    double *twist = take(n * 6), *mass = take(p.joints * 42), *pull = take(n), *step = take(n);
    double *fixed = take(n), *low = take(n), *high = take(n), *drift = take(n), *drift_next = take(n);
    auto whole = [&take](int64_t count) { return reinterpret_cast<int32_t*>(take((count + 1) / 2)); };
    int32_t* held = whole(n);
    Tree tree{whole(n), whole(n), whole(n), whole(p.joints), whole(n * (n + 1) / 2), 0};
    double *normal = take(n * (n + 1) / 2), *a = take(n * (n + 1) / 2);
    plant(p, tree);
    for (int64_t i = 0; i < p.joints * 4; ++i) now.rotation[i] = f.rotation[i];
    for (int64_t i = 0; i < p.joints * 3; ++i) now.angle[i] = f.angle[i];
    for (int i = 0; i < 3; ++i) now.shift[i] = f.shift[i];
    for (int64_t d = 0; d < n; ++d) {
        const int64_t j = p.column[d * 2];
        if (j < 0 || !p.limited[j]) continue;
        const double *box = p.box + (j * 3 + p.column[d * 2 + 1]) * 2, here = now.angle[j * 3 + p.column[d * 2 + 1]];
        low[d] = box[0] < here ? box[0] : here;
        high[d] = box[1] > here ? box[1] : here;
    }
    forward(p, now);
    errors(p, now, f);
    if (p.prior) drift_from(p, now, f, drift);
    double cost = cost_of(p, now, drift), mu = p.damping;
    int count = 0;
    bool busy = n > 0 && (p.prior || unmet(p, now)), fresh = true;
    double size = 0.0;
    while (busy && count < p.iterations) {
        if (fresh) {
            normal_equations(p, now, f, tree, twist, mass, normal, pull);
            size = 0.0;
            for (int64_t d = 0; d < n; ++d) size += normal[tree.start[d] + tree.depth[d]];
            size /= double(p.wishes ? p.wishes * 3 : 1);
            if (p.prior)
                for (int64_t d = 0; d < n; ++d) {
                    normal[tree.start[d] + tree.depth[d]] += p.prior[d] * p.give[d];
                    pull[d] -= p.prior[d] * drift[d] * std::sqrt(p.give[d]);
                }
        }
        const double damp = mu * size > 1e-15 ? mu * size : 1e-15;
        auto room_below = [&](int64_t d) {
            const int64_t j = p.column[d * 2];
            if (j < 0 || !p.limited[j]) return -double(INFINITY);
            const double v = low[d] - now.angle[j * 3 + p.column[d * 2 + 1]];
            return v < 0 ? v : 0.0;
        };
        auto room_above = [&](int64_t d) {
            const int64_t j = p.column[d * 2];
            if (j < 0 || !p.limited[j]) return double(INFINITY);
            const double v = high[d] - now.angle[j * 3 + p.column[d * 2 + 1]];
            return v > 0 ? v : 0.0;
        };
        for (int64_t d = 0; d < n; ++d) {
            held[d] = (room_below(d) >= 0 && pull[d] < 0) || (room_above(d) <= 0 && pull[d] > 0);
            fixed[d] = 0.0;
        }
        for (int sweep = 0; sweep < sweeps; ++sweep) {
            if (!step_of(tree, n, normal, damp, pull, held, fixed, a, step))
                for (int64_t d = 0; d < n; ++d) step[d] = held[d] ? fixed[d] : 0.0;
            bool over = false;
            for (int64_t d = 0; d < n; ++d) {
                if (held[d]) continue;
                const double g = std::sqrt(p.give[d]), v = step[d] * g, down = room_below(d), up = room_above(d);
                if (v >= down - 1e-15 && v <= up + 1e-15) continue;
                fixed[d] = (v < down ? down : up) / g;
                held[d] = 1;
                over = true;
            }
            if (!over) break;
        }
        double largest = 0.0;
        for (int64_t d = 0; d < n; ++d) {
            const double v = step[d] * std::sqrt(p.give[d]), down = room_below(d), up = room_above(d);
            step[d] = v < down ? down : v > up ? up : v;
            largest = std::fabs(step[d]) > largest ? std::fabs(step[d]) : largest;
        }
        if (largest > longest) {  // farther away the slopes mean nothing
            for (int64_t d = 0; d < n; ++d) step[d] *= longest / largest;
            largest = longest;
        }
        moved(p, now, step, low, high, next);
        forward(p, next);
        errors(p, next, f);
        if (p.prior) drift_from(p, next, f, drift_next);
        const double then = cost_of(p, next, drift_next);
        ++count;
        bool done = largest < 1e-6;
        fresh = then < cost;
        if (fresh) {
            done = done || cost - then <= p.idle * then;
            cost = then;
            const State kept = now;
            now = next;
            next = kept;
            double* other = drift;
            drift = drift_next;
            drift_next = other;
            for (int64_t d = 0; d < n; ++d) {
                const int64_t j = p.column[d * 2];
                if (j < 0 || !p.limited[j]) continue;
                const double *box = p.box + (j * 3 + p.column[d * 2 + 1]) * 2,
                             here = now.angle[j * 3 + p.column[d * 2 + 1]];
                const double least = box[0] < here ? box[0] : here, most = box[1] > here ? box[1] : here;
                low[d] = low[d] > least ? low[d] : least;
                high[d] = high[d] < most ? high[d] : most;
            }
            mu = mu * 0.2 > 1e-12 ? mu * 0.2 : 1e-12;
        } else {
            mu = (mu > 1e-9 ? mu : 1e-9) * 8;
        }
        busy = !done && mu <= stuck && (p.prior || unmet(p, now));
    }
    for (int64_t i = 0; i < p.joints * 4; ++i) f.rotation[i] = now.rotation[i];
    for (int64_t i = 0; i < p.joints * 3; ++i) f.angle[i] = now.angle[i];
    for (int i = 0; i < 3; ++i) f.shift[i] = now.shift[i];
    for (int64_t i = 0; i < p.wishes * 3; ++i) f.error[i] = now.error[i];
    return count;
}

}  // namespace vt::VT_NS
