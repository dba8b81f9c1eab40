"""One file a solver; each has NAME and solve(problem, lam, tol, state) → Answer."""
