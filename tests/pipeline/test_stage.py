"""Wiring by signature."""

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


def test_signature_is_the_wiring():
    assert third.reads == ("a", "b")
    assert [each.name for each in order_stages([third, second, first])] == ["first", "second", "third"]


def test_an_optional_table_is_read_where_a_stage_writes_it():
    alone = order_stages([easy, first])
    assert [each.name for each in alone] == ["first", "easy"]
    assert alone[1].reads == ("a",)
    together = order_stages([easy, second, first])
    assert [each.name for each in together] == ["first", "second", "easy"]
    assert together[2].reads == ("a", "b")


def test_a_dataclass_stands_for_the_tables_that_its_fields_name():
    assert order_stages([bundled, first])[1].reads == ("a",)
    assert order_stages([bundled, second, first])[2].reads == ("a", "b")
    assert bundled.function(cfg=None, ctx=None, a=1) == (1, None)
    assert bundled.function(cfg=None, ctx=None, a=1, b=2) == (1, 2)
    assert bundled.module == __name__
    with pytest.raises(WiringError, match="stage same: expected each table in one parameter, got b in two"):

        @stage(table("c"))
        def same(cfg: Config, both: Both, b, ctx):
            """Name b twice."""


def test_refuses_two_writers_no_writer_and_cycles():
    with pytest.raises(WiringError, match="table a is written by first and by baseline"):
        order_stages([first, baseline])
    with pytest.raises(WiringError, match="stage third reads table b, which no stage"):
        order_stages([first, third])
    with pytest.raises(WiringError, match="stages wait for each other"):
        order_stages([circular, second])


def test_refuses_a_function_without_configuration():
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
        return Context(name, tmp_path, 0, None, None, stream=stream).generator("trial", 3).random(4)

    assert stage(table("a"), stream="old")(first.function).stream == "old"
    np.testing.assert_array_equal(draw("new", "old"), draw("old", "old"))
    assert not np.intersect1d(draw("new", "old"), draw("new", "new")).size
    with pytest.raises(WiringError, match="stage new draws random numbers: declare @stage"):
        draw("new", None)
