"""Sessions of machines whose static law is not the textbook's: what has no name gets none, what has one keeps it."""

import pytest

from tests.benchmark.test_verdicts import decide_on


@pytest.mark.parametrize("seed", [100000, *(pytest.param(k, marks=pytest.mark.slow) for k in (100001, 100009, 100025))])
def test_a_law_that_is_not_the_nominal_one_gets_no_name(seed):
    said = decide_on(f"foreign_building:none-{seed}")
    assert (said.status, said.effects) == ("unexplained", [])
    assert said.remainders["force_n"].family == "static_map"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("session", "name", "channel"),
    [
        ("force_late-strong-100169", "channel_misalignment", "force_n"),
        ("duhem-strong-100241", "hysteresis", "force_n"),
        ("transport_delay-strong-100160", "transport_delay", "pressure_kpa"),
        ("pressure_late-strong-100179", "channel_misalignment", "pressure_kpa"),
        ("angle_late-strong-100187", "channel_misalignment", "force_n"),
        ("slack_opening-strong-100126", "cable_slack", "force_n"),
    ],
)
def test_what_is_there_beside_a_wrong_law_is_named(session, name, channel):
    said = decide_on(f"foreign_building:{session}")
    assert [(each.name, each.channel) for each in said.effects[:1]] == [(name, channel)]
    assert said.effects[0].probability > 0.8
