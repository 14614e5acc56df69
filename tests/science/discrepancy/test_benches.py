"""Elements on test benches: what is planted is named, the same at any rate, and a wrong law alone gets no name."""

import pytest

from stages.science.discrepancy.decision import decide
from tests.science.discrepancy.searches import DISCREPANCY, look
from tests.science.discrepancy.simulated_benches import BENCHES, record_bench
from tests.science.discrepancy.simulated_records import build_records, tabulate
from tests.science.plant.machines import read_plant

pytestmark = pytest.mark.slow
SEEDS = {"muscle": 1, "cylinder": 2, "damper": 3, "finger": 4}


def search_bench(machine, effect, size, rate_hz, generator):
    """Return the names that stand, and the squared gap beside them over that of the law, in fitted trials."""
    signals = record_bench(machine, effect, size, SEEDS[machine], rate_hz)
    plant = read_plant(machine, **BENCHES[machine][2])
    found, _ = look(build_records(*tabulate(signals, 1.0 / rate_hz), plant))
    verdict = decide(found, DISCREPANCY, generator)
    (first,), (last,) = found.steps[0], verdict.steps[-1]
    return [each.name for each in verdict.effects], float(last.raw.sum() / first.raw.sum())


@pytest.mark.parametrize("rate_hz", [25, 250])
@pytest.mark.parametrize(
    ("machine", "effect"),
    [
        ("muscle", "hysteresis"),
        ("muscle", "creep"),
        ("cylinder", "coulomb_friction"),
        ("cylinder", "load_dependent_friction"),
        ("damper", "lagged"),
        ("finger", "creep"),
    ],
)
def test_what_is_planted_is_named_at_any_rate(machine, effect, rate_hz, generator):
    names, left = search_bench(machine, effect, 0.06, rate_hz, generator)
    assert names == ["load_dependent_friction" if effect == "lagged" else effect]
    assert left < 0.25


@pytest.mark.parametrize("rate_hz", [25, 250])
@pytest.mark.parametrize("machine", BENCHES)
def test_a_law_that_is_a_little_wrong_gets_no_name(machine, rate_hz, generator):
    assert search_bench(machine, "none", 0.0, rate_hz, generator)[0] == []
