"""Which column of a recorded file may be what: time, record, part, what drives a machine and what answers.

Headings flow in, with what kind of values stand below; a map of columns and units flows out, as far as names make it
plain. What is not plain is left to the person.
"""

import re
import unicodedata
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from stages.science.recording.headings import Heading, read_heading
from stages.science.recording.units import KINDS, UNIT_KINDS, end_of, own_unit, read_unit

TIMES = re.compile("t|times?|time_s|(time)?stamp|zeit|temps|elapsed|date|date_?time|x_value|secs?|seconds?|[mun]s(ec)?")
"""Names of a column of time; some are its unit as well."""
RECORDS = ("record", "rec", "run", "trial", "experiment", "exp", "repetition", "rep", "cycle", "segment", "test", "nr")
STEPS = ("ts", "dt", "delta_x", "sampling_time", "sample_time", "t_sample")
RATES = ("fs", "rate", "sampling_rate", "sample_rate")
PARTS = ("part", "set", "split", "phase", "dataset", "purpose")
INPUTS = ("u", "input", "in", "drive", "excitation", "command", "cmd", "u1")
OUTPUTS = ("y", "output", "out", "response", "answer", "y1")
ENDINGS = (("est", "val"), ("train", "test"), ("estimation", "validation"), ("id", "val"), ("training", "validation"))
"""Ends of names that tell parts, however they are capitalised."""
WITHOUT_UNIT = {"input": "drive_v", "output": "response_v"}
"""Names for what drives and what answers where no unit is told: those of the plant `second_order`."""

MUSCLES = {
    "pressure": ("pressure_kpa", "pressure_command_kpa"),
    "force": ("force_n",),
    "angle": ("joint_angle_rad",),
    "angular velocity": ("joint_velocity_rad_per_s",),
    "ratio": ("contraction",),
    "rate of a ratio": ("contraction_velocity_per_s",),
}
UMLAUTS = str.maketrans({"ä": "ae", "ö": "oe", "ü": "ue", "ß": "ss"})
FIELD = re.compile(r"^\w+(?:\.\w+)*\.([A-Za-z]\w*)$")
"""A field of a struct, whose last name tells."""
Key = tuple[int, bool, tuple[str, ...], bool]
"""Of a key of a machine: how many signals it names, whether it may be left out, by what quantities it is known, and
whether it is null where there is none."""
RATIOS = re.compile(r"(^|_)(contraction|strain|stretch)$")
"""Names of ratios of lengths, which need no unit."""
COMMANDED = re.compile(r"command|cmd|ref|set|target|desired")


@dataclass
class Guess:
    """A map as far as it is plain: by this project's name, the file's column, and its unit if that is another.

    `muscles` says whether the file tells muscles apart, `input` and `output` what drives and what answers. Parts are
    told by the `endings` of columns, or are the two to be fitted and to be opened at the end. The unit of names in
    `assumed` is told by nothing, and of columns in `left` nothing is; a single number may tell the rate. `machine` is
    the kind of machine whose quantities these are, with the signals of its keys.
    """

    columns: dict[str, str] = field(default_factory=dict)
    units: dict[str, str] = field(default_factory=dict)
    muscles: bool = False
    input: str | None = None
    output: str | None = None
    endings: tuple[str, ...] = ()
    parts: tuple[str, ...] = ()
    assumed: list[str] = field(default_factory=list)
    left: list[str] = field(default_factory=list)
    rate_hz: float | None = None
    machine: tuple[str, dict[str, list[str]]] | None = None

    def take(self, name: str, column: str, unit: str | None = None) -> None:
        """Map a column."""
        self.columns[name] = column
        if unit is not None and unit != own_unit(name):
            self.units[name] = unit

    @property
    def signals(self) -> list[str]:
        """Names of what was measured over time."""
        return [each for each in self.columns if each not in ("time_s", "record", "part")]


