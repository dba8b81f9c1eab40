"""Pieces of text of repaired_simulator.py; what stands in «» is filled in by `pwaid.mismatch.repaired`."""

from __future__ import annotations

from collections.abc import Mapping

__all__ = ["ACCELERATIONS", "ARGUMENTS_BUILD", "AVERAGED", "BUILD", "CARRIED", "COLUMN_CARRIED", "DELAY",
           "DELAYED_AT_SAMPLE", "DISCRETE_FRICTION", "DISCRETE_STEP", "DRY_STEP", "FRICTION", "FRICTION_IN_RATES",
           "GIVEN", "LINEAR_BUILD", "OWN", "PLANT", "REMEMBER", "RUNGE_KUTTA_STEP", "SENSOR_MEMORY", "SHOW_RATES",
           "SIMULATE", "UPDATE", "filled", "rule"]


def rule(title: str) -> str:
    """A comment line that opens a part of the file."""
    return f"# {'-' * 20} {title} {'-' * 20}\n"


def filled(text: str, values: Mapping[str, object]) -> str:
    """The text with every «NAME» replaced; lines that only hold an empty one go."""
    for name, value in values.items():
        if value == "":
            text = text.replace(f"«{name}»\n", "")
        text = text.replace(f"«{name}»\n", f"{str(value).rstrip(chr(10))}\n").replace(f"«{name}»", str(value))
    return text


PLANT = '''
def make_repaired(nominal_update, nominal_output, others=None):
    """Update and output functions of the repaired simulator around those of the nominal one.

    others: what the nominal params hold besides numbers.
    """
«CARRIES»
    def nominal(t, state, inputs, params):
        params = {**(others or {}), **params}
        found = np.asarray(nominal_update(t, state[:«NX»], inputs, params), dtype=float).ravel()
        return «FOUND»

    def through(t, h, state, inputs, params):
        """The state, inputs and parameters that the nominal equations see."""
        seen, inputs, params = state.copy(), inputs.copy(), dict(params)
«SEEN»
        return seen, inputs, params

    def derivative(t, h, state, inputs, params«MOVED»):
        """Derivatives of all states«DISCRETELY»."""
        (seen, inputs, params), rates = through(t, h, state, inputs, params), np.zeros(state.size)
        rates[:«NX»] = nominal(t, seen«BEFORE», inputs, params)
«OWN»
«RATES»
«CARRIED»
        return rates
'''

RUNGE_KUTTA_STEP = '''
    def step(t, h, state, inputs, params):
        """One Runge-Kutta step with the input held."""
«MEMORY_CALLS»
        k1 = derivative(t, h, state, inputs, params)
        k2 = derivative(t + h / 2, h, state + h / 2 * k1, inputs, params)
        k3 = derivative(t + h / 2, h, state + h / 2 * k2, inputs, params)
        k4 = derivative(t + h, h, state + h * k3, inputs, params)
        return state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
'''

DISCRETE_STEP = '''
    def step(t, h, state, inputs, params):
        """One sample of the nominal simulator«MEAN»."""
«MEMORY_CALLS»
        before = state
        moved = h * derivative(t, h, state, inputs, params)
«AVERAGED»
        state = state + moved
«FRICTION_AT_REST»
        return state
'''

FRICTION = '''
    # dry friction: its level, its parameters, the state that is its speed, and what its force acts on
    dry_friction = [
«DRY»
    ]

    def mobility(t, state, inputs, params, acts_on):
        """What a unit of force adds to the derivatives."""
        kind, index, inertia = acts_on
        column = np.zeros(state.size)
        if kind != "rate":
            more = inputs.copy()
            more[index] += 1.0 if kind == "input" else -1.0
            column[:«NX»] = nominal(t, state, more, params) - nominal(t, state, inputs, params)
        else:
            column[index] = 1.0 if inertia is None else 1.0 / params[inertia]
«COLUMN_CARRIED»
«MOBILITY»
        return column

    def pull_towards_rest(h, state, speed, size, column):
        """Change the speed by at most what friction can do in h; it stops there, it does not reverse."""
        v, gain = state[speed], column[speed]
        if gain != 0.0:
            reach = h * abs(gain) * max(size, 0.0)
            stopped = v - reach if v > reach else (v + reach if v < -reach else 0.0)
            state += column * (stopped - v) / gain
            state[speed] = stopped
'''

OWN = "        own = rates.copy()"

CARRIED = '''        for i, j, share in carried:
            rates[i] += share * (rates[j] - own[j])'''

AVERAGED = "        moved = 0.5 * (moved + h * derivative(t, h, state + moved, inputs, params, moved))"

COLUMN_CARRIED = '''            for i, j, share in carried:
                column[i] += share * column[j] * (j == index)'''

DISCRETE_FRICTION = '''        for level, values, speed, acts_on in dry_friction:
            size = level(t, h, state, before, *through(t, h, before, inputs, params)[1:], **values)
            pull_towards_rest(h, state, speed, size, mobility(t, before, inputs, params, acts_on))'''

