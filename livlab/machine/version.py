"""The version of livlab that is installed."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("livlab")
except PackageNotFoundError:  # a source tree that nobody installed
    __version__ = "0+uninstalled"
