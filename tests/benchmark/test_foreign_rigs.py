"""Foreign rigs: static laws, disturbances, effects in other forms and the two catalogues of them."""

import hashlib
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from stages.benchmark.blinded_rig import __main__ as command
from stages.benchmark.blinded_rig.calibration import RATIOS, NominalFit
from stages.benchmark.blinded_rig.catalogues import EFFECTS_OF, OUTSIDERS_OF, catalogue_named
from stages.benchmark.blinded_rig.chain import STEP_S
from stages.benchmark.blinded_rig.dataset import simulate
from stages.benchmark.blinded_rig.disturbances import disturb, hum, pink, ripple
from stages.benchmark.blinded_rig.effects import ALL_EFFECTS, EFFECTS, FOREIGN_EFFECTS
from stages.benchmark.blinded_rig.effects.flow import fill_choking, fill_with_hole
from stages.benchmark.blinded_rig.effects.memory import RELAYS, preisach_memory, relay_weights, stop_memory
from stages.benchmark.blinded_rig.effects.oddities import resonate
from stages.benchmark.blinded_rig.effects.transmission import play
from stages.benchmark.blinded_rig.laws import BRAID, LAWS, build_law
from stages.benchmark.blinded_rig.laws.exponential import Exponential
from stages.benchmark.blinded_rig.laws.sheet import full_force_n
from stages.benchmark.blinded_rig.laws.stretch import Stretch
from stages.benchmark.blinded_rig.laws.table import CONTRACTIONS, PRESSURES_KPA, build_table
from stages.benchmark.blinded_rig.laws.virtual_work import mooney_rivlin, shell
from stages.benchmark.blinded_rig.machine import JOINT_OF_MUSCLE, build_machine
from stages.benchmark.blinded_rig.scenarios import Scenario, default_catalogue, named_scenario
from stages.benchmark.blinded_rig.sensors import draw_noise
from stages.benchmark.blinded_rig.session import build_session, observe
from stages.benchmark.blinded_rig.sessions import HiddenSessions
from stages.benchmark.blinded_rig.surroundings import LAW_CHANCES, LEVELS, SEED_OFFSET, draw_surroundings
from tests.benchmark.test_blinded_rig import observe_quietly

FOREIGN = ("foreign_building", "foreign_scoring")
ONLY_PAM1 = np.array([1.0, 0.0, 0.0, 0.0])
DISSIPATIVE = ("hysteresis", "creep", "coulomb_friction", "stribeck_friction", "capstan_friction", "viscous_friction")
DISSIPATIVE += ("prandtl_ishlinskii", "duhem", "preisach", "pressed_friction", "bristle_friction")
BEFORE = {  # standard deviations of pressure (kPa) and force (N) in two trials
    "none-1000": (116.158980682557, 945.887983479),
    "hysteresis-medium-7": (101.035638703145, 878.604803544114),
    "creep+sensor_drift-strong-4011": (117.730876525751, 724.430223288739),
    "valve_lag-weak-pam1-5003": (108.709419739704, 842.239754702608),
}


def first_seed(catalogue, wanted):
    """The first seed whose surroundings are as wanted."""
    for seed in range(200):
        sequence = np.random.SeedSequence(seed + SEED_OFFSET[catalogue], spawn_key=(5,))
        if wanted(draw_surroundings(catalogue, np.random.default_rng(sequence))):
            return seed
    raise AssertionError("no such seed")


@pytest.fixture(scope="module")
def still():
    """A foreign session without noise, and its readings."""
    seed = first_seed("foreign_building", lambda around: around.law == "table")
    session = build_session(seed, 2, "joint_end", noisy=False, catalogue="foreign_building")
    return session, observe(session, ())


def test_the_rigs_own_catalogue_and_sessions_are_as_before():
    added = {f"none-{number}" for number in range(1060, 1100)}
    whole = [each.name for each in default_catalogue()]
    assert added < {*whole}
    names = "\n".join(name for name in whole if name not in added)
    assert hashlib.sha256(names.encode()).hexdigest()[:16] == "c7d79171036bd18c"
    for name, before in BEFORE.items():
        made = simulate(replace(named_scenario(name), trials=2))
        assert tuple(made.samples[["pressure_kpa", "force_n"]].std()) == pytest.approx(before, rel=1e-9)
        assert "catalogue" not in made.truth["scenario"]
        assert not {"surroundings", "law"} & {*made.truth, *made.truth["machine"]}


