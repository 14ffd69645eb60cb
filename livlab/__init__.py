"""livlab: the lab that says how light and living tissue meet, and proves it."""

from importlib.metadata import PackageNotFoundError, version

try:
    __version__ = version("livlab")
except PackageNotFoundError:  # a source tree that nobody installed
    __version__ = "0+uninstalled"

__all__ = ["__version__"]
