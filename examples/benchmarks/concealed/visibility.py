"""How visible the effects of a case are: what each leaves after the best refit of everything else."""

from __future__ import annotations

from concealed import vector
from concealed.catalogue import RICHER_FRICTION
from concealed.drawn import Drawn
from concealed.refit import refit


def recorded_pairs(case, role):
    """`(u, noise-free y, x0)` of the recordings of one role, for a refit."""
    return [(r.u, r.free, r.x0) for r in case.recordings if r.role == role]


def nominal_with(case, known):
    """Nominal side with the effects in `known` (tuple of `Drawn`) put in at their true values."""
    p, e = case.nominal.copy(), case.e_nominal.copy()
    for d in known:
        e = vector.with_values(e, d.slots)
        for name, value in d.p.items():
            p[case.plant.index(name)] = value
        for name in d.nominal_switches:
            e[vector.INDEX[name]] = case.e[vector.INDEX[name]]
    e[vector.FRICTION_SIDE] = case.e[vector.FRICTION_SIDE]
    return p, e


def _sliding_level(case, drawn):
    """Level at which plain Coulomb friction starts when it has to imitate a richer dry friction."""
    s = drawn.slots
    if "load_factor" in s:
        return 0.8 * s["load_factor"] * case.facts["scene"].force
    if "dahl_level" in s:
        return s["dahl_level"]
    return 0.5 * (s["level_positive"] + s["level_negative"])


def measure(case):
    """Fill the margins: what each effect leaves after the best refit of everything else, in units of the
    noise."""
    hold = case.recipe.hold
    train, test = recorded_pairs(case, "train"), recorded_pairs(case, "test")
    targets = case.drawn or (None,)
    for d in targets:
        known = tuple(o for o in case.drawn if o is not d)
        p, e = nominal_with(case, known)
        fit = refit(case.plant, p, e, case.free, train, case.sigma, case.measured, hold=hold)
        held = refit(case.plant, fit.p, e, case.free, test, case.sigma, case.measured, hold=hold, move=False)
        name = d.id if isinstance(d, Drawn) else "everything"
        case.margins[name] = fit.ratio()
        if name in RICHER_FRICTION:
            start = dict.fromkeys(("level_positive", "level_negative"), _sliding_level(case, d))
            rival = vector.with_values(e, start)
            case.nested[name] = refit(case.plant, p, rival, case.free, train, case.sigma, case.measured,
                                      hold=hold,
                                      slots=(vector.LEVEL_POSITIVE, vector.LEVEL_NEGATIVE)).ratio()
        case.heldout_margins[name] = held.ratio()
    still = refit(case.plant, case.nominal, case.e_nominal, case.free, train, case.sigma, case.measured,
                  hold=hold,
                  move=False)
    case.facts["nominal_ratio"] = still.ratio()
    return case
