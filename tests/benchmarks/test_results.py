"""Commands that keep what they measured: tiny runs end with a table, and files are compared."""

import numpy as np
import pandas as pd
import pytest

from tests.benchmarks.gp_libraries import PEERS
from tests.benchmarks.gp_peers import TINY, measure, tabulate
from tests.benchmarks.growth import TINY_AXES, fit_exponents
from tests.benchmarks.growth import measure as measure_growth
from tests.benchmarks.problems import Problem
from tests.benchmarks.results import compare, read_rows


def make_rows(factor, spread=0.04, rounds=7, seed=0):
    """Rounds of two figures at two sizes on a machine whose speed wanders; one figure costs `factor` as much."""
    generator = np.random.default_rng(seed)
    rows = []
    for name in ("changed", "as it was"):
        for size in (30, 60):
            against_s = generator.uniform(0.5, 2.0, rounds)
            noise = np.exp(spread * generator.standard_normal(rounds))
            seconds = against_s * noise * (factor if name == "changed" else 1.0)
            rows.append(pd.DataFrame({"figure": name, "axis": "N", "size": size}, range(rounds)))
            rows[-1] = rows[-1].assign(seconds=seconds, against_s=against_s, memory_mb=1.0)
    return pd.concat(rows, ignore_index=True)


def told(first, second):
    return compare(first, second).set_index(["figure", "size"])["told"]


@pytest.mark.parametrize(("factor", "expected"), [(1.25, "higher"), (0.8, "lower"), (1.0, "no change told")])
def test_comparison_tells_a_change_from_none(factor, expected):
    found = told(make_rows(1.0), make_rows(factor, seed=1))
    assert found["changed"].tolist() == [expected] * 2
    assert found["as it was"].tolist() == ["no change told"] * 2


def test_one_round_tells_no_change():
    assert set(told(make_rows(1.0), make_rows(3.0, rounds=1))) == {"no change told"}


def test_peers_are_kept_and_measured_once(tmp_path):
    path, installed = tmp_path / "peers.parquet", [peer for peer in PEERS if not peer.needs]
    rows = measure(installed, read_rows(path), path, (8,), 2, **TINY)
    table = tabulate(rows)
    assert (table["ratio"] > 0.0).all()
    assert (table["agreement"] < 1.0).all()
    again = measure(installed, read_rows(path), path, (8,), 3, **TINY)
    assert len(again) == len(rows) + len(installed)
    pd.testing.assert_frame_equal(read_rows(path), again)


def test_growth_is_kept(tmp_path):
    path = tmp_path / "growth.parquet"
    rows = measure_growth(read_rows(path), path, TINY_AXES, Problem(6, 1, 1, 50).floor, 1)
    assert set(rows["axis"]) == set(TINY_AXES)
    assert (read_rows(path)["seconds"] > 0.0).all()


def test_exponents_are_those_of_a_power():
    sizes = [10, 20, 40, 80]
    rows = pd.DataFrame({"figure": "f", "axis": "N", "size": sizes, "against_s": 1.0, "memory_mb": 1.0})
    (found,) = fit_exponents(rows.assign(seconds=0.3 * rows["size"] ** 2.5)).to_dict("records")
    assert found["exponent"] == pytest.approx(2.5)
    assert found["error"] == pytest.approx(0.0, abs=1e-6)
