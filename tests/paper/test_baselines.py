"""The baselines against planted laws, NumPy and SciPy, with verdicts that planted data turn either way."""

from functools import partial
from itertools import product
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from scipy.special import gammaln

from pipeline.context import Context
from pipeline.errors import WiringError
from stages.paper import baselines as module
from stages.paper.baselines import Baselines, Config, baselines, compare_baselines, count_points, fit_law, predict_law
from stages.science.figures.canvas import LINES
from stages.science.figures.learning_curves import draw_error_bars, draw_learning_curves
from stages.science.signals.scaling import MODEL_INPUTS, MODEL_OUTPUT
from tests.planted import assert_holm
from tests.science.muscle_models.data import HYPERPARAMETERS
from tests.science.muscle_models.test_linear_muscle import terms
from tests.studies import PickledContext, run_alone

LAW = np.array([6.0, -9.0, 1.2, -900.0, 150.0, -20.0])
SECTION = {
    "experiments": 8,
    "slack_share": 0.01,
    "sparse_starts": 2,
    "sparse_trial_iterations": 2,
    "sparse_best_iterations": 4,
    "starts": 1,
}


def lay_out(samples):
    """Return the six columns of the linear law as it is written."""
    return terms(samples["pressure_kpa"].to_numpy(), samples["contraction"].to_numpy())


def follow_the_law(samples):
    return np.maximum(lay_out(samples) @ LAW, 0.0)


def bend(samples):
    """Return forces that no polynomial of pressure and contraction tells: they depend on velocity."""
    return 200 + 150 * np.tanh(4 * samples["contraction_velocity_per_s"].to_numpy())


def record(generator, count, force=follow_the_law, noise=0.0, pressure_kpa=(50, 300), contraction=(0.0, 0.2)):
    """Return so many samples of a muscle, anywhere in the given ranges."""
    samples = pd.DataFrame(
        {
            "pressure_kpa": generator.uniform(*pressure_kpa, count),
            "contraction": generator.uniform(*contraction, count),
            "contraction_velocity_per_s": generator.uniform(-0.5, 0.5, count),
        }
    )
    noisy = force(samples) + noise * generator.standard_normal(count)
    return samples.assign(force_n=np.maximum(noisy, 0.0), time_s=0.0)


def make_tables(generator, muscles=("pam1", "pam2"), experiments=2, trials=3, samples=40, points=8, **law):
    """Return all tables that the stage reads: recordings of a planted law, a design whose errors are drawn."""

    def gather(keys, count, **how):
        each = product(keys, muscles)
        frames = [record(generator, count, **{**law, **how}).assign(muscle=muscle, **key) for key, muscle in each]
        return pd.concat(frames, ignore_index=True)

    turns = [{"experiment": e, "trial": t} for e, t in product(range(1, experiments + 1), range(1, trials + 1))]
    of_arms = product(("p1", "p2"), turns, ("y_y", "random"))
    arms = [{"participant": who, **turn, "arm": arm} for who, turn, arm in of_arms]
    prior = [(muscle, name, mean, 0.5) for muscle in muscles for name, mean in HYPERPARAMETERS.items()]
    constants = zip((*MODEL_INPUTS, MODEL_OUTPUT), (175, 0.1, 0.0, 200), (70, 0.06, 0.3, 100), strict=True)
    scaling = [(muscle, *each) for each in list(constants) for muscle in muscles]
    first = [each for each in arms if each["trial"] == 1]
    curve = [
        {**each, "trial": trial, "tested_on": tested_on, "muscle": muscle, "rmse_n": 1.0}
        for each, trial, tested_on, muscle in product(first, range(trials + 1), ("bank", "unseen_bank"), muscles)
    ]
    last = [each for each in arms if each["trial"] == trials]
    curve = pd.DataFrame(curve).assign(error_rate=generator.uniform(0.09, 0.11, len(curve)))
    return {
        "bank": gather([{}], 50, noise=0.0),
        "unseen_bank": gather([{}], 30, noise=0.0),
        "protocol_recordings": gather(turns, samples),
        "active_recordings": gather(arms, samples),
        "hyperprior": pd.DataFrame(prior, columns=["muscle", "hyperparameter", "mean", "variance"]),
        "scaling": pd.DataFrame(scaling, columns=["muscle", "quantity", "centre", "scale"]),
        "points": pd.DataFrame([{**each, "muscle": m} for each, m, _ in product(last, muscles, range(points))]),
        "learning_curve": curve,
    }


