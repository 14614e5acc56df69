"""The script that plants faults: what it draws is one place of a source that can be compiled."""

from collections import Counter

import pytest

from tests.mutation.__main__ import ROOT, draw_all, read_safeguards
from tests.mutation.mutants import AREAS, is_valid
from tests.mutation.scratch import STEPS


@pytest.fixture(scope="module")
def drawn():
    return draw_all(ROOT, 1, 10, [])


def test_each_area_has_as_many_and_the_same_are_drawn_again(drawn):
    assert Counter(each.area for each in drawn) == dict.fromkeys(AREAS, 2)
    assert draw_all(ROOT, 1, 10, []) == drawn


def test_a_fault_is_in_one_place_of_a_source_that_compiles(drawn):
    for fault in [*drawn, *read_safeguards(ROOT)]:
        source = (ROOT / fault.file).read_bytes()
        planted = fault.plant(source)
        assert planted != source
        assert (
            planted[: fault.start] + source[fault.start : fault.end] + planted[fault.start + len(fault.new) :] == source
        )
        assert is_valid(planted)


def test_what_is_left_out_is_replaced_by_the_next_of_its_area(drawn):
    first = drawn[0].name((ROOT / drawn[0].file).read_bytes())
    assert draw_all(ROOT, 1, 6, [first])[:5:5] == drawn[5:6]


def test_the_steps_are_those_of_ci():
    ci = (ROOT / "README.md").read_text() + (ROOT / ".ci" / "run").read_text()
    assert [each.name for each in STEPS if f"-m {each.marker}" not in ci.replace('"', "")] == []
