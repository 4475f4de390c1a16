from os import PathLike
from typing import Any

import geopandas
import pandas
import polars
import pyarrow

class EvermapError(Exception):
    """What went wrong, where, and what to do next."""

class Rows:
    """The rows of an answer, as Arrow. Whatever reads Arrow's C stream (pyarrow, polars, DuckDB) takes them as they are."""

    @property
    def columns(self) -> list[str]: ...
    def __len__(self) -> int: ...
    def __arrow_c_stream__(self, requested_schema: object | None = None) -> object: ...
    def arrow(self) -> pyarrow.Table: ...
    def pandas(self) -> pandas.DataFrame: ...
    def polars(self) -> polars.DataFrame: ...
    def geopandas(self, geometry: str = "geometry") -> geopandas.GeoDataFrame:
        """With a column of well-known binary as geometry: local metres in the map frame, so without a reference system."""

class Map:
    """A map at one of its versions: the newest, unless one is named."""

    def __init__(self, address: str | PathLike[str], version: int | None = None) -> None: ...
    @property
    def version(self) -> int: ...
    @property
    def layers(self) -> list[str]: ...
    def layer(self, name: str) -> Rows:
        """All rows of a layer."""
    def sql(self, query: str) -> Rows:
        """The answer to a query, with the tables and functions of `evermap sql --map`."""

class Log:
    """Logs as tables: topics, roles, messages, as `evermap sql --sessions` has them."""

    def __init__(
        self, *sessions: str | PathLike[str], manifest: str | PathLike[str] | None = None, site: str | None = None
    ) -> None: ...
    def sql(self, query: str) -> Rows: ...
    @property
    def lost(self) -> dict[str, int]:
        """What could not be read so far, by reason."""

def run(
    plan: str,
    map: str | PathLike[str],
    sessions: list[str | PathLike[str]] = [],
    site: str | None = None,
    settings: dict[str, Any] = {},
    manifest: str | PathLike[str] | None = None,
) -> dict[str, int]:
    """Runs a plan, shipped or a file, on sessions, and publishes a version. Returns what was lost or skipped, by reason."""
