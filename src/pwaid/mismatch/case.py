"""The case folder: case.toml, the nominal simulator, and CSV recordings."""

from __future__ import annotations

import importlib.util
import itertools
import linecache
import math
import sys
import tokenize
import tomllib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from pwaid.errors import InputError
from pwaid.mismatch.built import with_arguments
from pwaid.mismatch.plant import Plant, as_plant
from pwaid.mismatch.units import check_unit
from pwaid.recording import Recording

__all__ = ["Case", "load_case", "write_case"]

_KEYS = {"simulator", "time", "train", "test", "free_parameters", "inputs", "outputs", "noise_floor",
         "repeats", "hold",
         "controller", "references", "tolerances", "closed_loop", "name", "title", "description"}
_serial = itertools.count()


@dataclass(frozen=True)
class Case:
    """A checked case: the plant, recordings to train and test on, and what the user says about them."""

    plant: Plant
    train: tuple[Recording, ...]
    test: tuple[Recording, ...]
    free: tuple[str, ...] | None
    input_units: tuple[str, ...]
    output_units: tuple[str, ...]
    noise_floor: Mapping[str, float] = field(default_factory=dict)
    repeats: tuple[tuple[str, ...], ...] = ()
    first_order_hold: bool = False
    closed_loop: bool = False
    tolerances: Mapping[str, float] = field(default_factory=dict)
    simulator_source: str = ""
    controller: object = None
    references: Mapping[str, np.ndarray] = field(default_factory=dict)


def load_case(folder) -> Case:
    """Read and check a case folder.

    Raises
    ------
    InputError
        One line that says what came, what was expected, and what to do.
    """
    folder = Path(folder)
    path = folder / "case.toml"
    table = _read_toml(path)
    train, test = _recording_names(path, table)
    inputs, outputs = dict(table["inputs"]), dict(table["outputs"])
    if not outputs:
        raise InputError(f"{path} lists no outputs; expected at least one column under [outputs]")
    for name, unit in (inputs | outputs | dict(table.get("references", {}))).items():
        try:
            check_unit(str(unit))
        except InputError as error:
            raise InputError(f"column {name!r}: {error}") from error
    references = dict(table.get("references", {}))
    units = {**inputs, **outputs, **references}
    for name in (*train, *test):
        if not (folder / name).is_file():
            raise InputError(f"{folder / name} does not exist; expected a recording listed in case.toml")
    free = table.get("free_parameters")
    plant, source = _load_simulator(folder / table["simulator"], inputs, outputs, free)
    inputs, outputs = ({n: units[n] for n in names} for names in (plant.input_names, plant.output_names))

    controller = None
    if "controller" in table:
        wanted = "a control system from (references, measured outputs) to the plant inputs"
        controller, *_ = _build(folder / table["controller"], "controller", wanted)
    elif references:
        raise InputError(f"{path} has [references] and no controller; name controller = \"controller.py\", or leave "
                         "them out")

    def read(name, columns=inputs):
        try:
            return Recording.from_csv(folder / name, list(columns), list(outputs), time=table.get("time", "t"),
                                      units=units).replace(name=name)
        except InputError as error:
            raise InputError(str(error) if name in str(error) else f"{name}: {error}") from error

    hold = table.get("hold", "zero")
    if hold not in ("zero", "first"):
        raise InputError(f"hold = {hold!r}; expected 'zero' or 'first'")
    floor = dict(table.get("noise_floor", {}))
    strange = [k for k in floor if k not in outputs]
    if strange:
        raise InputError(f"noise_floor names {strange[0]!r}, which is not an output; expected one of {list(outputs)}")
    return Case(plant, tuple(read(n) for n in train), tuple(read(n) for n in test),
                None if free is None else tuple(free), tuple(inputs.values()), tuple(outputs.values()), floor,
                tuple(tuple(g) for g in table.get("repeats", [])), hold == "first",
                bool(table.get("controller") or table.get("closed_loop")), dict(table.get("tolerances", {})),
                source, controller, {n: read(n, references).inputs for n in (*train, *test)} if references else {})


def _read_toml(path: Path) -> dict:
    """The table of case.toml, its keys and their kinds checked."""
    if not path.is_file():
        raise InputError(f"{path} does not exist; expected a case folder with case.toml, a simulator and recordings")
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not UTF-8 text; save it in that encoding") from error
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path} is not valid TOML: {error}; correct that line") from error
    missing = [k for k in ("simulator", "train", "inputs", "outputs") if k not in table]
    if missing:
        raise InputError(f"{path} lacks {missing[0]!r}; expected simulator, time, train, inputs and outputs")
    unknown = sorted(set(table) - _KEYS)
    if unknown:
        raise InputError(f"{path} has the unknown key {unknown[0]!r}; expected one of {', '.join(sorted(_KEYS))}")
    _check_kinds(path, table)
    return table


def _recording_names(path: Path, table: Mapping) -> tuple[list[str], list[str]]:
    """The files to train and to test on, each listed once."""
    train, test = list(table["train"]), list(table.get("test", []))
    both = sorted(set(train) & set(test))
    if both:
        raise InputError(f"{both[0]} is listed as training and as test recording; list it once")
    twice = sorted({n for names in (train, test) for n in names if names.count(n) > 1})
    if twice:
        raise InputError(f"{twice[0]} is listed twice; list it once")
    if not train:
        raise InputError(f"{path} lists no training recording; expected at least one CSV file")
    return train, test


