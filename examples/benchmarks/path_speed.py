"""How fast the certified λ path is: the engine against general solvers, on the same problems, in one run.

    python examples/benchmarks/path_speed.py [--quick] [--save DIR] [--only SECTION ...]

Sections: pyramid, tight, lambda_max, d3, growth, assembly, picture. Every solver runs on one thread. Ratios are of
CPU time, because other programs may share the machine; wall time is printed beside it. A slow rival solves only
some of the λ, evenly spread, and is compared with the engine's time for the same λ; the output says how many.
Ends with one line RESULT {json}.
"""

# ruff: noqa: E402  (the threads must be set before NumPy loads)

from __future__ import annotations

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import argparse
import json
import resource
import sys
import time
import warnings
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))

from path import datasets, highs
from path.objective import run
from path.picture import gap_against_time
from path.solvers import admm, clarabel_qp, engine, osqp_qp, piqp_qp
from scipy import sparse
from scipy.spatial import Delaunay

from pwaid.delaunay import SimplexMesh
from pwaid.engine import solve_engine
from pwaid.lambda_max import lambda_max
from pwaid.lerp import interpolation_matrix

TOL = 1e-4
# Iterations of the engine over which the time of one is averaged.
STEPS = 4
# Tolerances to try for a rival, loosest first; the first whose judged gap is within the one asked for counts.
LOOSENESS = (3.0, 1.0, 0.3, 0.1, 0.03)
SECTIONS = ("pyramid", "tight", "lambda_max", "d3", "growth", "assembly", "picture")


def say(text: str) -> None:
    print(text, flush=True)


def rival_time(solver, problem, lam, tol, state=None):
    """The shortest time in which the rival reaches the gap: its loosest setting that does."""
    for factor in LOOSENESS:
        judged = run(solver, problem, lam, factor * tol, state)
        if judged.gap <= tol:
            break
    say(
        f"    {solver.NAME:9s} λ {lam:9.3g}  asked {factor * tol:.0e}  gap {judged.gap:.1e}  "
        f"{judged.answer.iterations:6d} iterations  cpu {judged.cpu:7.2f} s  wall {judged.wall:7.2f} s"
    )
    return judged


def engine_path(problem, lambdas, tol, *, warm):
    """The engine over a grid; one judged answer a λ."""
    out, state = [], None
    for lam in lambdas:
        out.append(run(engine, problem, lam, tol, state if warm else None))
        state = out[-1].answer.state if warm else None
    return out


def total(judged) -> float:
    return sum(j.cpu for j in judged)


def compare(problem, lambdas, mine, solver, count, tol):
    """Rival over engine on `count` of the λ, taken in turn with a second engine solve as a check of the load."""
    chosen = np.unique(np.linspace(0, len(lambdas) - 1, count).round().astype(int))
    theirs = [rival_time(solver, problem, lambdas[i], tol) for i in chosen]
    ours = total([mine[i] for i in chosen])
    ratio = total(theirs) / ours
    reached = sum(j.gap <= tol for j in theirs)
    say(
        f"  {solver.NAME}: {len(chosen)} of {len(lambdas)} λ, {total(theirs):.1f} s against {ours:.2f} s: "
        f"{ratio:.1f} times; reached the gap at {reached} of {len(chosen)}"
    )
    return ratio, theirs


def pyramid_section(quick):
    problem = datasets.pyramid(1000 if quick else 8830)
    n_lambdas = 8 if quick else 30
    lambdas = lambda_max(problem) * np.geomspace(1.0, 1e-4, n_lambdas)
    engine.solve(problem, lambdas[0], 0.5)  # compile, order
    say(f"pyramid: N̂ = {problem.n_points}, {problem.n_hinges} hinges, {n_lambdas} λ, gap {TOL:g}")
    warm = engine_path(problem, lambdas, TOL, warm=True)
    cold = engine_path(problem, lambdas, TOL, warm=False)
    iterations = [sum(j.answer.iterations for j in js) for js in (warm, cold)]
    say(f"  engine: warm {total(warm):.2f} s, {iterations[0]} factorisations;")
    say(f"          cold {total(cold):.2f} s, {iterations[1]}")
    clarabel, _ = compare(problem, lambdas, warm, clarabel_qp, 3 if quick else 6, TOL)
    osqp, _ = compare(problem, lambdas, warm, osqp_qp, 2, TOL)
    compare(problem, lambdas, warm, piqp_qp, 2, TOL)
    compare(problem, lambdas, warm, admm, 2, TOL)
    return {
        "pyramid_ratio_clarabel": clarabel,
        "pyramid_ratio_osqp": osqp,
        "warm_over_cold": iterations[0] / iterations[1],
        "warm_over_cold_cpu": total(warm) / total(cold),
        "worst_gap": max(j.gap for j in warm),
        "pyramid_engine_s": total(warm),
    }


