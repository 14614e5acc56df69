"""A map that has an effect's shape by chance: against the beta distribution, and in searches that may go both ways."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.stats import beta

from stages.science.discrepancy.coincidence import measure_likeness, weigh_coincidence
from stages.science.discrepancy.fitted_channel import fit_plain
from stages.science.output_channels.fitting import Model
from stages.science.output_channels.grams import Columns
from tests.science.discrepancy.searches import look
from tests.science.discrepancy.toys import KINK, WAVE, Toy, make_toy

NOISE = 0.02


@dataclass(frozen=True)
class StaticToy(Toy):
    """A toy whose effects are static maps, whose trials jitter."""

    def find_past_share(self, form, values):
        return 0.0


def make_static(seed, *hidden):
    plain = make_toy(seed, hidden, noise=NOISE, trials=10)
    return StaticToy(**{**vars(plain), "offered": (WAVE, KINK)})


def fit_both(output):
    nothing, start = Model(output), Model(output).start
    having = replace(nothing, forms=(WAVE,))
    return fit_plain(nothing, start, NOISE), fit_plain(having, np.append(start, 1.0), NOISE)


@pytest.mark.parametrize("directions", [4, 7])
@pytest.mark.parametrize("likeness", [0.8, 0.95, 0.99])
def test_of_equal_directions_the_share_of_one_has_a_beta_distribution(directions, likeness):
    output = make_static(1, (WAVE.effect, 1.0))
    nothing, fitted = fit_both(output)
    generator = np.random.default_rng(0)
    flat = np.column_stack(
        [
            np.ones(output.x.size),
            output.x.ravel(),
            WAVE.effect(output.x).ravel(),
            generator.standard_normal((output.x.size, directions - 1)),
        ]
    )
    columns = np.linalg.qr(flat)[0][:, 2:].reshape(*output.x.shape, directions)
    blocks = Columns(columns), [[np.full(directions, 0.1), np.full(directions, 0.7)]]
    told = weigh_coincidence(nothing, fitted, blocks, likeness, 1e-9)
    assert told == pytest.approx(beta.logsf(likeness, 0.5, 0.5 * (directions - 1)), rel=0.06)
    assert weigh_coincidence(nothing, fitted, blocks, likeness, 0.5) == pytest.approx(np.log(0.5))


def test_likeness_is_the_share_of_what_the_map_closes():
    nothing, fitted = fit_both(make_static(1, (WAVE.effect, 1.0)))
    assert measure_likeness(nothing, fitted, fitted) == pytest.approx(1.0)
    assert measure_likeness(nothing, fitted, nothing) == 0.0
    assert measure_likeness(nothing, nothing, fitted) == 0.0  # the map closes nothing


@pytest.mark.parametrize("seed", range(2))
def test_an_effect_beside_a_small_error_of_the_law_is_named(seed):
    found, names = look(make_static(seed, (WAVE.effect, 1.0), (lambda x: np.exp(-((x - 0.4) ** 2) / 0.1), 0.1)))
    assert names == ["wave"]
    assert found.named[0].probability > 0.5


@pytest.mark.parametrize("seed", range(2))
def test_a_map_of_another_shape_is_not(seed):
    _, names = look(make_static(seed, (lambda x: np.exp(-((x + 0.3) ** 2) / 0.15), 1.0)))
    assert names == []