def run(folder, tables, seed=0, context=PickledContext, **section):
    """Return the stage's tables; its figures are drawn in a context of its own alone."""
    cfg = Config(baselines=Baselines(**{**SECTION, **section}), seed=seed)
    with pytest.MonkeyPatch.context() as patched:
        if context is PickledContext:
            patched.setattr(module, "draw", lambda *arguments: None)
        return list(run_alone(baselines, cfg, folder, tables, seed, context).values())


def rates(curve, baseline, **where):
    its = curve[curve["baseline"] == baseline]
    for name, value in where.items():
        its = its[its[name] == value]
    return its["error_rate"]


@pytest.fixture(scope="module")
def noisy(tmp_path_factory):
    """Tables of the planted law with noise, the stage's tables, their folder, and how many data each GP took.

    Forces after the second trial of a sequence are so large that by their measure the muscle was slack before.
    """
    tables, taken = make_tables(np.random.default_rng(11), noise=10.0), set()
    its = tables["protocol_recordings"]
    its.loc[(its["experiment"] == 2) & (its["trial"] == 3), "force_n"] *= 50.0
    folder = tmp_path_factory.mktemp("baselines")

    def spy(name, found, inputs, *rest, **options):
        taken.add((name, len(inputs), rest[1] if name == "fit_sparse" else len(inputs)))
        return found(inputs, *rest, **options)

    with pytest.MonkeyPatch.context() as patched:
        for name in ("fit", "fit_sparse"):
            patched.setattr(module, name, partial(spy, name, getattr(module, name)))
        curve, compared = run(folder, tables, context=Context)
    return SimpleNamespace(tables=tables, curve=curve, compared=compared, folder=folder, taken=taken)


def test_every_baseline_has_an_error_on_every_test_set(noisy):
    curve = noisy.curve
    counts = curve.groupby("baseline", sort=False).size().to_dict()
    assert counts == {"linear": 2 * 3 * 4, "sparse_gp": 2 * 4, "subset_gp": 2 * 4, "linear_interactive": 4 * 4}
    assert set(curve.loc[curve["baseline"] != "linear_interactive", "participant"]) == {"nobody"}
    assert set(curve.loc[curve["baseline"] == "linear_interactive", "participant"]) == {"p1", "p2"}
    assert (curve.loc[curve["baseline"] != "linear", "trial"] == 3).all()
    for name, its in curve.groupby("tested_on"):
        largest = noisy.tables[str(name)].groupby("muscle")["force_n"].max()
        np.testing.assert_allclose(its["rmse_n"], its["error_rate"] * its["muscle"].map(largest), rtol=1e-12)
    assert len(noisy.compared) == 2 * (2 + 3) * 3
    assert sorted(path.name for path in (noisy.folder / "figures").glob("*.png")) == [
        "baseline_errors.png",
        "learning_curves_baselines.png",
    ]


def test_gps_take_as_many_points_as_the_design(noisy):
    assert noisy.taken == {("fit", 8, 8), ("fit_sparse", 120, 8)}


@pytest.mark.parametrize("tested_on", ["bank", "unseen_bank"])
def test_linear_errors_are_those_of_numpys_least_squares_on_what_was_taut_by_then(noisy, tested_on):
    tables, curve = noisy.tables, noisy.curve
    test = tables[tested_on].query("muscle == 'pam2'")
    its = tables["protocol_recordings"].query("muscle == 'pam2' and experiment == 2")
    designed = tables["active_recordings"].query("muscle == 'pam2' and experiment == 1 and participant == 'p2'")
    data = [("linear", 2, trial, its[its["trial"] <= trial]) for trial in (1, 2, 3)]
    data.append(("linear_interactive", 1, 3, designed[designed["arm"] == "y_y"]))
    for baseline, experiment, trial, samples in data:
        taut = samples[samples["force_n"] >= 0.01 * samples["force_n"].max()]
        weights = np.linalg.lstsq(lay_out(taut), taut["force_n"].to_numpy(), rcond=None)[0]
        missed = np.maximum(lay_out(test) @ weights, 0.0) - test["force_n"]
        where = {"experiment": experiment, "trial": trial, "tested_on": tested_on, "muscle": "pam2"}
        if baseline == "linear_interactive":
            where["participant"] = "p2"
        expected = np.sqrt((missed**2).mean()) / test["force_n"].max()
        assert rates(curve, baseline, **where).item() == pytest.approx(expected, rel=1e-7)


