"""Solvers of the hinge problem side by side: one objective, the data sets, one file a solver."""
