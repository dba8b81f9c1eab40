"""H-infinity norms, subspace models, structured models, restructuring and LPV interpolation (Vizer et al. 2014)."""