def test_the_linear_law_is_found_where_slack_is_left_out(generator):
    samples = record(generator, 400)
    assert (samples["force_n"] == 0).mean() > 0.1
    model = fit_law(samples, 0.01)
    np.testing.assert_allclose(predict_law(model, samples), samples["force_n"], atol=1e-8)
    assert np.abs(predict_law(fit_law(samples, 0.0), samples) - samples["force_n"]).max() > 1.0


def test_what_depends_on_velocity_is_learned_by_the_gps_alone(generator, tmp_path):
    tables = make_tables(generator, ("pam1",), force=bend, noise=1.06)
    curve, _ = run(tmp_path, tables, sparse_best_iterations=30)
    assert rates(curve, "linear").min() > 0.2
    assert rates(curve, "linear_interactive").min() > 0.2
    assert rates(curve, "sparse_gp").max() < 0.05
    assert rates(curve, "subset_gp").max() < 0.15


def test_points_are_counted_in_the_design_after_its_last_trial():
    rows = [("y_y", 1, trial, muscle) for trial in (0, 0, 1, 2) for muscle in ("pam1", "pam2")]
    rows += [("random", 1, trial, "pam1") for trial in range(9)]
    points = pd.DataFrame(rows, columns=["arm", "experiment", "trial", "muscle"]).assign(participant="p1")
    assert count_points(points, "y_y") == 4
    assert count_points(points, "random") == 9


def test_seeds_draw_subsets_and_starts_and_nothing_else(noisy, tmp_path):
    other, _ = run(tmp_path, noisy.tables, seed=1)
    same = other["error_rate"] == noisy.curve["error_rate"]
    assert same.groupby(noisy.curve["baseline"]).mean().to_dict() == pytest.approx(
        {"linear": 1.0, "linear_interactive": 1.0, "sparse_gp": 0.0, "subset_gp": 0.0}
    )


def test_the_same_models_again_from_fewer_sequences_of_the_protocol(noisy, tmp_path):
    fewer, compared = run(tmp_path, noisy.tables, experiments=1)
    kept = (noisy.curve["participant"] != "nobody") | (noisy.curve["experiment"] == 1)
    pd.testing.assert_frame_equal(fewer, noisy.curve[kept].reset_index(drop=True))
    its = compared[compared["baseline"] == "linear"]
    assert set(zip(its["n_design"], its["n_baseline"], strict=True)) == {(4, 1)}
    assert (its["verdict"] == "undecided").all()


def test_one_trial_of_few_samples_decides_nothing(generator, tmp_path):
    tables = make_tables(generator, experiments=1, trials=1, samples=5)
    for name in ("active_recordings", "points", "learning_curve"):
        tables[name] = tables[name][tables[name]["participant"] == "p1"]
    del tables["unseen_bank"]
    tables["learning_curve"] = tables["learning_curve"].query("tested_on == 'bank'")
    curve, compared = run(tmp_path, tables)
    assert len(curve) == 4 * 2
    assert np.isfinite(curve["error_rate"]).all()
    assert (compared["verdict"] == "undecided").all()
    assert compared[["low", "high", "effect", "p", "p_holm"]].isna().all(axis=None)


def test_without_a_protocol_says_what_is_missing(noisy, tmp_path):
    tables = {**noisy.tables, "protocol_recordings": noisy.tables["protocol_recordings"].iloc[:0]}
    with pytest.raises(WiringError, match=r"add the stage protocol to workflow\.stages"):
        run(tmp_path, tables)


