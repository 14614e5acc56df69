"""A learned map is the mean of a Gaussian process, wherever it is evaluated, and nothing away from its data."""

import numpy as np
import pytest
from pydantic import ValidationError
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel

from stages.science.discrepancy.dependence import find_dependence
from stages.science.output_channels.features import list_histories
from stages.science.output_channels.output_channel import Driver
from stages.science.plant.chain import Chain
from stages.science.plant.learned_map import LearnedMap
from stages.science.signals.histories import find_signal
from tests.science.discrepancy.searches import DESCRIPTION
from tests.science.discrepancy.toys import make_toy
from tests.science.plant.columns import STEP_S, rough
from tests.science.plant.machines import configured

MUSCLES = 4


def learn(channel="force_n", element="pam2", names=("pressure_kpa", "contraction"), height=2.0):
    """A map of bumps of a height at two places, the inputs told in hundreds."""
    told = {"middle": 100.0, "spread": 100.0, "length": 0.5, "low": -1e3, "high": 1e3}
    points = [[0.3] * len(names), [-0.4] * len(names)]
    inputs = [{"name": name, **told} for name in names]
    weights = [height, -0.5 * height]
    return LearnedMap.model_validate(
        {
            "channel": channel,
            "element": element,
            "inputs": inputs,
            "deviation": 0.1,
            "lowest": -100.0,
            "highest": 100.0,
            "points": points,
            "weights": weights,
        }
    )


def bump(values, height=2.0):
    """What `learn` is of one input."""
    at = (values - 100.0) / 100.0
    return height * (np.exp(-2.0 * (at - 0.3) ** 2) - 0.5 * np.exp(-2.0 * (at + 0.4) ** 2))


def test_it_is_the_mean_of_a_gaussian_process(generator):
    seen, new = generator.standard_normal((40, 2)), generator.standard_normal((25, 2))
    kernel = ConstantKernel(1.7, "fixed") * RBF([0.8, 1.9], "fixed")
    model = GaussianProcessRegressor(kernel, alpha=0.01, optimizer=None).fit(seen, np.sin(seen[:, 0]) + seen[:, 1])
    names, lengths = ("a_v", "b_v"), (0.8, 1.9)
    learned = LearnedMap(
        channel="y_v",
        element="element",
        inputs=[
            {"name": n, "middle": 3.0, "spread": 2.0, "length": own, "low": -9.0, "high": 15.0}
            for n, own in zip(names, lengths, strict=True)
        ],
        deviation=0.1,
        lowest=-100.0,
        highest=100.0,
        points=seen.tolist(),
        weights=(1.7 * model.alpha_).tolist(),
    )
    found = learned.evaluate({name: 3.0 + 2.0 * new[:, k] for k, name in enumerate(names)})
    np.testing.assert_allclose(found, model.predict(new), atol=1e-10)


@pytest.mark.parametrize("seed", range(3))
def test_beyond_what_was_recorded_it_is_never_larger_and_soon_nothing(seed):
    """Also where an input hardly matters, so that its length is enormous and weights cancel."""
    output = make_toy(seed, trials=10)
    room = np.repeat(20.0 + np.arange(10.0)[None], len(output.x), axis=0)
    x, aside = Driver("x_v", output.x), Driver("room_degc", room, own=False)
    truth = 0.3 * np.sin(4.0 * output.x) * np.exp(0.001 * (room - 25.0))
    learned = find_dependence(output, [x, aside], truth, DESCRIPTION, np.random.default_rng(seed)).learned
    ranges = {each.name: (each.low, each.high) for each in learned.inputs}
    assert "x_v" in ranges
    span, largest = np.ptp(output.x), max(abs(learned.lowest), abs(learned.highest))
    near, far = np.linspace(-9.0, 9.0, 400) * span, np.array([-30.0, 30.0]) * span
    for degc in (-200.0, 24.0, 1000.0):
        found, gone = (learned.evaluate({"x_v": at, "room_degc": np.full(at.shape, degc)}) for at in (near, far))
        assert np.abs(found).max() <= largest * (1.0 + 1e-12)
        np.testing.assert_allclose(gone, 0.0, atol=1e-9 * largest)
    inside = learned.evaluate({"x_v": output.x, "room_degc": room})
    assert np.sqrt(np.mean((inside - truth) ** 2)) < 0.1 * truth.std()
    assert learned.share_outside({"x_v": output.x, "room_degc": room}, output.present) == 0.0
    outer = learned.share_outside({"x_v": 3.0 * output.x, "room_degc": room}, output.present)
    low, high = ranges["x_v"]
    assert outer == pytest.approx(((3.0 * output.x < low) | (3.0 * output.x > high)).mean())