def tight_section(quick):
    problem = datasets.pyramid(1000 if quick else 8830)
    lambdas = lambda_max(problem) * np.geomspace(0.3, 1e-3, 3)
    engine.solve(problem, lambdas[0], 0.5)
    say(f"tight: gap 1e-8 at {len(lambdas)} λ")
    mine = engine_path(problem, lambdas, 1e-8, warm=False)
    say(f"  engine: {total(mine):.2f} s, gaps {[f'{j.gap:.0e}' for j in mine]}")
    ratio, _ = compare(problem, lambdas, mine, clarabel_qp, len(lambdas), 1e-8)
    return {"tight_ratio_clarabel": ratio, "tight_worst_gap": max(j.gap for j in mine)}


def lambda_max_section(quick):
    problem = datasets.pyramid(600 if quick else 8830)
    lambda_max(datasets.pyramid(100))  # compile
    began = time.process_time()
    found = lambda_max(problem)
    mine = time.process_time() - began
    value, theirs = highs.lambda_max(problem, time_limit=500.0)
    say(f"lambda_max: [{found.lower:.8g}, {found.upper:.8g}] in {mine:.2f} s; HiGHS {value:.8g} in {theirs:.1f} s")
    return {"lambda_max_ratio_highs": theirs / mine, "lambda_max_width": found.width}


