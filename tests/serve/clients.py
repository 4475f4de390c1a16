"""Asks a served map what `evermap sql` was asked, by psycopg, ADBC, HTTP and JDBC, and compares the answers.

    clients.py HTTP POSTGRES EXPECTED.json [JDBC.jar]

EXPECTED is a list of [query, rows]; rows are objects, as `--format json` prints them. The last is the driver of JDBC.
"""

import datetime
import io
import json
import math
import re
import subprocess
import sys
import urllib.error
import urllib.parse
import urllib.request
from pathlib import Path

import adbc_driver_flightsql.dbapi
import psycopg
import pyarrow
import pyarrow.parquet
import shapely
from psycopg.types import TypeInfo


INSTANT = re.compile(r"^(\d{4}-\d\d-\d\d)[T ](\d\d:\d\d:\d\d)(\.\d+)?(Z|\+00:00)$")


def instant(text):
    """An instant to the microsecond, which is as much as Postgres has."""
    day, time, fraction, _ = INSTANT.match(text).groups()
    return f"{day}T{time}{(fraction or '.')[:7]:0<7}"


def plain(value):
    """A value as JSON has it."""
    if isinstance(value, datetime.datetime):
        value = value.isoformat()
    if isinstance(value, (bytes, bytearray, memoryview)):
        return bytes(value).hex()
    if isinstance(value, dict):
        return {key: plain(inner) for key, inner in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(inner) for inner in value]
    if isinstance(value, bool) or value is None or isinstance(value, (int, float)):
        return value
    if isinstance(value, str) and INSTANT.match(value):
        return instant(value)
    if isinstance(value, str) and value[:1] in ("{", "["):
        try:
            return plain(json.loads(value))
        except ValueError:
            return value
    return str(value) if not hasattr(value, "__float__") else float(value)


def same(found, expected):
    if isinstance(found, (int, float)) and isinstance(expected, (int, float)):
        return math.isclose(found, expected, rel_tol=1e-12, abs_tol=1e-12)
    if isinstance(found, list) and isinstance(expected, list):
        return len(found) == len(expected) and all(map(same, found, expected))
    if isinstance(found, dict) and isinstance(expected, dict):
        return found.keys() == expected.keys() and all(
            same(found[key], expected[key]) for key in found
        )
    return found == expected


def as_stored(geometry):
    """A geometry as maps have it, from what PostGIS has."""
    if geometry is None:
        return None
    return shapely.to_wkb(shapely.from_wkb(geometry), hex=True, flavor="iso").lower()


def by_postgres(connection, geometry, query, binary):
    with connection.cursor(binary=binary) as cursor:
        cursor.execute(query)
        names = [column.name for column in cursor.description]
        forms = [as_stored if column.type_code == geometry else plain for column in cursor.description]
        return [
            {name: form(value) for name, form, value in zip(names, forms, row)} for row in cursor.fetchall()
        ]


def by_jdbc(jar, postgres, queries, more):
    """All answers, and what the driver tells of a table: its key, its indexes, its columns."""
    program = Path(__file__).parent / "Jdbc.java"
    url = f"jdbc:postgresql://{postgres}/map?{more}"
    ran = subprocess.run(
        ["java", "-cp", jar, program, url], input="\0".join(queries).encode(), capture_output=True
    )
    if ran.returncode:
        sys.exit(f"JDBC: {ran.stderr.decode()}")
    answers = []
    for line in ran.stdout.decode().splitlines():
        answer = json.loads(line)
        if "error" in answer:
            answers.append(answer["error"])
            continue
        forms = [as_stored if kind == "geometry" else plain for kind in answer["types"]]
        answers.append(
            [
                {name: form(value) for name, form, value in zip(answer["names"], forms, row)}
                for row in answer["rows"]
            ]
        )
    return answers[:-3], answers[-3:]


def in_microseconds(kind):
    """A type whose instants Python has."""
    if pyarrow.types.is_timestamp(kind):
        return pyarrow.timestamp("us", kind.tz)
    if pyarrow.types.is_list(kind):
        return pyarrow.list_(in_microseconds(kind.value_type))
    if pyarrow.types.is_struct(kind):
        return pyarrow.struct([(field.name, in_microseconds(field.type)) for field in kind])
    return kind


def by_adbc(connection, query):
    with connection.cursor() as cursor:
        cursor.execute(query)
        table = cursor.fetch_arrow_table()
    fields = [(field.name, in_microseconds(field.type)) for field in table.schema]
    return table.cast(pyarrow.schema(fields), safe=False).to_pylist()


