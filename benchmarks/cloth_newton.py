"""The sheet on a ball of benchmarks/cloth.py, beside the solvers of newton (NVIDIA and others, Apache-2.0) on the CPU.

Run: VITRUVIAN_NEWTON=/path/to/python python benchmarks/cloth_newton.py [--quick], where that python has newton, as
`pip install newton` makes it. The peer runs in a process of its own, on the same triangles, ball, density and stiffness,
with as many substeps and iterations as named; both fall for the same time. Its frames take long: few are timed, while the
cloth lies on the ball.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

FRAMES, QUICK = 20, 10  # of 1/60 s: the sheet has touched down, and hangs over
GAP = 0.002
GOALS = {"5k": 50, "20k": 40}  # times faster than VBD 10x4; with contact of the cloth with itself, 20
TOUCHING = 20


def rows(quick: bool = False) -> list[dict[str, object]]:
    """The benchmark's rows; none that compare where newton is not."""
    from _rows import row
    from cloth import CASES, square

    python = os.environ.get("VITRUVIAN_NEWTON", "")
    if not python:
        print("cloth_newton: newton is not here; set VITRUVIAN_NEWTON to a python that has it", file=sys.stderr)
        return []
    out: list[dict[str, object]] = []
    frames = QUICK if quick else FRAMES
    for size, name, _ in CASES[: 1 if quick else None]:
        sheet, start = square(size)
        for solver, gap, goal in (
            ("vbd 10x4", 0.0, GOALS[name]),
            ("vbd 10x4", GAP, TOUCHING),
            ("style3d 2x10", GAP, TOUCHING),
        ):
            theirs, his = _peer(python, solver, sheet, start, gap, frames)
            ours, mine = _ours(sheet, start, gap, frames)
            what = f"sheet on a ball{', touching itself' if gap else ''}, {name}: {len(sheet.triangles)} triangles"
            more = {"strain_p99": mine, "peer_strain_p99": his, "frames": frames}
            out.append(
                row(what, ours, f"newton {solver}", theirs, theirs / ours, f">= {goal}", theirs >= goal * ours, **more)
            )
    return out


def _ours(sheet, start: np.ndarray, gap: float, frames: int) -> tuple[float, float]:
    """Seconds a frame (median of the later half), and p99 strain at the end."""
    from cloth import ball

    from vitruvian.cloth.sheet import strains
    from vitruvian.cloth.solver import assemble, step, substeps_for

    cloth, obstacle = assemble(sheet, gap=gap), ball()
    state, times, substeps = cloth.state(start), [], substeps_for(cloth)
    for _ in range(frames):
        began = time.perf_counter()
        state = step(cloth, state, obstacle=obstacle, substeps=substeps)
        times.append(time.perf_counter() - began)
    return float(np.median(times[frames // 2 :])), float(np.quantile(np.abs(strains(sheet, state.x)), 0.99))


def _peer(python: str, solver: str, sheet, start: np.ndarray, gap: float, frames: int) -> tuple[float, float]:
    from vitruvian.cloth.sheet import strains

    fabric = sheet.fabrics[0]
    with tempfile.TemporaryDirectory() as folder:
        scene, result = Path(folder) / "scene.npz", Path(folder) / "result.npz"
        np.savez(scene, start=start, triangles=sheet.triangles, density=fabric.density, stretch=fabric.stretch_u,
                 shear=fabric.shear, bend=fabric.bend_u, gap=gap, radius=0.25, frames=frames)  # fmt: skip
        done = subprocess.run(
            [python, __file__, "--peer", solver, str(scene), str(result)], capture_output=True, text=True, timeout=3000,
            check=False,
        )  # fmt: skip
        if done.returncode:
            raise RuntimeError(done.stderr[-2000:])
        with np.load(result) as found:
            return float(found["frame"]), float(np.quantile(np.abs(strains(sheet, found["x"])), 0.99))


def _newton(solver: str, scene_file: str, result_file: str) -> None:
    """In the peer's process: newton only."""
    import newton
    import warp as wp

    wp.config.quiet = True
    wp.set_device("cpu")
    scene = np.load(scene_file)
    name, numbers = solver.split()
    substeps, iterations = (int(n) for n in numbers.split("x"))
    gap, stretch = float(scene["gap"]), float(scene["stretch"])
    builder = newton.ModelBuilder(up_axis=newton.Axis.Y, gravity=(0.0, -9.81, 0.0))
    if name == "style3d":
        newton.solvers.SolverStyle3D.register_custom_attributes(builder)
    common = {
        "pos": wp.vec3(0.0, 0.0, 0.0), "rot": wp.quat_identity(), "scale": 1.0, "vel": wp.vec3(0.0, 0.0, 0.0),
        "vertices": [wp.vec3(*map(float, p)) for p in scene["start"]],
        "indices": scene["triangles"].ravel().tolist(), "density": float(scene["density"]),
        "particle_radius": 0.002,
    }  # fmt: skip
    if name == "style3d":
        from newton.solvers import style3d

        points = scene["start"]
        style3d.add_cloth_mesh(
            builder, panel_verts=[wp.vec2(float(p[0]), float(p[2])) for p in points],
            panel_indices=scene["triangles"].ravel().tolist(),
            tri_aniso_ke=wp.vec3(stretch, stretch, float(scene["shear"])),
            edge_aniso_ke=wp.vec3(*[float(scene["bend"])] * 3), **common,
        )  # fmt: skip
    else:
        builder.add_cloth_mesh(
            tri_ke=stretch / 2,
            tri_ka=stretch / 2,
            tri_kd=1e-6 * stretch,
            edge_ke=float(scene["bend"]),
            edge_kd=0.0,
            **common,
        )
        builder.color(include_bending=True)
    builder.add_shape_sphere(body=-1, radius=float(scene["radius"]))
    model = builder.finalize(device="cpu")
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_mu = 1e4, 1e-4, 0.4
    if name == "style3d":
        made = newton.solvers.SolverStyle3D(
            model=model, config=newton.solvers.SolverStyle3D.Config(iterations=iterations)
        )
    else:
        made = newton.solvers.SolverVBD(
            model, iterations=iterations, particle_enable_self_contact=gap > 0,
            **({"particle_self_contact_margin": 1.5 * gap, "particle_self_contact_gap": gap} if gap else {}),
        )  # fmt: skip
    now, then, control = model.state(), model.state(), model.control()
    pipeline = newton.CollisionPipeline(model)
    contacts = pipeline.contacts()
    times = []
    for _ in range(int(scene["frames"])):
        began = time.perf_counter()
        for _ in range(substeps):
            now.clear_forces()
            pipeline.collide(now, contacts)
            made.step(now, then, control, contacts, 1 / 60 / substeps)
            now, then = then, now
        wp.synchronize()
        times.append(time.perf_counter() - began)
    x = now.particle_q.numpy()
    np.savez(result_file, frame=np.median(times[len(times) // 2 :]), x=x)
    print(json.dumps({"frame": float(np.median(times)), "low": float(x[:, 1].min())}))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--peer"]:
        _newton(*sys.argv[2:])
    else:
        from _rows import main

        main(__doc__, rows)