DRY_STEP = '''
    def step(t, h, state, inputs, params):
        """One step; where a sliding body reverses, stops or starts inside it, eight short ones."""
        end = smooth_step(t, h, state, inputs, params, sliding(state))
        if not event(state, end):
            return end
        h = h / 8
        for piece in range(8):
            now = t + piece * h
            end = smooth_step(now, h, state, inputs, params, sliding(state))
            if sliding(state) and event(state, end):
                end = smooth_step(now, h, state, inputs, params, False)
            state = end
        return state

    def sliding(state):
        return all(state[speed] != 0.0 for _, _, speed, _ in dry_friction)

    def event(a, b):
        return any(a[i] * b[i] <= 0.0 and (a[i] != 0.0 or b[i] != 0.0) for _, _, i, _ in dry_friction)

    def smooth_step(t, h, state, inputs, params, slides):
        """A Runge-Kutta step: friction is a force against the motion while sliding, else it acts at the end."""
        columns = [mobility(t, state, inputs, params, acts_on) for _, _, _, acts_on in dry_friction]
        along = [column * np.sign(column[speed]) * np.sign(state[speed])  # the motion the step begins with
                 for (_, _, speed, _), column in zip(dry_friction, columns)]
        state = state.copy()
«MEMORY_CALLS»
        before = state.copy()

        def total(t, state):
            rates, given = derivative(t, h, state, inputs, params), through(t, h, state, inputs, params)[1:]
            for (level, values, _, _), column in zip(dry_friction, along if slides else []):
                rates -= level(t, h, state, state, *given, **values) * column
            return rates

        k1 = total(t, state)
        k2 = total(t + h / 2, state + h / 2 * k1)
        k3 = total(t + h / 2, state + h / 2 * k2)
        k4, given = total(t + h, state + h * k3), through(t + h, h, state + h * k3, inputs, params)[1:]
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        if not slides:
            free = state.copy()
            for (level, values, speed, _), column in zip(dry_friction, columns):
                size = level(t, h, state, before, *given, **values)
                pull_towards_rest(h, state, speed, size, column)
            for i, (v, ratio) in enumerate(zip(«SPEED_OF», «SPEED_RATIO»)):  # speed of each position, and their ratio
                if v >= 0:
                    rests = before[v] == 0.0 and state[v] == 0.0
                    state[i] = before[i] if rests else state[i] + 0.5 * h * ratio * (state[v] - free[v])
        return state
'''

DELAY = '''
    delays = [«DELAYS»]  # input, seconds
    history = {}

    def remember(t, inputs):
        history[round(t / SAMPLE_TIME)] = inputs.copy()

    def delayed(t, inputs):
        """The command that each delayed channel sees: its mean over the step, samples before the first repeat it."""
        seen = inputs.copy()
        for j, delay in delays:
            a = (t - delay) / SAMPLE_TIME
            b = a + 1.0 / «STEPS»
            first, last = int(np.floor(a + 1e-9)), int(np.floor(b - 1e-9))
            old, new = (history.get(max(i, 0), inputs)[j] for i in (first, last))
            share = 1.0 if first == last else (last - a) / (b - a)
            seen[j] = share * old + (1.0 - share) * new
        return seen
'''

ACCELERATIONS = '''
    rates_shown = «RATES_SHOWN»  # output, the state whose rate it shows, output per rate

    def show_rates(t, state, inputs, params, seen, inputs_seen, params_seen, outputs):
        """Add to outputs that show the rate of a state what the laws add to it, friction at rest included."""
        h, rates = SAMPLE_TIME / SUBSTEPS, np.zeros(state.size)
        plain = nominal(t, state, inputs_seen, params_seen)
        rates[:«NX»] = nominal(t, seen, inputs_seen, params_seen)
«RATES_SEEN»
        brief = «INSTANT» * h
        moved = state + brief * rates
«FRICTION_IN_RATES»
        for k, i, gain in rates_shown:
            outputs[k] += gain * ((moved[i] - state[i]) / brief - plain[i])
'''

FRICTION_IN_RATES = '''        for level, values, speed, acts_on in dry_friction:
            size = level(t, brief, moved, state, inputs_seen, params_seen, **values)
            pull_towards_rest(brief, moved, speed, size, mobility(t, state, inputs, params, acts_on))'''

GIVEN = '''        given = inputs.copy(), dict(params)'''

SHOW_RATES = '''        show_rates(t, state, *given, seen, inputs, params, outputs)'''

REMEMBER = '''        remember(t, inputs)'''

DELAYED_AT_SAMPLE = '''        inputs = delayed(t, inputs)'''

SENSOR_MEMORY = '''        measure(t, state, inputs, params)  # the sensor's memory moves on'''