@pytest.mark.parametrize(
    ("names", "kind"),
    [
        (["pressure_kpa", "contraction_velocity_per_s"], "learned_static"),
        (["pressure_kpa", "recent pressure_kpa"], "learned_memory"),
        (["distance by contraction_velocity_per_s"], "learned_memory"),
        (["recent pressure_kpa", "start_s"], "learned_session"),
    ],
)
def test_it_is_called_by_what_it_is_told_from(names, kind):
    assert learn(names=names).kind == kind


def test_what_does_not_fit_together_is_refused_in_a_line():
    told = learn().model_dump()
    with pytest.raises(ValidationError, match=r"expected 3 \(one for each weight\) of 2 numbers"):
        LearnedMap.model_validate(told | {"weights": [1.0, 2.0, 3.0]})
    with pytest.raises(ValidationError, match=r"low: expected at most high \(-5.0\), got 2.0"):
        LearnedMap.model_validate(told | {"inputs": [each | {"low": 2.0, "high": -5.0} for each in told["inputs"]]})
    with pytest.raises(ValueError, match=r"told from 'contraction', which is not known here.*plant.learned=\[\]"):
        learn().evaluate({"pressure_kpa": np.zeros(3)})
    rig = configured()
    for wrong, message in (({"element": "pam9"}, "did you mean"), ({"channel": "angle"}, "force_n")):
        learned = [LearnedMap.model_validate(told | wrong)]
        with pytest.raises(ValueError, match=rf"plant.learned.0.*{message}"):
            Chain(rig.exoskeleton, rig.plant.model_copy(update={"learned": learned}))


@pytest.mark.parametrize("copies", [1, 3])
@pytest.mark.parametrize(
    ("channel", "name"),
    [("force_n", "pressure_kpa"), ("force_n", "pam4 pressure_kpa"), ("pressure_kpa", "pressure_command_kpa")],
)
def test_a_chain_adds_it_to_its_own_muscle_alone(channel, name, copies, generator):
    rig, learned = configured(), learn(channel, names=(name,))
    chains = [
        Chain(rig.exoskeleton, rig.plant.model_copy(update={"learned": maps})).repeat(copies)
        for maps in ([], [learned])
    ]
    command, _, contraction, velocity = rough(generator, columns=MUSCLES * copies)
    plain, with_it = (
        np.stack(chain.pull(command, contraction, velocity) if channel == "force_n" else [chain.pressurise(command)])
        for chain in chains
    )
    driven = 3 if name.startswith("pam4") else 1
    added = bump(command[:, driven::MUSCLES])
    own = with_it[:, :, 1::MUSCLES]
    np.testing.assert_allclose(own, np.maximum(plain[:, :, 1::MUSCLES] + added, 0.0), atol=1e-9)
    assert np.abs(added).max() > 0.5
    others = [k for k in range(MUSCLES * copies) if k % MUSCLES != 1]
    np.testing.assert_array_equal(with_it[:, :, others], plain[:, :, others])


def test_a_simulator_finds_the_histories_that_a_channel_offers():
    output = make_toy(3)
    signals = {each.name: each.values for each in output.drivers()}
    histories = list_histories(output)
    assert len({each.name for each in histories}) == len(histories) > 1
    for each in histories:
        told = find_signal(each.name, signals, output.step_s, output.time_scale_s)
        np.testing.assert_array_equal(told, each.values)
    with pytest.raises(ValueError, match="no signal 'recent nothing'"):
        find_signal("recent nothing", signals, STEP_S, 1.0)