_KINDS = {
    "train": (list, "a list of file names"), "test": (list, "a list of file names"),
    "free_parameters": (list, "a list of names"), "repeats": (list, "a list of lists of file names"),
    "inputs": (dict, "a table: column = unit"), "outputs": (dict, "a table: column = unit"),
    "noise_floor": (dict, "a table: output = level"), "tolerances": (dict, "a table: parameter = share"),
    "simulator": (str, "a file name"), "controller": (str, "a file name"), "time": (str, "a column name"),
    "closed_loop": (bool, "true or false"), "references": (dict, "a table: column = unit"),
}


def _check_kinds(path: Path, table: Mapping) -> None:
    for key, (kind, wanted) in _KINDS.items():
        if key in table and not isinstance(table[key], kind):
            raise InputError(f"{key} in {path} is {table[key]!r}; expected {wanted}")
    odd = [g for g in table.get("repeats", []) if not isinstance(g, list) or not all(isinstance(n, str) for n in g)]
    if odd:
        raise InputError(f"repeats in {path} holds {odd[0]!r}; expected {_KINDS['repeats'][1]}")
    for key in ("train", "test", "free_parameters"):
        odd = [v for v in table.get(key, []) if not isinstance(v, str)]
        if odd:
            raise InputError(f"{key} in {path} holds {odd[0]!r}; expected {_KINDS[key][1]}")
    for key in ("noise_floor", "tolerances"):
        for name, value in table.get(key, {}).items():
            if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value < math.inf:
                raise InputError(f"{key} of {name!r} in {path} is {value!r}; expected a positive number")


def _build(path: Path, what: str, wanted: str):
    """What build() in a user's file returns, build itself, and the file's text."""
    if not path.is_file():
        raise InputError(f"{path} does not exist; expected the {what} named in case.toml")
    name = f"pwaid_case_{what}_{next(_serial)}"
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    linecache.checkcache(str(path))
    sys.modules[name] = module
    with _neighbours(path.parent):
        try:
            spec.loader.exec_module(module)
        except (Exception, SystemExit) as error:
            raise InputError(f"{path} raised {type(error).__name__}: {error}; it must import cleanly") from error
        if not hasattr(module, "build"):
            raise InputError(f"{path} has no build(); expected build() -> {wanted}")
        try:
            system = module.build()
        except (Exception, SystemExit) as error:
            raise InputError(f"build() in {path} raised {type(error).__name__}: {error}; it must return {wanted}"
                             ) from error
    with tokenize.open(path) as file:
        return system, module.build, file.read()


@contextmanager
def _neighbours(folder: Path) -> Iterator[None]:
    """While it lasts, modules of the folder can be imported; another case may have others of the same names."""
    folder, known = folder.resolve(), set(sys.modules)
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))
        for name in set(sys.modules) - known:
            file = getattr(sys.modules[name], "__file__", None)
            if file and Path(file).resolve().is_relative_to(folder):
                del sys.modules[name]


def _load_simulator(path: Path, inputs, outputs, free) -> tuple[Plant, str]:
    system, build, source = _build(path, "simulator", "a control system or a callable simulate(u)")
    plant = with_arguments(as_plant(system, tuple(inputs), tuple(outputs), source=source), build, free)
    _, nu, ny = plant.sizes
    if nu != len(inputs):
        raise InputError(f"the simulator has {nu} inputs, case.toml lists {len(inputs)} ({', '.join(inputs)}); "
                         "list them in the simulator's order")
    if ny != len(outputs):
        raise InputError(f"the simulator has {ny} outputs, case.toml lists {len(outputs)} ({', '.join(outputs)}); "
                         "list them in the simulator's order")
    return replace(plant, input_names=_ordered(inputs, plant.input_names),
                   output_names=_ordered(outputs, plant.output_names)), source


def _ordered(listed, own: tuple[str, ...]) -> tuple[str, ...]:
    """The columns in the simulator's order: that of its own names where they are the same, else as listed."""
    return own if set(own) == set(listed) else tuple(listed)


def _quote(names) -> str:
    return "[" + ", ".join(f'"{n}"' for n in names) + "]"


def write_case(folder, simulator_source: str, train: Mapping[str, Recording], test: Mapping[str, Recording],
               free_parameters=(), noise_floor: Mapping[str, float] | None = None, extra: str = "") -> Path:
    """Write a case folder; the inverse of `load_case`, used by the examples."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "simulator.py").write_text(simulator_source, encoding="utf-8")
    first = next(iter(train.values()))
    for name, rec in {**train, **test}.items():
        header = ",".join(["t", *rec.input_names, *rec.output_names])
        np.savetxt(folder / name, np.column_stack([rec.time, rec.inputs, rec.outputs]), fmt="%.9g",
                   delimiter=",",
                   header=header, comments="")
    lines = ['simulator = "simulator.py"', 'time = "t"', f"train = {_quote(train)}", f"test = {_quote(test)}",
             f"free_parameters = {_quote(free_parameters)}"]
    if noise_floor:
        lines.append("noise_floor = { " + ", ".join(f"{k} = {v:g}" for k, v in noise_floor.items()) + " }")
    lines += [extra] if extra else []
    lines += ["[inputs]"] + [f'{n} = "{first.units[n]}"' for n in first.input_names]
    lines += ["[outputs]"] + [f'{n} = "{first.units[n]}"' for n in first.output_names]
    (folder / "case.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder
