"""Maps from robot logs that improve with every drive."""

import os
import sys

from evermap._evermap import EvermapError, Log, Map, Rows, run

__all__ = ["EvermapError", "Log", "Map", "Rows", "run"]

# Functions in plans run where this package does, unless somebody says otherwise.
os.environ.setdefault("EVERMAP_PYTHON", sys.executable)