def make_curves(generator, means, experiments=6, sd=0.002, trials=2):
    """Return error rates of the design and of each baseline whose averages over experiments are the planted ones."""
    frames = []
    for baseline, mean in {None: 0.05, **means}.items():
        people = ["p1", "p2"] if baseline in (None, "linear_interactive") else ["nobody"]
        first = 0 if baseline is None else 1 if baseline == "linear" else trials
        keys = product(people, range(1, experiments + 1), range(first, trials + 1), ["bank"], ("pam1", "pam2"))
        frame = pd.DataFrame(list(keys), columns=["participant", "experiment", "trial", "tested_on", "muscle"])
        frame = frame.assign(baseline=baseline)
        noise = pd.Series(sd * generator.standard_normal(len(frame)))
        centred = noise - noise.groupby([frame["trial"], frame["muscle"]]).transform("mean")
        frames.append(frame.assign(error_rate=mean + centred))
    return frames[0].drop(columns="baseline"), pd.concat(frames[1:], ignore_index=True)


BASELINES = ("linear", "sparse_gp", "subset_gp", "linear_interactive")


@pytest.mark.parametrize(
    ("mean", "sd", "verdict"),
    [(0.08, 0.002, "design better"), (0.02, 0.002, "baseline better"), (0.05, 0.002, "undecided")],
)
@pytest.mark.parametrize("baseline", BASELINES)
def test_planted_data_turn_the_verdict(baseline, mean, sd, verdict, generator):
    means = {**dict.fromkeys(BASELINES, 0.05), baseline: mean}
    told = compare_baselines(*make_curves(generator, means, sd=sd), ["pam1", "pam2"]).set_index("baseline")
    assert (told.loc[baseline, "verdict"] == verdict).all()
    assert (told.drop(index=baseline)["verdict"] == "undecided").all()


@pytest.mark.parametrize(("protocol", "design"), [(2, 3), (3, 2)])
def test_the_protocol_may_have_other_trials_than_the_design(protocol, design, generator):
    curves = make_curves(generator, {"linear": 0.06}, trials=3)
    ours, theirs = (
        each.assign(error_rate=each["error_rate"] + 0.01 * each["trial"]).query(f"trial <= {last}")
        for each, last in zip(curves, (design, protocol), strict=True)
    )
    told = compare_baselines(ours, theirs, ["pam1", "pam2"]).query("muscle == 'mean'").set_index("measure")
    for name, frame, last in (("design_mean", ours, design), ("baseline_mean", theirs, protocol)):
        assert told.loc["final", name] == pytest.approx(frame.query(f"trial == {last}")["error_rate"].mean())
        assert told.loc["curve", name] == pytest.approx(frame.query("1 <= trial <= 2")["error_rate"].mean())


@pytest.mark.parametrize(
    ("baseline", "measure", "muscle"),
    [("linear", "final", "mean"), ("linear", "curve", "mean"), ("sparse_gp", "final", "pam1"),
     ("linear_interactive", "final", "pam2")],
)  # fmt: skip
def test_comparisons_agree_with_scipy(baseline, measure, muscle, generator):
    """Of groups, and of the same interaction's experiments in pairs, whatever their order."""
    design, curve = make_curves(generator, {baseline: 0.051}, sd=0.003)
    told = compare_baselines(design, curve.sample(frac=1.0, random_state=1).query("experiment < 6"), ["pam1", "pam2"])
    assert list(told["muscle"][:3]) == ["mean", "pam1", "pam2"]
    row, paired = told.set_index(["measure", "muscle"]).loc[(measure, muscle)], baseline == "linear_interactive"
    values = []
    for frame in (design.query("experiment < 6") if paired else design, curve.query("experiment < 6")):
        its = frame.query("trial == 2" if measure == "final" else "trial >= 1")
        its = its if muscle == "mean" else its[its["muscle"] == muscle]
        values.append(its.groupby(["participant", "experiment"])["error_rate"].mean().to_numpy())
    first, second = values
    test = stats.ttest_rel(*values) if paired else stats.ttest_ind(*values, equal_var=False)
    assert row["p"] == pytest.approx(test.pvalue, rel=1e-9)
    assert (row["low"], row["high"]) == pytest.approx(tuple(test.confidence_interval(0.95)), rel=1e-9)
    told_of = (row["n_design"], row["n_baseline"], row["test"])
    assert told_of == ((10, 10, "paired t") if paired else (12, 5, "Welch"))
    unbiased = 1.0 if paired else np.exp(gammaln(7.5) - gammaln(7)) / np.sqrt(7.5)
    pooled = np.sqrt((11 * first.var(ddof=1) + 4 * second.var(ddof=1)) / 15)
    spread = (first - second).std(ddof=1) if paired else pooled
    assert row["effect"] == pytest.approx(unbiased * (first.mean() - second.mean()) / spread, rel=1e-9)