def d3_section(quick):
    problem = datasets.friction_actuator(400 if quick else 10_000, 3000 if quick else 100_000)
    n_lambdas = 5 if quick else 20
    engine.solve(problem, float(np.abs(problem.c).max()), 0.9)
    lambda_max(datasets.friction_actuator(400, 3000))  # compile
    began = time.process_time()
    top = lambda_max(problem)
    top_s = time.process_time() - began
    lambdas = top * np.geomspace(1.0, 1e-4, n_lambdas)
    say(f"d = 3: N̂ = {problem.n_points}, {problem.n_hinges} hinges, N = {problem.n_samples}, {n_lambdas} λ")
    mine = engine_path(problem, lambdas, TOL, warm=True)
    say(
        f"  engine: {total(mine):.1f} s, {sum(j.answer.iterations for j in mine)} factorisations, "
        f"worst gap {max(j.gap for j in mine):.1e}; λmax {top_s:.2f} s, width {top.width:.0e}"
    )
    best = None
    chosen = [n_lambdas // 2]
    for backend in ("faer", "qdldl") if quick else ("faer",):
        clarabel_qp.BACKEND = backend
        theirs = [run(clarabel_qp, problem, lambdas[i], 0.3 * TOL) for i in chosen]
        worst = max(j.gap for j in theirs)
        say(f"  Clarabel {backend}: {len(chosen)} of {n_lambdas} λ, {total(theirs):.1f} s, worst gap {worst:.1e}")
        best = total(theirs) if best is None else min(best, total(theirs))
    clarabel_qp.BACKEND = "auto"
    per_lambda = total(mine) / n_lambdas
    return {
        "d3_ratio_clarabel": best / total([mine[i] for i in chosen]),
        "d3_worst_gap": max(j.gap for j in mine),
        "d3_seconds_per_lambda": per_lambda,
        "d3_lambda_max_over_one_lambda": top_s / per_lambda,
    }


def growth_section(quick):
    """2014 Fig. 5 redrawn: CPU time of a factorisation and of one iteration of the engine over N̂ in d = 2."""
    sizes = (500, 1000, 2000) if quick else (1000, 3000, 10_000, 30_000, 100_000)
    rows = []
    for n in sizes:
        problem = datasets.pyramid(n)
        K, weights, lam = problem.normal_matrix, 1.0 / problem.row_norms**2, 1e-3 * np.abs(problem.c).max()
        factor = shortest(lambda K=K, w=weights: K.factorise(w), max(5, 30_000 // n))
        iteration = shortest(
            lambda p=problem, lam=lam: solve_engine(p, lam, tol=1e-12, max_iterations=STEPS), max(3, 10_000 // n)
        )
        rows.append((problem.n_points, factor, iteration / STEPS, 8e-6 * (K.tree.n_stored + K.tree.stack_starts[1])))
        say(f"growth: N̂ = {n}: factorisation {1e3 * factor:.2f} ms, iteration {1e3 * rows[-1][2]:.2f} ms, "
            f"L and stack {rows[-1][3]:.1f} MB")  # fmt: skip
    n, factor, iteration = (np.log([r[k] for r in rows]) for k in range(3))
    exponents = [float(np.polyfit(n, t, 1)[0]) for t in (factor, iteration)]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    say(f"growth: exponents {exponents[0]:.2f} (factorisation), {exponents[1]:.2f} (iteration); peak {peak:.0f} MB")
    return {
        "growth_exponent": max(exponents),
        "growth_factorisation_exponent": exponents[0],
        "growth_iteration_exponent": exponents[1],
        "memory_mb": rows[-1][3],
    }


def shortest(job, repeats):
    """The least CPU time of several runs."""
    times = []
    for _ in range(repeats):
        began = time.process_time()
        job()
        times.append(time.process_time() - began)
    return min(times)


def assembly_section(quick):
    """A for a million points against SciPy's point location; the smallest ratio of d = 2 and 3 counts."""
    n_points, n = (1000, 50_000) if quick else (10_000, 1_000_000)
    ratios, worst = [], 0.0
    for d in (2, 3):
        rng = np.random.default_rng(d)
        mesh = SimplexMesh.uniform([[-1.0, 1.0]] * d, n_points, rng)
        judge = Delaunay(mesh.normalised)
        X = rng.uniform(-1.0, 1.0, (n, d))
        interpolation_matrix(mesh, X[:100])  # compile
        mine = shortest(lambda m=mesh, X=X: interpolation_matrix(m, X), 3)
        theirs = shortest(lambda j=judge, m=mesh, X=X: scipy_matrix(j, m.scaling.apply(X)), 3)
        difference = interpolation_matrix(mesh, X) - scipy_matrix(judge, mesh.scaling.apply(X))
        ratios.append(theirs / mine)
        worst = max(worst, float(abs(difference).max()))
        say(f"assembly d = {d}: {mine:.2f} s against SciPy's {theirs:.2f} s; weights differ by {worst:.1e}")
    return {"assembly_ratio": min(ratios), "assembly_difference": worst}


def scipy_matrix(judge, Z):
    """A by `find_simplex` and `transform`."""
    d = Z.shape[1]
    simplex = judge.find_simplex(Z)
    T = judge.transform[simplex]
    first = np.einsum("nij,nj->ni", T[:, :d], Z - T[:, d])
    weights = np.column_stack([first, 1.0 - first.sum(axis=1)])
    indptr = np.arange(0, weights.size + 1, d + 1)
    return sparse.csr_matrix((weights.ravel(), judge.simplices[simplex].ravel(), indptr), (len(Z), judge.npoints))


def picture_section(quick, save):
    problem = datasets.pyramid(600 if quick else 8830)
    lam = 0.01 * lambda_max(problem)
    engine.solve(problem, lam, 0.5)
    tolerances = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5) if quick else (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-8)
    curves = {}
    for solver, tightest in ((engine, 1e-8), (clarabel_qp, 1e-8), (piqp_qp, 1e-8), (admm, 1e-5), (osqp_qp, 1e-4)):
        points = [run(solver, problem, lam, tol) for tol in tolerances if tol >= tightest]
        curves[solver.NAME] = [(j.cpu, j.gap) for j in points]
        say(f"picture: {solver.NAME:9s} " + "  ".join(f"{t:.2f} s: {g:.0e}" for t, g in curves[solver.NAME]))
    if save:
        gap_against_time(curves, Path(save) / "path_speed.png")
    return {}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="small problems, under a minute")
    parser.add_argument("--save", help="folder for the picture")
    parser.add_argument("--only", nargs="+", choices=SECTIONS, default=SECTIONS)
    options = parser.parse_args()
    warnings.filterwarnings("ignore", message="Converting sparse A")
    sections = {
        "pyramid": pyramid_section,
        "tight": tight_section,
        "lambda_max": lambda_max_section,
        "d3": d3_section,
        "growth": growth_section,
        "assembly": assembly_section,
        "picture": lambda quick: picture_section(quick, options.save),
    }
    result = {"threads": 1, "quick": options.quick}
    for name in options.only:
        result.update(sections[name](options.quick))
    gaps = [result[k] for k in ("worst_gap", "d3_worst_gap") if k in result]
    if gaps:
        result["worst_gap"] = max(gaps)
    print("RESULT " + json.dumps({k: float(f"{v:.4g}") if isinstance(v, float) else v for k, v in result.items()}))


if __name__ == "__main__":
    main()