UPDATE = '''
    def measure(t, state, inputs, params):
        """Outputs at a sample."""
        inputs, params = inputs.copy(), dict(params)
«DELAYED_AT_SAMPLE»
«GIVEN»
«SEEN_AT_SAMPLE»
        if nominal_output is None:
            outputs = state[:«NX»].copy()
        else:
            everything = {**(others or {}), **params}
            outputs = np.array(nominal_output(t, state[:«NX»], inputs, everything), dtype=float).ravel()
«SHOW_RATES»
«SENSORS»
        return outputs

    def prepared(x, u, params):
        return np.array(x, dtype=float), np.array(u, dtype=float).ravel(), {**REFITTED, **(params or {})}

    def update(t, x, u, params, later=None):
        """The states one sample later; with `later`, the input runs straight to that value."""
        state, inputs, params = prepared(x, u, params)
«REMEMBER»
«SENSOR_MEMORY»
        for k in range(«STEPS»):
            now = t + k * SAMPLE_TIME / «STEPS»
            held = inputs if later is None else inputs + (k + 0.5) / «STEPS» * (np.ravel(later) - inputs)
            state = step(now, SAMPLE_TIME / «STEPS», state, «DELAYED_CALL», params)
        return state

    def output(t, x, u, params):
        return measure(t, *prepared(x, u, params))

    return update, output
'''

BUILD = '''
def build():
    """The repaired simulator as a discrete-time control.nlsys."""
    system = «SYSTEM»
    others = {k: v for k, v in (system.params or {}).items() if k not in REFITTED}
    update, output = make_repaired(system.updfcn, system.outfcn, others)
    return control.nlsys(update, output, inputs=list(system.input_labels), outputs=list(system.output_labels),
                         states=list(system.state_labels) + MEMORY, params=dict(REFITTED), dt=SAMPLE_TIME,
                         name="repaired")
'''

LINEAR_BUILD = '''
def build():
    """The repaired simulator as a discrete-time control.nlsys."""
    system = nominal_build()
    system = realise(system) if isinstance(system, control.TransferFunction) else control.ss(system)

    def matrix(name, params):
        M = np.array(getattr(system, name))
        return np.array([[params[f"{name}[{i},{j}]"] for j in range(M.shape[1])] for i in range(M.shape[0])]
                        ).reshape(M.shape)

    def nominal_update(t, x, u, params):
        return matrix("A", params) @ x + matrix("B", params) @ u

    def nominal_output(t, x, u, params):
        return matrix("C", params) @ x + matrix("D", params) @ u

    update, output = make_repaired(nominal_update, nominal_output)
    return control.nlsys(update, output, inputs=list(system.input_labels), outputs=list(system.output_labels),
                         states=list(system.state_labels) + MEMORY, params=dict(REFITTED), dt=SAMPLE_TIME,
                         name="repaired")
'''

ARGUMENTS_BUILD = '''
def build():
    """The repaired simulator as a discrete-time control.nlsys."""
    system = nominal_build()
    linear, last = not isinstance(system, control.NonlinearIOSystem) or hasattr(system, "A"), {}

    def built(params):
        values = {n: params[n] for n in «ARGUMENTS»}
        if last.get("values") != values:
            found = nominal_build(**values)
            last.update(values=values, system=realise(found) if isinstance(found, control.TransferFunction) else found)
        return last["system"]

    def inner(found, params):
        return {**(found.params or {}), **{n: v for n, v in params.items() if n not in «ARGUMENTS»}}

    def nominal_update(t, x, u, params):
        found = built(params)
        return found.A @ x + found.B @ u if linear else found.updfcn(t, x, u, inner(found, params))

    def nominal_output(t, x, u, params):
        found = built(params)
        if linear:
            return found.C @ x + found.D @ u
        return x if found.outfcn is None else found.outfcn(t, x, u, inner(found, params))

    update, output = make_repaired(nominal_update, nominal_output)
    return control.nlsys(update, output, inputs=list(system.input_labels), outputs=list(system.output_labels),
                         states=list(built(REFITTED).state_labels) + MEMORY, params=dict(REFITTED), dt=SAMPLE_TIME,
                         name="repaired")
'''

SIMULATE = '''
def simulate(t, u, x0, interpolated=«INTERPOLATED»):
    """Outputs (N, ny) over a recording.

    t (N,) s; u (N, nu), held between samples, or running straight from one to the next when `interpolated`;
    x0: the nominal states at the start.
    """
    system = build()
    u = np.asarray(u, dtype=float).reshape(len(t), -1)
    state = np.concatenate([np.asarray(x0, dtype=float), np.zeros(len(MEMORY))])
«STARTS»
    y = []
    for k in range(len(t)):
        y.append(system.outfcn(k * SAMPLE_TIME, state, u[k], REFITTED))
        later = u[min(k + 1, len(t) - 1)] if interpolated else None
        state = system.updfcn(k * SAMPLE_TIME, state, u[k], REFITTED, later)
    return np.array(y)
'''