def choose_machine(guess: Guess, machines: Mapping[str, Mapping[str, Key]]) -> tuple[str, dict[str, list[str]]] | None:
    """Return the kind of machine that most of the measured quantities belong to, with the signals of its keys.

    Of a key's quantities the first is the likeliest. A signal that is commanded is none of them where one of its kind
    is measured. A key that has to be null has no signals. None where no machine has all that it needs, or none answers
    by the signal that does.
    """
    kinds = {each: None if each in guess.assumed else UNIT_KINDS[own_unit(each)] for each in guess.signals}
    measured = {kinds[each] for each in guess.signals if not COMMANDED.search(each)}
    usable = [each for each in guess.signals if not COMMANDED.search(each) or kinds[each] not in measured]
    found = []
    for kind, keys in machines.items():
        free, named, lacking, unlikely = usable, dict[str, list[str]](), 0, 0
        for key, (count, optional, quantities, nullable) in keys.items():
            fitting = [each for wanted in quantities for each in free if kinds[each] == wanted]
            if len(fitting) < count and not (optional or (nullable and quantities)):
                break
            lacking += len(fitting) < count and not optional
            if fitting or not optional:
                named[key] = fitting[:count]
            unlikely += sum(quantities.index(str(kinds[each])) for each in fitting[:count])
            free = [each for each in free if each not in fitting[:count]]
        else:
            used, more = sum(map(len, named.values())), sum(optional for _, optional, _, _ in keys.values())
            if guess.output in (None, *named["output"]):
                found.append((-used, lacking, more, unlikely, kind, named))
    return min(found)[4:] if found else None


def pair_parts(names: Sequence[str]) -> tuple[str, ...]:
    """Return the name of the part that is to be fitted and of that to be opened at the end; none where none tells."""
    known = {name.casefold(): name for name in names}
    pair = next((pair for pair in ENDINGS if set(pair) <= set(known)), ())
    return tuple(known[each] for each in pair)


def _find_endings(names: Sequence[str]) -> tuple[str, ...]:
    """Return the ends of names that tell parts, as they are written; none where there are none."""
    for pair in ENDINGS:
        for form in (str.capitalize, str.lower, str.upper):
            for link in ("_", ""):
                first, second = (link + form(each) for each in pair)
                stems = [each.removesuffix(first) for each in names if each.endswith(first) and each != first]
                if stems and all(f"{stem}{second}" in names for stem in stems):
                    return first, second
    return ()


def guess_map(
    numbers: Sequence[str],
    texts: Sequence[str],
    units: Mapping[str, str],
    single: Mapping[str, float],
    dates: Sequence[str] = (),
    steady: Sequence[str] = (),
) -> Guess:
    """Return the map that the headings of columns of numbers and of text make plain.

    Units are those from a row of their own, `single` the numbers that stand alone, and `dates` those of the numbers
    that are dates or times of day, the likeliest for time first. The `steady` ones go on by even steps.
    """
    guess = Guess()
    everything = [*numbers, *texts]
    guess.endings = _find_endings(numbers)
    if guess.endings:
        first, second = guess.endings
        parts = [each.removesuffix(first) for each in numbers if each.endswith(first)]
        numbers = [each for each in numbers if not each.endswith((first, second))] + parts
        units = {**units, **{each.removesuffix(first): told for each, told in units.items()}}
    plain = {each: _plain(_read(each, units).name) for each in [*numbers, *texts]}
    named = [each for each in everything if TIMES.fullmatch(plain.get(each, "")) and each not in dates]
    named = [each for each in named if _kind(each, units) in (None, "time")]  # T in degC is none
    named += [each for each in steady if read_unit(plain.get(each, "")) in KINDS["time"]]  # as hours
    clocks = [each for each in numbers if _kind(each, units) == "time"]
    _take_first(guess, "time_s", [*named, *dates, *clocks], units)
    if "time_s" not in guess.columns:
        steps = [1.0 / value for name, value in single.items() if _plain(name) in STEPS and value > 0.0]
        rates = [value for name, value in single.items() if _plain(name) in RATES and value > 0.0]
        guess.rate_hz = float(f"{[*steps, *rates][0]:.9g}") if steps or rates else None
    guess.muscles = "muscle" in plain.values()
    record = "trial" if guess.muscles else "record"
    _take_first(guess, record, [each for each in everything if plain.get(each) in RECORDS], {})
    _take_first(guess, "part", [each for each in texts if plain[each] in PARTS], {})
    rest = [each for each in numbers if each not in guess.columns.values()]
    if guess.muscles:
        _take_first(guess, "muscle", [each for each in everything if plain.get(each) == "muscle"], {})
        _take_muscles(guess, rest, units)
    else:
        _take_signals(guess, rest, plain, units)
    guess.left = [each for each in rest if each not in guess.columns.values()]
    return guess