def grid():
    pressure, contraction = np.linspace(50.0, 600.0, 12)[:, None], np.linspace(0.01, 0.2, 9)
    return tuple(np.broadcast_to(each, (4, 12, 9)) for each in (pressure, contraction))


def textbook_misfit(force, pressure, contraction, full):
    """RMS over full force of what the ideal braid leaves, with area, angle, factor and a quadratic sleeve free."""

    def left(free):
        area, angle, factor = free
        braid = area * pressure * (3.0 * (1.0 - factor * contraction) ** 2 * np.cos(angle) ** 2 - 1.0)
        sleeve = np.column_stack([np.ones_like(contraction), contraction, contraction**2])
        rest = (force - braid) / full
        return rest - sleeve @ np.linalg.lstsq(sleeve, rest, rcond=None)[0]

    start = [full / 600.0 / 1.464, np.deg2rad(25.0), 1.08]
    fitted = least_squares(left, start, x_scale=[full / 600.0, 0.1, 0.1])
    return float(np.sqrt(np.mean(fitted.fun**2)))


@pytest.mark.parametrize("key", LAWS)
def test_a_law_has_the_sheets_forces_and_not_the_textbooks_form(key):
    pressure, contraction = grid()
    law, ideal = build_law(key, np.random.default_rng(3)), build_machine(np.random.default_rng(0), varied=False)
    force, full = law.tension(pressure, contraction), full_force_n()
    off = (force - ideal.static_force(pressure, contraction)) / full[:, None, None]
    assert np.abs(off).max() < 0.16
    assert np.all(np.diff(force, axis=2) < 0.0), "a muscle that shortens pulls less"
    missed = [textbook_misfit(force[m].ravel(), pressure[m].ravel(), contraction[m].ravel(), full[m]) for m in range(4)]
    assert min(missed) > 0.003
    assert max(missed) < 0.02
    assert not np.array_equal(force, build_law(key, np.random.default_rng(4)).tension(pressure, contraction))


def test_laws_obey_their_closed_forms():
    ones = np.ones(4)
    pressure, contraction = np.full((4, 1), 300.0), np.full((4, 1), 0.1)
    law = Exponential(2.0 * ones, 30.0 * ones, -20.0 * ones, -5.0 * ones, 1.0 * ones, -4.0 * ones)
    expected = (2.0 * 300.0 + 30.0) * np.exp(-2.0) - 5.0 * 0.1 * 300.0 + 300.0 - 4.0
    np.testing.assert_allclose(law.tension(pressure, contraction), expected)
    spring = Stretch(0.4 * ones, 0.01 * ones, 0.02 * ones, 0.8 * ones, 0.17 * ones, 1000.0 * ones)
    stiffness = 0.17 * 0.25 + 0.8 * 0.5 * 0.75 + 0.02 * 0.75**2 + 0.01
    np.testing.assert_allclose(spring.tension(pressure, contraction), 1000.0 * stiffness * 0.75)


def test_a_slender_shell_is_the_ideal_braid():
    braid = np.deg2rad(25.0)
    contraction, pull = shell(braid, 0.002)
    ideal = (3.0 * (1.0 - contraction) ** 2 * np.cos(braid) ** 2 - 1.0) / (3.0 * np.cos(braid) ** 2 - 1.0)
    inside = (contraction > 0.0) & (contraction < 0.25)
    np.testing.assert_allclose(pull[inside], ideal[inside], atol=0.02)
    early = inside & (contraction < 0.1)
    assert np.all(shell(braid, 0.12)[1][early] < pull[early]), "ends take some of the pull"
    assert abs(mooney_rivlin(np.zeros(1), braid, 0.25)[0]) < 1e-6, "rubber at rest pulls nothing"


def test_a_table_passes_through_its_points_and_keeps_their_shape():
    table = build_table(np.random.default_rng(1))
    shape = table.force_n.shape
    pressure, contraction = (np.broadcast_to(each, shape) for each in (PRESSURES_KPA[:, None], CONTRACTIONS))
    np.testing.assert_allclose(table.tension(pressure, contraction), table.force_n, rtol=1e-9, atol=1e-9)
    fine = np.broadcast_to(np.linspace(-0.04, 0.28, 641), (4, 641))
    row = table.tension(np.full((4, 641), PRESSURES_KPA[8]), fine)
    assert np.all(np.diff(row, axis=1) < 0.0), "falls between points as from point to point"
    assert np.abs(np.diff(row, 2, axis=1)).max() < 0.002 * full_force_n().max(), "no kinks"


