"""Placeholder until its owner writes it."""

import typer

app = typer.Typer(help="Datasets.")
