"""The options of the command line: arguments as typed flow in, options and overrides flow out.

The options are Hydra's, which reads them again where it shows help or the configuration.
"""

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from typing import NoReturn

from pipeline.errors import ConfigError

FLAGS = ("--help -h", "--hydra-help", "--resolve", "--run -r", "--multirun -m", "--shell-completion -sc")
WITH_VALUE = ("--package -p", "--config-path -cp", "--config-name -cn", "--config-dir -cd")
INFORMATION = ("all", "config", "defaults", "defaults-tree", "plugins", "searchpath")


class _Parser(ArgumentParser):
    def error(self, message: str) -> NoReturn:
        raise ConfigError(f"{message}; python -m pipeline --hydra-help shows the options")


def read_options(arguments: Sequence[str]) -> Namespace:
    """Return the options of a command line, and its ``overrides``, which may stand among them."""
    parser = _Parser(add_help=False)
    for names in FLAGS:
        parser.add_argument(*names.split(), action="store_true")
    for names in WITH_VALUE:
        parser.add_argument(*names.split())
    parser.add_argument("--cfg", "-c", choices=("job", "hydra", "all"))
    parser.add_argument("--info", "-i", nargs="?", const="all", choices=INFORMATION)
    parser.add_argument("overrides", nargs="*")
    return parser.parse_intermixed_args(list(arguments))


def put_options_first(arguments: Sequence[str]) -> list[str]:
    """Return the command line with its options before the overrides, as Hydra reads it."""
    overrides = read_options(arguments).overrides
    options = list(arguments)
    for each in overrides:
        options.remove(each)
    return [*options, *overrides]
