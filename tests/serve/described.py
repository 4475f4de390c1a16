"""What columns of answers say of themselves: described.py HTTP QUERY FILE

FILE is what `evermap sql` writes of QUERY, as Parquet.
"""

import io
import sys
import urllib.parse
import urllib.request

import adbc_driver_flightsql.dbapi
import pyarrow
import pyarrow.parquet


def said(schema):
    """What is said of a table, and of each of its columns."""
    notes = {field.name: dict(field.metadata or {}) for field in schema}
    for column in notes.values():
        # pyarrow's own.
        column.pop(b"PARQUET:field_id", None)
    return dict(schema.metadata or {}), notes


def got(http, path, **asked):
    with urllib.request.urlopen(f"http://{http}{path}?" + urllib.parse.urlencode(asked)) as answer:
        return answer.read()


def by_http(http, path, **asked):
    """As Arrow and as Parquet."""
    arrow, parquet = [got(http, path, format=format, **asked) for format in ["arrow", "parquet"]]
    yield "arrow", pyarrow.ipc.open_stream(arrow).schema
    yield "parquet", pyarrow.parquet.read_schema(io.BytesIO(parquet))


def main(http, query, file):
    expected = said(pyarrow.parquet.read_schema(file))
    metre = {b"unit": b"m"}
    columns = [expected[1][name] for name in ["at", "east", "twice"]]
    assert columns == [{b"unit": b"ns"}, metre, {}], expected
    assert expected[1]["map_from_vehicle"][b"frame"] == b"map", expected
    for name, schema in by_http(http, "/sql", query=query):
        assert said(schema) == expected, (name, said(schema), expected)
    with adbc_driver_flightsql.dbapi.connect(f"grpc://{http}", autocommit=True) as flight:
        with flight.cursor() as cursor:
            cursor.execute(query)
            schema = cursor.fetch_arrow_table().schema
            assert said(schema) == expected, (said(schema), expected)
        assert flight.adbc_get_table_schema("lanes").field("length_m").metadata == metre
    for name, schema in by_http(http, "/layers/lanes"):
        table, columns = said(schema)
        assert columns["length_m"] == metre, (name, columns)
        # Whose rows a file has is for maps.
        assert not [key for key in table if key.startswith(b"evermap.")], (name, table)


main(*sys.argv[1:])
