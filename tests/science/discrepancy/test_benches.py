"""Elements on test benches: what is planted is named, the same at any rate, and a wrong law alone gets no name."""

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

from stages.science.discrepancy.decision import decide
from stages.science.discrepancy.fitted_channel import prepare
from tests.science.discrepancy.searches import DISCREPANCY, look, run_records
from tests.science.discrepancy.simulated_benches import BENCHES, record_bench
from tests.science.discrepancy.simulated_records import build_records, tabulate, wander
from tests.science.plant.machines import read_plant

pytestmark = pytest.mark.slow
SEEDS = {"muscle": 1, "cylinder": 2, "damper": 3, "finger": 4}


def record(machine, effect, size, rate_hz, seed, **sensor):
    """Return the output of a machine on its bench."""
    signals = record_bench(machine, effect, size, seed, rate_hz, **sensor)
    return build_records(*tabulate(signals, 1.0 / rate_hz), read_plant(machine, **BENCHES[machine][2]))


def search_bench(machine, effect, size, rate_hz, generator, **sensor):
    """Return the names that stand, and the squared gap beside them over that of the law, in fitted trials."""
    found, _ = look(record(machine, effect, size, rate_hz, SEEDS[machine], **sensor))
    verdict = decide(found, DISCREPANCY, generator)
    (first,), (last,) = found.steps[0], verdict.steps[-1]
    return [each.name for each in verdict.effects], float(last.raw.sum() / first.raw.sum())


@pytest.mark.parametrize(
    ("machine", "effect", "rate_hz"),
    [
        ("muscle", "hysteresis", 25),
        ("muscle", "hysteresis", 250),
        ("muscle", "creep", 25),
        ("cylinder", "coulomb_friction", 25),
        ("cylinder", "coulomb_friction", 250),
        ("cylinder", "load_dependent_friction", 25),
        ("damper", "lagged", 25),
        ("damper", "lagged", 250),
        ("damper", "drag", 25),
        ("muscle", "drag", 100),
        ("finger", "creep", 25),
        ("finger", "creep", 250),
    ],
)
def test_what_is_planted_is_named_at_any_rate(machine, effect, rate_hz, generator):
    names, left = search_bench(machine, effect, 0.06, rate_hz, generator)
    assert names == [{"lagged": "load_dependent_friction", "drag": "viscous_friction"}.get(effect, effect)]
    assert left < 0.25


@pytest.mark.parametrize(("machine", "rate_hz"), [*((each, 25) for each in BENCHES), ("muscle", 250), ("finger", 250)])
def test_a_law_that_is_a_little_wrong_gets_no_name(machine, rate_hz, generator):
    assert search_bench(machine, "none", 0.0, rate_hz, generator)[0] == []


@pytest.mark.parametrize(
    ("machine", "effect", "rate_hz", "filter_s"),
    [
        ("cylinder", "coulomb_friction", 25, 0.05),
        ("cylinder", "load_dependent_friction", 100, 0.05),
        ("muscle", "hysteresis", 25, 0.1),
    ],
)
def test_an_effect_behind_a_filter_is_named_beside_it(machine, effect, rate_hz, filter_s, generator):
    """A memory is likelier than either alone."""
    names, left = search_bench(machine, effect, 0.06, rate_hz, generator, filter_s=filter_s)
    assert sorted(names) == sorted([effect, "channel_misalignment"])
    assert left < 0.02


@pytest.mark.parametrize("machine", ["muscle", "cylinder"])
@pytest.mark.parametrize("sensor", [{"filter_s": 0.1}, {"filter_s": 0.02, "rings": (4.0, 1.0)}])
def test_a_filter_alone_is_named_alone_whatever_its_order(machine, sensor, generator):
    """The cylinder's force hardly depends on how it is moved: one of its filters may be a lag of both pressures."""
    names = set(search_bench(machine, "none", 0.0, 25, generator, **sensor)[0])
    lags = {"actuator_lag"} if machine == "cylinder" else set()
    assert names
    assert names <= {"channel_misalignment", *lags}