def by_http(address, query):
    asked = f"http://{address}/sql?" + urllib.parse.urlencode({"query": query})
    with urllib.request.urlopen(asked) as answer:
        return json.load(answer)


def large(http):
    """What is too large for memory comes as Parquet, and is refused as JSON with what to do."""
    query = "SELECT value FROM generate_series(1, 9000000)"
    address = f"http://{http}/sql?" + urllib.parse.urlencode({"query": query, "format": "parquet"})
    with urllib.request.urlopen(address) as answer:
        expected, parquet = int(answer.headers["Content-Length"]), answer.read()
    assert len(parquet) == expected
    assert pyarrow.parquet.read_metadata(io.BytesIO(parquet)).num_rows == 9_000_000
    try:
        by_http(http, query)
    except urllib.error.HTTPError as error:
        said = error.read().decode()
        assert "larger than 64 MiB" in said and "format=parquet" in said, said
    else:
        sys.exit("72 MB were sent as JSON")


def kept(http):
    """A layer that has not changed is not sent again."""
    def asked(form, **headers):
        request = urllib.request.Request(f"http://{http}/layers/lanes?format={form}", headers=headers)
        try:
            with urllib.request.urlopen(request) as answer:
                return answer.status, answer.headers["ETag"], len(answer.read())
        except urllib.error.HTTPError as error:
            return error.code, error.headers["ETag"], len(error.read())

    status, tag, sent = asked("parquet")
    assert status == 200 and tag and sent > 0, (status, tag, sent)
    assert asked("parquet", **{"If-None-Match": tag}) == (304, tag, 0)
    status, other, sent = asked("json", **{"If-None-Match": tag})
    assert status == 200 and other != tag and sent > 0, (status, other, sent)


def main(http, postgres, expected, jar=None):
    host, port = postgres.split(":")
    pg = psycopg.connect(host=host, port=port, dbname="map", user="me", autocommit=True)
    geometry = TypeInfo.fetch(pg, "geometry").oid
    adbc = adbc_driver_flightsql.dbapi.connect(f"grpc://{http}", autocommit=True)
    wrong = 0
    asked = json.load(open(expected))
    jdbc = {}
    for name, more in [("JDBC", ""), ("JDBC, binary", "prepareThreshold=-1")] if jar else []:
        jdbc[name], (key, indexes, columns) = by_jdbc(jar, postgres, [query for query, _ in asked], more)
        if [(row["column_name"], row["key_seq"]) for row in key] != [("site", 1), ("lane", 2)]:
            wrong += 1
            print(f"{name} tells the key {key!r:.400}")
        if [row["INDEX_NAME"] for row in indexes] != ["lanes_pkey", "lanes_pkey"]:
            wrong += 1
            print(f"{name} tells the indexes {indexes!r:.400}")
        kinds = {column["COLUMN_NAME"]: column["TYPE_NAME"] for column in columns}
        if (kinds.get("geometry"), kinds.get("length_m")) != ("geometry", "float8"):
            wrong += 1
            print(f"{name} tells the columns {columns!r:.400}")
    for number, (query, rows) in enumerate(asked):
        rows = plain(rows)
        for name, ask in [
            *((name, lambda answers=answers: answers[number]) for name, answers in jdbc.items()),
            ("psycopg", lambda: by_postgres(pg, geometry, query, False)),
            ("psycopg, binary", lambda: by_postgres(pg, geometry, query, True)),
            ("ADBC", lambda: by_adbc(adbc, query)),
            ("HTTP", lambda: by_http(http, query)),
        ]:
            try:
                found = plain(ask())
            except Exception as error:  # what a driver raises differs
                found = f"{type(error).__name__}: {error}"
            if not same(found, rows):
                wrong += 1
                print(f"{name}: {query}\n  expected {rows!r:.400}\n  found    {found!r:.400}")
    tables = adbc.adbc_get_objects(depth="tables").read_all().to_pylist()
    names = [
        table["table_name"]
        for catalog in tables
        for schema in catalog["catalog_db_schemas"]
        for table in schema["db_schema_tables"]
    ]
    if "poses" not in names or "lanes" not in names:
        wrong += 1
        print(f"ADBC lists the tables {names}")
    large(http)
    kept(http)
    print(f"{len(asked)} queries, {wrong} wrong answers")
    sys.exit(wrong > 0)


main(*sys.argv[1:])
