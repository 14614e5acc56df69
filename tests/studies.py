"""Studies of chosen stages for tests: composed and validated as by the command, stages run in memory."""

import pickle
from itertools import islice

import pandas as pd
import pytest
from rich.console import Console

from pipeline.config import Settings, read_study
from pipeline.context import Context, Record
from pipeline.errors import ConfigError
from tests.composing import compose_values


def read_stages(stages, *overrides):
    """Return the study of these stages, and the stages by name; sections of other stages are quoted, not refused."""
    line = ["budget=tiny", f"workflow.stages=[{','.join(stages)}]", "workflow.headline=[]", *overrides]
    composed = compose_values(*line)
    composed.workflow.metrics, composed.workflow.curves = {}, {}
    composed.workflow.quoted = [str(name) for name in composed if name not in Settings.model_fields]
    study, ordered = read_study(composed)
    return study, {stage.name: stage for stage in ordered}


def assert_refused(stages, told, *overrides):
    """Check that a configuration is refused in one line that begins so."""
    with pytest.raises(ConfigError) as refusal:
        read_stages(stages, *overrides)
    assert str(refusal.value).startswith(told)
    assert "\n" not in str(refusal.value)


class PickledContext(Context):
    """A context that sends jobs as if to other processes, and keeps figures to itself."""

    def spread(self, function, jobs):
        yield from super().spread(*pickle.loads(pickle.dumps((function, jobs))))

    def figure(self, name, figure, caption):
        self.files[name] = {"caption": caption}


def run_alone(stage, cfg, folder, tables, seed=0, context=Context, rig=None):
    """Run a stage on these tables; return its own by name, as checked when they are written."""
    record = Record(folder / "parts" / stage.name, {table.name: table for table in stage.writes}, lambda: None)
    ctx = context(stage.name, folder, seed, record, Console(quiet=True), rig, stream=stage.stream)
    found = stage.function(cfg=cfg, ctx=ctx, **tables)
    if isinstance(found, pd.DataFrame):
        found = (found,)
    if not isinstance(found, dict):
        found = dict(zip((table.name for table in stage.writes), found, strict=True))
    return {table.name: table.check(found[table.name], "in memory") for table in stage.writes}


def run_stage(study, stage, folder, tables, rig=None, context=Context):
    """Run a stage of a study on those of these tables that it reads; return its own."""
    seed = study.slice(stage).get(stage.name, {}).get("seed", study.settings.seed)
    if rig is None and study.target(stage):
        rig = study.build(study.target(stage))
    read = {name: tables[name] for name in stage.reads}
    return run_alone(stage, study.config(stage), folder, read, seed, context, rig)


def stop_after(monkeypatch, jobs, run, *arguments):
    """Run a stage that is killed when it has so many jobs done."""
    asked = Context.spread

    def stop(self, function, each):
        yield from islice(asked(self, function, each), jobs)
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Context, "spread", stop)
        with pytest.raises(KeyboardInterrupt):
            run(*arguments)
