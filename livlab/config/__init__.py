"""Experiment files: TOML, versioned; an unknown key is an error that names its path and the nearest known key."""

from livlab.config.kinds import KINDS, Kind
from livlab.config.load import (
    LARGEST_BYTES,
    builtin_experiments,
    check_experiment,
    json_schema,
    load_experiment,
    load_section,
    parse_experiment,
    to_toml,
)
from livlab.config.schema import SCHEMA, Experiment, Label, Name, Section, Text

__all__ = [
    "KINDS",
    "LARGEST_BYTES",
    "SCHEMA",
    "Experiment",
    "Kind",
    "Label",
    "Name",
    "Section",
    "Text",
    "builtin_experiments",
    "check_experiment",
    "json_schema",
    "load_experiment",
    "load_section",
    "parse_experiment",
    "to_toml",
]
