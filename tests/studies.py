"""Studies of chosen stages for tests: composed and validated as by the command, stages run in memory."""

import pandas as pd
from rich.console import Console

from pipeline.config import Settings, read_study
from pipeline.context import Context, Record
from tests.composing import compose_values


def read_stages(stages, *overrides):
    """Return the study of these stages, and the stages by name; sections of other stages are quoted, not refused."""
    line = ["budget=tiny", f"workflow.stages=[{','.join(stages)}]", "workflow.headline=[]", *overrides]
    composed = compose_values(*line)
    composed.workflow.metrics, composed.workflow.curves = {}, {}
    composed.workflow.quoted = [str(name) for name in composed if name not in Settings.model_fields]
    study, ordered = read_study(composed)
    return study, {stage.name: stage for stage in ordered}


def run_stage(study, stage, folder, tables, rig=None):
    """Run a stage on these tables; return its own, as checked when they are written."""
    seed = study.slice(stage).get(stage.name, {}).get("seed", study.settings.seed)
    record = Record(folder / "parts" / stage.name, {table.name: table for table in stage.writes}, lambda: None)
    if rig is None and study.target(stage):
        rig = study.build(study.target(stage))
    context = Context(stage.name, folder, seed, record, Console(quiet=True), rig)
    found = stage.function(cfg=study.config(stage), ctx=context, **{name: tables[name] for name in stage.reads})
    if isinstance(found, pd.DataFrame):
        found = (found,)
    if not isinstance(found, dict):
        found = dict(zip((table.name for table in stage.writes), found, strict=True))
    return {table.name: table.check(found[table.name], "in memory") for table in stage.writes}