def test_pink_noise_falls_as_one_over_frequency():
    noise = pink(np.random.default_rng(0), (400, 1000))
    assert noise.std() == pytest.approx(1.0, rel=0.03)
    power = np.mean(np.abs(np.fft.rfft(noise)) ** 2, axis=0)[1:400]
    assert np.polyfit(np.log(np.arange(1, 400)), np.log(power), 1)[0] == pytest.approx(-1.0, abs=0.05)


def test_disturbances_are_as_large_as_stated_and_hum_and_ripple_have_their_lines():
    wanted = draw_surroundings("foreign_building", np.random.default_rng(0))
    loud = replace(wanted, **{name: level[3] for name, level in LEVELS.items()}, ripple_hz=12.0)
    rng, start_s = np.random.default_rng(1), 20.0 * np.arange(300.0)
    plain = draw_noise(np.random.default_rng(2), start_s, 20, 0.01)
    noise = disturb(plain, loud, rng, start_s, 0.01)
    assert (noise.force_gain / plain.force_gain).std() == pytest.approx(0.03, rel=0.08)
    quiet = disturb(plain, replace(loud, **dict.fromkeys(LEVELS, 0.0)), rng, start_s, 0.01)
    np.testing.assert_array_equal(quiet.force_added_share, plain.force_added_share)
    np.testing.assert_array_equal(quiet.pressure_added_kpa, plain.pressure_added_kpa)
    offset = (noise.force_added_share - plain.force_added_share).mean(axis=-1)
    assert offset.std() == pytest.approx(0.002, rel=0.15)
    time_s = np.arange(0.0, 4.0, STEP_S)
    for wave, hertz, rms in (
        (hum(np.random.default_rng(0), np.array([[0.0]]) + time_s)[0, 0], 50.0, 1.0),
        (ripple(np.random.default_rng(0), loud, np.zeros(1), time_s)[0], 12.0, 3.0),
    ):
        line = np.fft.rfftfreq(wave.size, STEP_S)[np.argmax(np.abs(np.fft.rfft(wave)))]
        assert line == pytest.approx(hertz, abs=0.3)
        assert wave.std() == pytest.approx(rms, rel=0.1)


def test_ripple_is_common(still):
    session, without = still
    stimulus = replace(session.stimulus, ripple_kpa=np.ones((2, session.stimulus.joint_rad.shape[-1])))
    raised = observe(replace(session, stimulus=stimulus), ()).pressure_kpa - without.pressure_kpa
    np.testing.assert_allclose(*np.broadcast_arrays(raised, session.machine.pressure_gain[:, None, None]), rtol=1e-9)


@pytest.mark.parametrize("rate_hz", [100.0, 250.0, 500.0])
def test_a_rate_is_told_and_kept(rate_hz):
    seed = first_seed("foreign_scoring", lambda around: around.rate_hz == rate_hz)
    made = simulate(Scenario((), "medium", seed, trials=1, catalogue="foreign_scoring"))
    assert made.meta["sampling_rate_hz"] == rate_hz
    assert len(made.samples) == 4 * round(4.0 * rate_hz)
    np.testing.assert_allclose(np.diff(np.unique(made.samples["time_s"])), 1.0 / rate_hz, atol=1e-12)
    assert made.truth["surroundings"]["law"] in LAW_CHANCES["foreign_scoring"]


