"""Can the parameters be told apart? Singular values of the scaled Jacobian, spread over restarts, and what a
residual proves.

The Jacobian is that of vec G(j omega) on a frequency grid with respect to relative parameter changes. A
direction with a vanishing singular value changes no response; a small one lets parameters drift far within
the present error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pwaid.errors import InputError
from pwaid.hinfstruct.problem import MatchingProblem, response_and_slope
from pwaid.hinfstruct.proxlinear import prox_linear
from pwaid.hinfstruct.restructure import Restructured
from pwaid.hinfstruct.smooth import parameter_scale
from pwaid.hinfstruct.statespace import freeze
from pwaid.hinfstruct.structured import StructuredModel

__all__ = ["Identifiability", "identifiability"]


@dataclass(frozen=True)
class Identifiability:
    """What the responses say about the parameters.

    Attributes
    ----------
    names : tuple of str
    singular_values : array
        Of d vec G / d log theta per root of grid points, decreasing.
    condition : float
    rank : int
        Singular values above 1e-9 of the largest.
    groups : tuple of tuples of str
        Sets of parameters that cannot be told apart: each is the support of directions that change no
        response.
    weakest : dict of str to float
        The weakest direction, unit length, entries above 0.1.
    spread : dict of str to float, or None
        Relative range of each parameter over restarts that reached the same error, where restarts were asked
        for.
    restart_values : array
        H-infinity error each restart reached.
    slack : dict of str to float, or None
        Relative change of each parameter that the linearised response can hide inside the present H-infinity
        error.
    warnings : tuple of str
    """

    names: tuple[str, ...]
    singular_values: np.ndarray
    condition: float
    rank: int
    groups: tuple[tuple[str, ...], ...]
    weakest: dict[str, float]
    spread: dict[str, float] | None
    restart_values: np.ndarray
    slack: dict[str, float] | None
    warnings: tuple[str, ...]

    def __post_init__(self):
        freeze(self)

    @property
    def identifiable(self) -> bool:
        """Locally identifiable: every direction changes the response."""
        return self.rank == len(self.names)


def identifiability(
    subject: StructuredModel | Restructured,
    theta=None,
    *,
    omega=None,
    restarts: int = 0,
    perturbation: float = 0.05,
    rng=None,
) -> Identifiability:
    """Report on the parameters of a structured model, or of a restructured one (then residual and restarts
    count too).

    Parameters
    ----------
    subject : StructuredModel or Restructured
    theta : array
        Needed for a StructuredModel.
    omega : array, optional
        Frequencies, rad/s; default around the poles.
    restarts : int
        Repeat the restructuring this often from perturbed theta (section 3.3.2 uses 10); only for a
        Restructured.
    perturbation : float
        Relative size of these perturbations.

    Raises
    ------
    InputError
        theta missing or of the wrong length, restarts without a Restructured, an unstable model.
    """
    result = subject if isinstance(subject, Restructured) else None
    model = result.model if result else subject
    if result is None and theta is None:
        raise InputError("identifiability of a StructuredModel needs theta=")
    if result is None and restarts:
        raise InputError(
            "restarts need a Restructured (there must be a target to fit); call restructure first"
        )
    theta = result.theta if result else model.check(theta)
    m = model.matrices(theta)
    if not m.stable:
        raise InputError("the model is unstable at this theta; its H-infinity error is not defined")
    if omega is None:
        size = np.abs(m.poles)
        omega = np.geomspace(size.min() / 30, 10 * size.max(), 120)
    _, slope = response_and_slope(model, theta, np.asarray(omega, dtype=float))
    flat = np.moveaxis(slope, 1, -1).reshape(-1, model.size) * parameter_scale(theta) / np.sqrt(len(omega))
    jacobian = np.vstack([flat.real, flat.imag])
    few = len(jacobian) < model.size  # then some directions are seen at no frequency
    _, singular, Vt = np.linalg.svd(jacobian, full_matrices=few)
    singular = np.pad(singular, (0, model.size - len(singular)))
    rank = int(np.sum(singular > 1e-9 * singular[0]))
    groups = _groups(Vt[rank:], model.names)
    weakest = {n: float(v) for n, v in zip(model.names, Vt[-1], strict=True) if abs(v) > 0.1}
    spread, values = _restarts(result, restarts, perturbation, rng) if restarts else (None, np.zeros(0))
    slack = _slack(result, singular, Vt, rank) if result else None
    warnings = _warnings(result, singular, groups, spread, slack)
    condition = float(singular[0] / singular[-1]) if singular[-1] > 0 else np.inf
    return Identifiability(
        model.names, singular, condition, rank, groups, weakest, spread, values, slack, tuple(warnings)
    )


def _groups(null: np.ndarray, names) -> tuple[tuple[str, ...], ...]:
    """Connected supports of the null directions: parameters that can only change together, unseen."""
    if not len(null):
        return ()
    projector = null.T @ null  # independent of the basis; block diagonal over the groups
    linked = np.abs(projector) > 1e-6
    left, groups = set(np.flatnonzero(np.diag(linked))), []
    while left:
        group, queue = set(), [min(left)]
        while queue:
            k = queue.pop()
            if k in group:
                continue
            group.add(int(k))
            queue.extend(set(np.flatnonzero(linked[k])) - group)
        left -= group
        groups.append(tuple(names[k] for k in sorted(group)))
    return tuple(groups)


def _restarts(result: Restructured, restarts: int, perturbation: float, rng):
    """Spread of theta over restarts that end within 1 % of the best error."""
    rng = np.random.default_rng(rng)
    problem = MatchingProblem.build(result.model, result.target)
    bound = problem.lower_bound()[0]
    thetas, values = [result.theta], [result.value]
    for _ in range(restarts):
        start = result.theta * (1 + perturbation * rng.uniform(-1, 1, result.theta.size))
        if not problem.stable(start):
            continue
        run = prox_linear(problem, start, target=bound)
        thetas.append(run.theta)
        values.append(run.value)
    values = np.array(values)
    same = np.array(thetas)[values <= 1.01 * values.min() + 1e-300]
    spread = np.ptp(same, axis=0) / parameter_scale(result.theta)
    return dict(zip(result.model.names, map(float, spread), strict=True)), values[1:]


def _slack(result: Restructured, singular, Vt, rank) -> dict[str, float]:
    """Largest relative change of each parameter with a linearised response change of at most the error, in
    mean square.
    """
    weight = np.zeros_like(singular)
    weight[:rank] = 1 / singular[:rank]
    reach = result.value * np.sqrt(np.sum((Vt * weight[:, None]) ** 2, axis=0))
    reach[np.abs(Vt[rank:]).max(axis=0, initial=0.0) > 1e-6] = np.inf
    return dict(zip(result.model.names, map(float, reach), strict=True))


def _warnings(result, singular, groups, spread, slack) -> list[str]:
    out = []
    if groups:
        listed = "; ".join("{" + ", ".join(g) + "}" for g in groups)
        out.append(
            f"no response tells these parameters apart: {listed}; fix some of them or change the outputs"
        )
    elif singular[-1] < 1e-4 * singular[0]:
        out.append(
            f"the weakest direction is {singular[-1] / singular[0]:.1e} of the strongest: its parameters "
            "are poorly fixed"
        )
    if result is None:
        return out
    if result.at_bound and result.lower_bound > 0:
        out.append(
            f"the error equals its structural lower bound ({result.bound_reason}): every theta with smaller "
            "errors elsewhere is "
            "equally good, so theta is not unique; use match_static_gain=True or a least-squares criterion"
        )
    if slack and max(slack.values()) > 0.05:
        name = max(slack, key=slack.get)
        out.append(
            f"a small residual does not prove the parameters: within the error reached, {name} may be off by "
            f"{100 * slack[name]:.3g} % and {sum(v > 0.05 for v in slack.values())} parameters by more than "
            "5 %"
        )
    if spread and max(spread.values()) > 0.01:
        name = max(spread, key=spread.get)
        out.append(f"restarts that reached the same error differ by {100 * spread[name]:.3g} % in {name}")
    return out
