"""State space of a transfer function, with several inputs and outputs too."""

from __future__ import annotations

import control
import numpy as np

__all__ = ["realise"]


def realise(system):
    """A control.StateSpace of a control.TransferFunction, entry by entry: not minimal, but exact."""
    if system.ninputs == 1 and system.noutputs == 1:
        return control.ss(system)
    entries = [(i, j, control.ss(system[i, j])) for i in range(system.noutputs) for j in range(system.ninputs)]
    n = sum(e.nstates for _, _, e in entries)
    A, B = np.zeros((n, n)), np.zeros((n, system.ninputs))
    C, D = np.zeros((system.noutputs, n)), np.zeros((system.noutputs, system.ninputs))
    k = 0
    for i, j, e in entries:
        own = slice(k, k + e.nstates)
        A[own, own], B[own, j], C[i, own], D[i, j] = e.A, e.B[:, 0], e.C[0], e.D[0, 0]
        k += e.nstates
    return control.ss(A, B, C, D, system.dt, inputs=system.input_labels, outputs=system.output_labels)