@pytest.mark.parametrize("key", ALL_EFFECTS)
def test_an_effect_changes_only_its_muscle_and_channel_and_nothing_without_a_size(key, still):
    session, without = still if key in FOREIGN_EFFECTS else observe_quietly()
    effect = ALL_EFFECTS[key]
    readings = observe(session, ((effect, 0.5 * effect.largest * ONLY_PAM1),))
    for channel in ("pressure_kpa", "force_n"):
        assert np.isfinite(getattr(readings, channel)).all()
        np.testing.assert_array_equal(getattr(readings, channel)[1:], getattr(without, channel)[1:])
    if effect.site in ("angle_wire", "pressure_wire"):
        np.testing.assert_array_equal(readings.force_n, without.force_n)
    if effect.site == "angle_wire":
        changed = session.as_read(readings).contraction - session.contraction
        assert np.abs(changed[JOINT_OF_MUSCLE == 0]).max() > 1e-3
        assert not changed[JOINT_OF_MUSCLE == 1].any()
        return
    assert np.abs(getattr(readings, effect.channel)[0] - getattr(without, effect.channel)[0]).max() > 1e-6
    if effect.channel == "force_n":
        np.testing.assert_array_equal(readings.pressure_kpa, without.pressure_kpa)
    none, hardly = (observe(session, ((effect, np.full(4, size)),)) for size in (0.0, 1e-6 * effect.largest))
    if key in EFFECTS:
        np.testing.assert_array_equal(getattr(none, effect.channel), getattr(without, effect.channel))
    off = np.abs(getattr(hardly, effect.channel) - getattr(without, effect.channel)).max(axis=(1, 2))
    noise = session.machine.full_force_n * 8e-4 if effect.channel == "force_n" else np.full(4, 0.75)
    assert np.all(off < 0.2 * noise)


@pytest.mark.parametrize("key", DISSIPATIVE)
def test_friction_and_memory_take_energy(key, still):
    session, without = still if key in FOREIGN_EFFECTS else observe_quietly()
    size = (0.3 if key in FOREIGN_EFFECTS else 0.2) * ALL_EFFECTS[key].largest
    readings = observe(session, ((ALL_EFFECTS[key], np.full(4, size)),))
    power = (readings.force_n - without.force_n) * session.contraction_velocity_per_s
    assert np.all(power.sum(axis=(1, 2)) < 0.0)


def test_play_and_stops_are_each_others_rest():
    path = np.cumsum(np.random.default_rng(0).normal(0.0, 1e-3, (1, 1, 2000)), axis=-1)
    width = np.array([0.004])
    stop = stop_memory(path, width, np.ones(1))
    np.testing.assert_allclose(play(path, width, np.zeros((1, 1))) + width * stop, path, atol=1e-12)


def test_preisach_forgets_inner_loops():
    there = np.linspace(0.02, 0.18, 400)
    inner = np.concatenate([there[:200], there[200:100:-1], there[100:]])
    weights = relay_weights(RELAYS)
    plain, with_loop = (preisach_memory(each[None, None], RELAYS, weights)[0, 0] for each in (there, inner))
    assert plain[-1] == pytest.approx(with_loop[-1], abs=1e-12)
    assert np.all(np.diff(plain) >= 0.0)


def test_air_flows_as_orifices_let_it():
    target, tau = np.full((1, 1, 6000), 300.0), np.array([0.04])
    leaking = fill_with_hole(target, tau, np.array([1.0]), STEP_S)[0, 0, -1]
    assert leaking == pytest.approx((300.0 - 0.04 * 101.3) / 1.04, rel=0.01), "choked: as the absolute pressure"
    up, down = (np.concatenate([np.full(10, a), np.full(4000, b)])[None, None] for a, b in ((0.0, 400.0), (400.0, 0.0)))
    filled, vented = (fill_choking(each, tau, np.array([1.0]), STEP_S)[0, 0] for each in (up, down))
    assert np.argmax(filled > 200.0) < np.argmax(vented < 200.0), "venting is slower"
    np.testing.assert_allclose(fill_choking(up, tau, np.zeros(1), STEP_S)[0, 0, -1], 400.0, rtol=1e-6)


def test_a_resonance_swings_at_its_frequency():
    drive = np.concatenate([np.zeros(10), np.ones(8000)])[None, None]
    swing = resonate(drive, 10.0, 0.02, STEP_S)[0, 0] - 1.0
    crossings = np.flatnonzero(np.diff(np.sign(swing[20:])))
    assert 0.5 / (np.diff(crossings).mean() * STEP_S) == pytest.approx(10.0, rel=0.02)


@pytest.mark.parametrize(
    ("catalogue", "key", "magnitude"),
    [("building", "duhem", "medium"), ("scoring", "choked_valve", "weak"), ("scoring", "preisach", "strong")],
)
def test_magnitudes_are_reached(catalogue, key, magnitude):
    told = simulate(Scenario((key,), magnitude, 7, ("pam1", "pam3"), trials=4, catalogue=f"foreign_{catalogue}")).truth
    assert set(told["textbook_misses_share"]) == {"pam1", "pam2", "pam3", "pam4"}
    for ratio in told["effects"][0]["gap_over_floor"].values():
        assert ratio == pytest.approx(RATIOS[magnitude], rel=0.05)