def _plain(name: str) -> str:
    """Return a heading in letters that a key of the command line may have."""
    spelled = unicodedata.normalize("NFKD", FIELD.sub(r"\1", name.strip()).lower().translate(UMLAUTS))
    bare = "".join(each for each in spelled if not unicodedata.combining(each))
    return re.sub(r"\W+", "_", bare, flags=re.ASCII).strip("_")


def _read(column: str, units: Mapping[str, str]) -> Heading:
    return read_heading(FIELD.sub(r"\1", column), units.get(column, ""))


def _kind(column: str, units: Mapping[str, str]) -> str | None:
    unit = _read(column, units).unit
    return None if unit is None else UNIT_KINDS[unit]


def _take_first(guess: Guess, name: str, columns: Sequence[str], units: Mapping[str, str]) -> None:
    if columns:
        unit = _read(columns[0], units).unit or read_unit(_plain(columns[0])) if name == "time_s" else None
        guess.take(name, columns[0], unit if unit in KINDS["time"] else None)


def _take_muscles(guess: Guess, rest: Sequence[str], units: Mapping[str, str]) -> None:
    known = [name for names in MUSCLES.values() for name in names]
    for column in [*(each for each in rest if each in known), *(each for each in rest if each not in known)]:
        heading = _read(column, units)
        named = "contraction" in _plain(column) and heading.unit is None
        names = MUSCLES.get("ratio" if named else _kind(column, units) or "", ())
        if len(names) > 1:
            names = names[1:] if COMMANDED.search(_plain(column)) else names[:1]
        wanted = column if column in known else next(iter(names), None)
        if wanted is not None and wanted not in guess.columns:
            guess.take(wanted, column, heading.unit)


def _name_unit(name: str) -> str | None:
    """Return the unit that a name states beside its kind of quantity, as current_a does; None where it does not."""
    unit = own_unit(name)
    kind = "ratio" if RATIOS.search(name) else UNIT_KINDS[unit]
    return unit if kind in name or RATIOS.search(name) else None


def _take_signals(guess: Guess, rest: Sequence[str], plain: Mapping[str, str], units: Mapping[str, str]) -> None:
    for column in rest:
        bare = FIELD.sub(r"\1", column).isidentifier()
        unit = _read(column, units).unit or (_name_unit(plain[column]) if bare else None)
        role = "input" if plain[column] in INPUTS else "output" if plain[column] in OUTPUTS else None
        role = None if role is None or getattr(guess, role) else role
        if unit is None and role is None:
            continue
        if unit is None:
            name = WITHOUT_UNIT[str(role)]
            guess.assumed.append(name)
        else:
            kind = UNIT_KINDS[unit]
            own = next(iter(KINDS[kind]))
            stem = plain[column] or f"{_plain(kind)}_{rest.index(column) + 1}"
            stem = stem if stem[0].isalpha() else f"signal_{stem}"
            stated = own_unit(stem) == own and (own != "ratio" or RATIOS.search(stem))
            name = stem if stated else f"{stem}_{end_of(own)}"
        if name in guess.columns:
            continue
        guess.take(name, column, unit)
        if role is not None:
            setattr(guess, role, name)
    if len(guess.signals) == 2 and (guess.input is None) != (guess.output is None):
        other = next(each for each in guess.signals if each not in (guess.input, guess.output))
        guess.input, guess.output = guess.input or other, guess.output or other
