"""H-infinity norms, subspace models, restructuring and LPV interpolation (Vizer et al. 2014)."""