def test_a_late_angle_has_one_size_per_joint():
    made = simulate(Scenario(("angle_late",), "weak", 7, trials=3, catalogue="foreign_scoring"))
    size = made.truth["effects"][0]["size"]
    assert size["pam1"] == size["pam2"]
    assert size["pam3"] == size["pam4"]
    angle = made.samples.pivot(index=["trial", "time_s"], columns="muscle", values="joint_angle_rad")
    assert (angle["pam1"] == angle["pam2"]).all()


def test_catalogues_share_no_seed_no_outsider_and_hardly_a_law():
    building, scoring = (catalogue_named(name) for name in FOREIGN)
    for name, scenarios in zip(FOREIGN, (building, scoring), strict=True):
        kinds = Counter(len(each.effects) for each in scenarios)
        assert (len(scenarios), kinds[0], kinds[2]) == (300, 100, 13)
        assert len({each.name for each in scenarios}) == len({each.seed for each in scenarios}) == 300
        assert sum(len(each.muscles) == 1 for each in scenarios) == 13
        assert sum(ALL_EFFECTS[each.effects[0]].outsider for each in scenarios if each.effects) == 30
        assert all(named_scenario(each.name) == each for each in scenarios)
        single = Counter((each.effects[0], each.magnitude) for each in scenarios if len(each.effects) == 1)
        assert all(single[key, size] >= 3 for key in EFFECTS_OF[name] for size in RATIOS)
    assert not {each.seed for each in building} & {each.seed for each in scoring}
    assert len(OUTSIDERS_OF["foreign_scoring"]) >= 4
    assert "stretch" not in LAW_CHANCES["foreign_building"]
    assert not set(OUTSIDERS_OF["foreign_building"]) & set(OUTSIDERS_OF["foreign_scoring"])
    assert {key for key, effect in EFFECTS.items() if effect.outsider} < set(OUTSIDERS_OF["foreign_building"])
    assert all(abs(sum(chances.values()) - 1.0) < 1e-12 for chances in LAW_CHANCES.values())
    assert len({max(chances, key=chances.get) for chances in LAW_CHANCES.values()}) == 2


@pytest.mark.parametrize("name", FOREIGN)
def test_the_rig_obeys_its_catalogue(name):
    rig = HiddenSessions(3, None, None, None, 1, name)
    assert rig.catalogue() == [each.name for each in catalogue_named(name)]
    assert rig.hidden.catalogue == name
    assert all(each["key"] in EFFECTS_OF[name] + OUTSIDERS_OF[name] for each in rig.effects())
    first, same = rig.record("none-5"), rig.record(f"{name}:none-5")
    assert first.samples.equals(same.samples)
    assert first.truth["name"] == f"{name}:none-5"
    assert not first.samples.equals(HiddenSessions(3, None, None, None, 1).record("none-5").samples)


def test_a_foreign_catalogue_is_taken_and_an_unknown_one_or_law_refused(tmp_path):
    for refused, asked in (
        ("unknown catalogue 'foreign'", lambda: HiddenSessions(3, None, None, None, 1, "foreign")),
        ("names no session", lambda: named_scenario("alien:none-5")),
        ("unknown law 'brade'", lambda: build_law("brade", np.random.default_rng(0))),
    ):
        with pytest.raises(ValueError, match=refused):
            asked()
    assert build_law(BRAID, np.random.default_rng(0)) is None
    words = [str(tmp_path / "d"), "catalogue=foreign_scoring", "effect=backlash", "trials=1", "seed=2"]
    assert command.main(words) == 0


def test_noise_leaves_the_machine_as_it_is():
    noisy, quiet = (build_session(4, 2, "joint_end", noisy=flag, catalogue="foreign_scoring") for flag in (True, False))
    np.testing.assert_array_equal(noisy.stimulus.command_kpa, quiet.stimulus.command_kpa)
    assert quiet.stimulus.ripple_kpa is None
    np.testing.assert_array_equal(*(each.machine.static_force(*grid()) for each in (noisy, quiet)))
    assert np.all(NominalFit(quiet).floor["force_n"] < NominalFit(noisy).floor["force_n"])
