"""The foreign catalogues: 300 sessions each on machines whose textbook is wrong.

Flows in: a catalogue's name. Flows out: its scenarios. ``foreign_building`` is there to build on,
``foreign_scoring`` to score with: they share neither a seed nor an outsider, most of their laws differ, and each has a
form of hysteresis of its own. Law, disturbances and sampling rate of a session are drawn by its seed
(``surroundings``).
"""

from itertools import product

from stages.benchmark.blinded_rig.effects import OUTSIDERS_FOR_BUILDING, OUTSIDERS_FOR_SCORING
from stages.benchmark.blinded_rig.machine import MUSCLES
from stages.benchmark.blinded_rig.scenarios import MAGNITUDES, Scenario, default_catalogue, scenario
from stages.benchmark.blinded_rig.surroundings import CatalogueName

EMPTY, REPEATS, OUTSIDERS = 100, 3, 30
FIRST_SEED = {"foreign_building": 100_000, "foreign_scoring": 200_000}
BOTH = (
    "relaxation", "backlash", "slack_opening", "dead_band", "coarse_force", "coarse_pressure", "transport_delay",
    "force_late", "pressure_late", "angle_late", "pressed_friction", "bristle_friction", "orifice_leak", "choked_valve",
)  # fmt: skip
EFFECTS_OF: dict[str, tuple[str, ...]] = {
    "foreign_building": (*BOTH, "prandtl_ishlinskii", "duhem"),
    "foreign_scoring": (*BOTH, "preisach", "duhem"),
}
OUTSIDERS_OF: dict[str, tuple[str, ...]] = {
    "foreign_building": OUTSIDERS_FOR_BUILDING,
    "foreign_scoring": OUTSIDERS_FOR_SCORING,
}
PAIRS = (
    ("relaxation", "choked_valve"), ("duhem", "pressure_late"), ("pressed_friction", "choked_valve"),
    ("backlash", "orifice_leak"), ("force_late", "choked_valve"), ("bristle_friction", "transport_delay"),
    ("duhem", "sensor_drift"), ("relaxation", "sensor_drift_pressure"), ("slack_opening", "pressure_late"),
    ("dead_band", "choked_valve"), ("force_late", "transport_delay"), ("pressed_friction", "coarse_pressure"),
    ("duhem", "transport_delay"),
)  # fmt: skip
SINGLE = (
    "duhem", "relaxation", "backlash", "slack_opening", "dead_band", "coarse_force", "coarse_pressure",
    "transport_delay", "force_late", "pressure_late", "pressed_friction", "bristle_friction", "choked_valve",
)  # fmt: skip


def catalogue_named(name: CatalogueName) -> list[Scenario]:
    """Return a catalogue's scenarios, each with a seed of its own in the foreign ones.

    A foreign catalogue holds 100 with nothing hidden, 16 effects x 3 magnitudes x 3, 30 outsiders, 13 pairs and 13 on
    one muscle.
    """
    if name == "own":
        return default_catalogue()
    outsiders = OUTSIDERS_OF[name]
    asked: list[tuple[tuple[str, ...], int, tuple[str, ...]]] = [((), 1, MUSCLES)] * EMPTY
    asked += [((key,), size, MUSCLES) for key, size, _ in product(EFFECTS_OF[name], range(3), range(REPEATS))]
    asked += [((outsiders[k % len(outsiders)],), 1 + k // len(outsiders) % 2, MUSCLES) for k in range(OUTSIDERS)]
    asked += [(pair, 1 + k % 2, MUSCLES) for k, pair in enumerate(PAIRS)]
    asked += [((key,), 1 + k // 4 % 2, (MUSCLES[k % len(MUSCLES)],)) for k, key in enumerate(SINGLE)]
    return [
        scenario(keys, MAGNITUDES[size], FIRST_SEED[name] + k, muscles, name)
        for k, (keys, size, muscles) in enumerate(asked)
    ]