@pytest.mark.parametrize(("machine", "hertz", "damping"), [("muscle", 9.0, 0.1), ("cylinder", 2.5, 0.3)])
@pytest.mark.parametrize("effect", ["none", "coulomb_friction"])
def test_a_sensor_that_rings_is_named_alone_and_beside_friction(machine, hertz, damping, effect, generator):
    names, left = search_bench(machine, effect, 0.06, 100, generator, rings=(hertz, damping))
    assert sorted(names) == sorted({"sensor_resonance", effect} - {"none"})
    assert left < 0.2


@pytest.mark.parametrize("machine", ["muscle", "cylinder"])
@pytest.mark.parametrize("form", ["element_gain_shift", "element_shift"])
def test_a_load_cell_that_changes_at_one_moment_is_told_with_its_size(machine, form, generator):
    signals = record_bench(machine, "none", 0.0, SEEDS[machine], 100)
    name, half = BENCHES[machine][1], len(signals["position_m" if machine == "cylinder" else "contraction"]) // 2
    scale = 0.5 * np.ptp(signals[name])
    signals[name][half:] += 0.05 * (scale if form == "element_shift" else signals[name][half:])
    plant = read_plant(machine, **BENCHES[machine][2])
    verdict = decide(look(build_records(*tabulate(signals, 0.01), plant))[0], DISCREPANCY, generator)
    assert [each.name for each in verdict.effects] == ["sensor_drift"]
    found, values = verdict.steps[-1][0].effects[-1]
    assert found.form == form
    assert values["share"] == pytest.approx(0.05, rel=0.15)


@pytest.mark.parametrize("seed", [901, 903])
def test_what_a_sensor_that_rings_adds_is_no_noise(seed):
    """A memory of the answer tells it by large weights alone: smaller ones predict worse than none."""
    bench = prepare(record("muscle", "none", 0.0, 100, seed, rings=(9.0, 0.1)).take(range(10)))
    assert np.sqrt(bench.current.raw.sum() / bench.samples.sum()) > 2.0 * bench.floor


def lag_damper(lag_s):
    """A damper whose force follows the measured current late, with its speed and what else it is."""
    signals, name = record_bench("damper", "none", 0.0, SEEDS["damper"], 100), BENCHES["damper"][1]
    current, speed, decay = signals["current_a"], signals["speed_m_per_s"], np.exp(-0.01 / lag_s)
    late = lfilter([1.0 - decay], [1.0, -decay], current, zi=[decay * current[0]])[0] - current
    lagging = {**signals, name: signals[name] + 500.0 * late * speed / (1.0 + 0.3 * np.abs(speed))}
    plant = read_plant("damper", **BENCHES["damper"][2])
    return (build_records(*tabulate(each, 0.01), plant) for each in (signals, lagging))


def test_a_gain_that_follows_late_is_no_noise():
    """The floor of a damper whose force follows the measured current through a lag is that of one without."""
    without, having = (prepare(each) for each in lag_damper(0.06))
    assert np.sqrt(having.current.raw.sum() / having.samples.sum()) > 1.7 * without.floor
    assert having.floor == pytest.approx(without.floor, rel=0.1)


@pytest.mark.parametrize(
    ("machine", "behind", "effect", "form"),
    [
        ("muscle", {"pressure_kpa": 0.08}, "actuator_lag", "element"),
        ("damper", {"current_a": 0.06}, "actuator_lag", "element"),
        ("cylinder", {"p1_kpa": 0.04, "p2_kpa": 0.04}, "actuator_lag", "element"),
        ("muscle", {"pressure_kpa": -0.03}, "channel_misalignment", "element_drive"),
        ("muscle", {"contraction": -0.04}, "channel_misalignment", "element_displacement"),
    ],
)
def test_what_acts_before_or_after_what_is_recorded_is_told_in_time(machine, behind, effect, form, generator):
    """A pressure behind a tube, a field behind its current, a sensor that is late."""
    lag_s = next(iter(behind.values()))
    if machine == "damper":
        _, found = lag_damper(lag_s)
    else:
        found = record(machine, "none", 0.0, 100, SEEDS[machine], behind=behind)
    verdict = decide(look(found)[0], DISCREPANCY, generator)
    assert [each.name for each in verdict.effects] == [effect]
    named, values = verdict.steps[-1][0].effects[-1]
    assert named.form == form
    assert next(iter(values.values())) * found.plant.time_scale_s == pytest.approx(abs(lag_s), rel=0.2)


