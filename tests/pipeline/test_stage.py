"""Wiring by signature."""

import pickle
from dataclasses import dataclass

import numpy as np
import pytest
from pydantic import BaseModel

from pipeline.context import Context
from pipeline.errors import WiringError
from pipeline.stage import load_stages, order_stages, stage
from pipeline.table import Table, column


def table(name):
    return Table(name, name, {"value": column(int, "value")})


class Config(BaseModel):
    pass


@stage(table("a"))
def first(cfg: Config, ctx):
    """Write a."""


@stage(table("b"))
def second(cfg: Config, a, ctx):
    """Read a, write b."""


@stage(table("c"))
def third(cfg: Config, a, b, ctx):
    """Read a and b, write c."""


@stage(table("d"))
def easy(cfg: Config, a, ctx, b=None):
    """Read a, and b where there is one, write d."""


@dataclass
class Both:
    a: object
    b: object = None


@stage(table("c"))
def bundled(cfg: Config, both: Both, ctx):
    """Read a, and b where there is one, write c."""
    return both.a, both.b


@stage(table("a"))
def baseline(cfg: Config, ctx):
    """Write a too."""


@stage(table("a"))
def circular(cfg: Config, b, ctx):
    """Write a from b."""


def wire(*stages):
    return [(each.name, each.reads) for each in order_stages(stages)]


def test_signature_is_the_wiring():
    assert wire(third, second, first) == [("first", ()), ("second", ("a",)), ("third", ("a", "b"))]


def test_an_optional_table_is_read_where_a_stage_writes_it():
    assert wire(easy, first) == [("first", ()), ("easy", ("a",))]
    assert wire(easy, second, first) == [("first", ()), ("second", ("a",)), ("easy", ("a", "b"))]


def test_a_dataclass_stands_for_the_tables_that_its_fields_name():
    assert wire(bundled, first)[1] == ("bundled", ("a",))
    assert wire(bundled, second, first)[2] == ("bundled", ("a", "b"))
    assert bundled.function(cfg=None, ctx=None, a=1) == (1, None)
    assert bundled.function(cfg=None, ctx=None, a=1, b=2) == (1, 2)
    assert bundled.module == __name__
    with pytest.raises(WiringError, match="stage same: expected each table in one parameter, got b in two"):

        @stage(table("c"))
        def same(cfg: Config, both: Both, b, ctx):
            """Name b twice."""


def test_refuses_two_writers_no_writer_cycles_and_a_function_without_configuration():
    for stages, told in (
        ((first, baseline), "table a is written by first and by baseline"),
        ((first, third), "stage third reads table b, which no stage"),
        ((circular, second), "stages wait for each other: circular, second"),
    ):
        with pytest.raises(WiringError, match=told):
            order_stages(stages)
    with pytest.raises(WiringError, match="expected parameters cfg"):

        @stage(table("d"))
        def bare(ctx):
            """Lack cfg."""


def test_refuses_two_files_of_one_name(tmp_path, monkeypatch):
    for folder in ("", "early", "late"):
        (tmp_path / "lab" / folder).mkdir(exist_ok=True)
        (tmp_path / "lab" / folder / "__init__.py").touch()
        if folder:
            (tmp_path / "lab" / folder / "weighing.py").touch()
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(WiringError, match=r"early/weighing.py and lab/late/weighing.py: expected one file"):
        load_stages("lab", ["weighing"])


def test_random_numbers_depend_on_the_stream_not_on_the_name(tmp_path):
    def draw(name, stream):
        context = Context(name, tmp_path, 0, None, None, stream=stream)
        draws = [each.generator("trial", 3).random(4) for each in (context, pickle.loads(pickle.dumps(context)))]
        np.testing.assert_array_equal(*draws)
        return draws[0]

    assert stage(table("a"), stream="old")(first.function).stream == "old"
    np.testing.assert_array_equal(draw("new", "old"), draw("old", "old"))
    assert not np.intersect1d(draw("new", "old"), draw("new", "new")).size
    with pytest.raises(WiringError, match="stage new draws random numbers: declare @stage"):
        draw("new", None)
