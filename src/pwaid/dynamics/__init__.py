"""NARX models with free-run simulation, and continuous-time piecewise-affine systems with located events."""
