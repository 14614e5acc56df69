"""The configuration as Hydra composes it: what options of groups make is composed once, values are put into copies."""

import pickle
from functools import cache
from pathlib import Path

from hydra import compose, initialize_config_dir
from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import DictConfig

CONF = Path(__file__).resolve().parent.parent / "conf"
GROUPS = {path.name for path in CONF.iterdir() if path.is_dir()}


def compose_values(*overrides: str) -> DictConfig:
    """Return what Hydra composes of a command line's overrides."""
    options = tuple(each for each in overrides if each.lstrip("+~").partition("=")[0].partition("@")[0] in GROUPS)
    values = pickle.loads(_compose(options))
    others = OverridesParser.create().parse_overrides([each for each in overrides if each not in options])
    ConfigLoaderImpl._apply_overrides_to_config(others, values)
    return values


@cache
def _compose(options: tuple[str, ...]) -> bytes:
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return pickle.dumps(compose("config", overrides=list(options)))