def record_spring(generator, noise, viscous=0.0, records=4):
    """A spring of 200 N per scale that is moved smoothly, with dashpot, and noise of the position read, in scales."""
    tables = []
    for k in range(records):
        way = (wander(generator, 1500, 400) + 0.3 * wander(generator, 1500, 30)) / 3.0
        force = 200.0 * (way + viscous * np.gradient(way, 0.01)) + 0.3 * generator.standard_normal(1500)
        read = way + noise * generator.standard_normal(1500)
        tables.append(tabulate({"position_m": read, "force_n": force}, 0.01, f"record {k}", blocks=2))
    plant = read_plant("static_map", along="position_m", output="force_n")
    return build_records(*(pd.concat(each, ignore_index=True) for each in zip(*tables, strict=True)), plant)


def test_a_dashpot_is_no_late_sensor(generator):
    """The position is read without noise: a rate through a wide window leaves what a shift of the answer takes."""
    found, names = look(record_spring(generator, 0.0, viscous=0.03))
    assert names == ["viscous_friction"]
    left = found.outputs[0].current.raw.sum() / found.outputs[0].samples.sum()
    assert np.sqrt(left * found.outputs[0].output.averaged) == pytest.approx(0.3, rel=0.1)


def test_what_is_not_there_is_not_told_as_absorbed(generator):
    """Constants imitate a dashpot, if there is one; they could not imitate dry friction."""
    found, names = look(record_spring(generator, 0.0))
    absorbed = found.rounds[0].confounded_with_constants
    assert (names, absorbed["coulomb_friction"] < 0.9) == ([], True)


def test_noise_of_the_position_that_is_read_is_no_memory(generator):
    """Left in, it passes into the simulated force, and whatever averages over time takes it away."""
    found, names = look(record_spring(generator, 0.02))
    verdict = decide(found, DISCREPANCY, generator)
    assert (names, verdict.status) == ([], "no_discrepancy")
    assert record_spring(generator, 0.02).plant.path_window_s > 0.0


def test_a_reading_that_ends_in_a_record_with_holes_comes_to_a_verdict(pamid, tmp_path, generator):
    """A spring whose sensor ends, with values missing here and there, one whole block of them, and much of another."""
    force = 40.0 * wander(generator, 4800, 160)
    way = 0.02 * force + 0.01 * generator.standard_normal(4800)
    end = np.quantile(way, 0.9)
    read = np.minimum(way, end)
    read[generator.random(4800) < 0.02] = np.nan
    read[1500:1830] = read[4400:4550] = np.nan
    path = tmp_path / "spring.csv"
    pd.DataFrame({"t": np.arange(4800) * 0.01, "f": force, "x": read}).to_csv(path, index=False)
    spring = ["plant=static_map", "plant.along=force_n", "plant.constants.stiffness.of=[force_n]"]
    given = ["+columns.force_n=f", "+columns.position_mm=x", "plant.output=position_mm", *spring]
    said, verdict = run_records(pamid, path, *given, "figures=[png]")
    (named,) = verdict["effects"]
    assert named["name"] == "saturation"
    assert verdict["gap"]["after"] < 0.25 * verdict["gap"]["before"]
    assert f"{np.isnan(read).sum()} of 4800 values are missing" in said
    assert list((pamid.runs[0] / "figures").glob("signature_saturation.png"))
