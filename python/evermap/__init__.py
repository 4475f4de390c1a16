"""Maps from robot logs that improve with every drive."""

from evermap._evermap import EvermapError, Log, Map, Rows, run

__all__ = ["EvermapError", "Log", "Map", "Rows", "run"]