def test_holm_counts_the_rows_of_each_test_set(generator):
    design, curve = make_curves(generator, dict.fromkeys(BASELINES, 0.0505))
    both = [pd.concat([each, each.assign(tested_on="unseen_bank")], ignore_index=True) for each in (design, curve)]
    told = compare_baselines(*both, ["pam1", "pam2"])
    assert told.groupby("tested_on").size().to_dict() == {"bank": 15, "unseen_bank": 15}
    for _, family in told.groupby("tested_on"):
        assert_holm(family, 15, "p")


def summarise(generator):
    keys = [(line, tested_on, m) for line in "abcde" for tested_on in ("bank", "unseen_bank") for m in ("mean", "pam1")]
    frame = pd.DataFrame(keys, columns=["line", "tested_on", "muscle"])
    return frame.assign(error_rate_mean=generator.uniform(0.01, 0.1, len(frame)), error_rate_sd=np.nan)


def test_bars_are_as_high_as_the_errors_and_told_apart(generator):
    errors = summarise(generator)
    (axis,) = draw_error_bars(errors, list("abcde"), ["mean", "pam1"]).axes
    bars = [each for each in axis.containers if hasattr(each, "patches")]
    assert len({(bar.patches[0].get_facecolor(), bar.patches[0].get_hatch()) for bar in bars}) == 5
    means = errors.set_index(["tested_on", "line", "muscle"])["error_rate_mean"].sort_index()
    for line, bar in zip("abcde", bars, strict=True):
        expected = 100 * means.loc["bank", line].to_numpy()
        np.testing.assert_allclose([patch.get_height() for patch in bar.patches], expected)
    diamonds = [np.asarray(each.get_ydata()) for each in axis.lines if each.get_marker() == "D"]
    np.testing.assert_allclose(np.concatenate(diamonds), 100 * means.loc["unseen_bank"].to_numpy())
    (without,) = draw_error_bars(errors.query("tested_on == 'bank'"), list("abcde"), ["mean", "pam1"]).axes
    assert not [each for each in without.lines if each.get_marker() == "D"]


def test_curves_have_a_panel_for_each_muscle_and_two_lines(generator):
    trials = pd.DataFrame({"trial": [0, 1, 2, 1, 2], "line": ["design"] * 3 + ["baseline"] * 2})
    frame = trials.merge(pd.DataFrame({"muscle": ["mean", "pam1"]}), how="cross")
    frame = frame.assign(error_rate_mean=generator.uniform(0.01, 0.1, len(frame)), error_rate_sd=0.01)
    lines, panels = ["design", "baseline"], ["mean", "pam1"]
    axes = draw_learning_curves(frame, lines, panels, "line", None, LINES, apart=0.0, cut=True).axes
    assert [axis.get_title() for axis in axes[:2]] == ["average of the muscles", "pam1"]
    design, baseline = (container.lines[0] for container in axes[1].containers)
    assert list(design.get_xdata()) == [0, 1, 2]
    assert list(baseline.get_xdata()) == [1, 2]
    expected = 100 * frame.query("line == 'baseline' and muscle == 'pam1'")["error_rate_mean"].to_numpy()
    np.testing.assert_allclose(np.asarray(baseline.get_ydata(), dtype=float), expected)
    assert {design.get_marker(), design.get_linestyle()}.isdisjoint({baseline.get_marker(), baseline.get_linestyle()})
