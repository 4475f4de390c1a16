"""Reads the geometries of a served map as programs that know PostGIS do: postgis.py POSTGRES"""

import sys
import warnings

import geopandas
import pandas
import psycopg
import shapely
import sqlalchemy
from psycopg.types import TypeInfo
from psycopg.types.shapely import register_shapely


def main(postgres):
    host, port = postgres.split(":")
    client = psycopg.connect(host=host, port=port, dbname="map", user="me", autocommit=True)
    info = TypeInfo.fetch(client, "geometry")
    assert info and info.name == "geometry", info
    query = "SELECT lane, geometry, geometry AS shape, st_length(geometry) AS metres FROM lanes ORDER BY lane"
    for binary in (False, True):
        with client.cursor(binary=binary) as cursor:
            rows = cursor.execute(query).fetchall()
            types = [column.type_code for column in cursor.description]
            assert types[1] == types[2] == info.oid and info.oid not in (types[0], types[3]), types
            assert rows
            # A polyline with heights, as PostGIS marks it.
            value = rows[0][1] if binary else bytes.fromhex(rows[0][1])
            assert value[:5] == b"\1\2\0\0\x80", value[:5]
    # What is prepared, described and bound says the same.
    with client.cursor() as cursor:
        cursor.execute(query + " LIMIT %s", [1], prepare=True)
        assert cursor.description[1].type_code == info.oid
    # What functions make is a geometry, and what they take may be as PostGIS writes it.
    made = client.execute("SELECT st_point(1, 2, 3) AS made ORDER BY 1 LIMIT 1")
    assert made.description[0].type_code == info.oid
    (text,) = made.fetchone()
    assert shapely.from_wkb(text) == shapely.Point(1, 2, 3)
    # Also beside what is nested, and under a name from within.
    for nested in ["SELECT st_point(1, 2), [[1]]", "SELECT g, [[1]] FROM (SELECT st_point(1, 2) AS g) AS t"]:
        assert client.execute(nested).description[0].type_code == info.oid, nested
    ewkb = shapely.to_wkb(shapely.Point(4, 6, 0), include_srid=True)
    (far,) = client.execute("SELECT st_distance(st_point(1, 2), %b)", [ewkb]).fetchone()
    assert abs(far - 5) < 1e-9, far
    # Null stays null, bytes of another name stay bytes.
    nothing = client.execute("SELECT CASE WHEN false THEN geometry END AS geometry, geometry IS NULL AS gone FROM lanes LIMIT 1")
    assert nothing.fetchone() == (None, False)

    register_shapely(info, client)
    for binary in (False, True):
        with client.cursor(binary=binary) as cursor:
            for _, line, _, metres in cursor.execute(query):
                steps = shapely.get_coordinates(line, include_z=True)
                assert line.has_z and abs(((steps[1:] - steps[:-1]) ** 2).sum(1) ** 0.5).sum() - metres < 1e-6

    engine = sqlalchemy.create_engine(f"postgresql+psycopg://me@{postgres}/map", isolation_level="AUTOCOMMIT")
    # What it knows of a table before it reads it: names, types, and that there is nothing to know of the rest.
    inspector = sqlalchemy.inspect(engine)
    assert "public" in inspector.get_schema_names()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Did not recognize type 'geometry'")
        columns = {column["name"]: str(column["type"]) for column in inspector.get_columns("lanes")}
        assert columns["length_m"] == "DOUBLE PRECISION" and columns["lane"] == "BIGINT", columns
        table = sqlalchemy.Table("lanes", sqlalchemy.MetaData(), autoload_with=engine)
        assert table.primary_key.name == "lanes_pkey" and table.primary_key.columns.keys() == ["site", "lane"], table.primary_key
        assert len(pandas.read_sql_table("lanes", engine)) == len(client.execute("SELECT 1 FROM lanes").fetchall())
    # What drivers and dashboards ask first, and pools when they are given a connection back.
    for question, answer in [
        ("SELECT current_setting('server_version_num')::int / 100", 1600),
        ("SELECT setting FROM pg_catalog.pg_settings WHERE name = 'max_index_keys'", "32"),
        ("SELECT (SELECT c.relkind = 'c' FROM pg_class c WHERE c.oid = t.typrelid) FROM pg_type t LIMIT 1", None),
    ]:
        assert client.execute(question).fetchone() == (answer,), question
    for said in ["UNLISTEN *", "RESET ALL", "SET ROLE none", "SET SESSION AUTHORIZATION DEFAULT"]:
        client.execute(said)
    # The columns of a key are rows, counted from 0 as Postgres does.
    key = """SELECT unnest(indkey), generate_subscripts(indkey, 1), unnest(indclass) IS NULL FROM pg_catalog.pg_index
        WHERE indrelid = (SELECT oid FROM pg_catalog.pg_class WHERE relname = 'lanes')"""
    assert client.execute(key).fetchall() == [(1, 0, False), (2, 1, False)]
    for wrong, number in [
        ("SELECT 1 FROM nowhere", "42P01"),
        ("SELECT nothing FROM lanes", "42703"),
        ("SELEC 1", "42601"),
        ("SELECT 'abc", "42601"),
        ("DECLARE mine CURSOR FOR SELEC 1", "42601"),
        ("SELECT 1 / (value - 1) FROM generate_series(1, 3)", "22012"),
        ("SELECT no_function(i.indkey) AS x FROM pg_index i JOIN pg_description d ON d.objoid = i.indexrelid", "42883"),
    ]:
        # Without values it is asked at once, with them it is prepared first.
        for values in (None, ()):
            try:
                client.execute(wrong, values, prepare=values is not None)
                raise AssertionError(wrong)
            except psycopg.Error as error:
                assert error.sqlstate == number, (wrong, values, error.sqlstate)
    with engine.connect() as connection, warnings.catch_warnings():
        warnings.simplefilter("error")
        lanes = geopandas.read_postgis(query, connection, geom_col="geometry")
        assert len(lanes) == len(rows) and lanes.crs is None
        assert set(lanes.geometry.geom_type) == {"LineString"}
        assert abs(lanes.geometry.length.sum() - sum(row[3] for row in rows)) < 1

    # By a cursor of the server's, as programs read what is large: geometries and nested columns are as elsewhere.
    with psycopg.connect(host=host, port=port, dbname="map", user="me") as transaction:
        register_shapely(info, transaction)
        whole = client.execute("SELECT lane, geometry, sources FROM lanes ORDER BY lane").fetchall()
        for binary in (False, True):
            with transaction.cursor(name="mine", binary=binary) as cursor:
                cursor.execute("SELECT lane, geometry, sources FROM lanes ORDER BY lane")
                found = cursor.fetchmany(1) + cursor.fetchall()
                assert cursor.description[1].type_code == info.oid
            if not binary:
                assert found == whole, (found[:1], whole[:1])
            assert [row[0] for row in found] == [row[0] for row in whole]

        # Rows that were written as text are not said to be binary.
        transaction.execute("DECLARE mine CURSOR FOR SELECT lane, geometry FROM lanes")
        transaction.execute("FETCH 1 FROM mine")
        try:
            transaction.cursor(binary=True).execute("FETCH 1 FROM mine")
            raise AssertionError("fetched in another format")
        except psycopg.errors.FeatureNotSupported as error:
            assert "the format of the rows that were fetched before" in str(error), error
        transaction.rollback()
        # So many at once, and the end of a transaction closes them.
        for _ in range(2):
            for number in range(64):
                transaction.execute(f"DECLARE c{number} CURSOR FOR SELECT * FROM lanes")
            transaction.commit()
        for number in range(64):
            transaction.execute(f"DECLARE c{number} CURSOR FOR SELECT 1")
        try:
            transaction.execute("DECLARE more CURSOR FOR SELECT 1")
            raise AssertionError("65 cursors are open")
        except psycopg.errors.InsufficientResources as error:
            assert "at most 64 open cursors" in str(error), error

    columns = client.execute("SELECT f_table_name, f_geometry_column, srid FROM geometry_columns").fetchall()
    assert ("lanes", "geometry", 0) in columns and ("intersections", "geometry", 0) in columns, columns
    assert client.execute("SELECT * FROM spatial_ref_sys").fetchall() == []
    version = client.execute("SELECT postgis_version()").fetchone()[0]
    assert version.startswith("3."), version
    typed = client.execute(
        "SELECT t.typname, format_type(a.atttypid, a.atttypmod) FROM pg_catalog.pg_attribute a"
        " JOIN pg_catalog.pg_class c ON a.attrelid = c.oid JOIN pg_catalog.pg_type t ON t.oid = a.atttypid"
        " WHERE c.relname = 'lanes' AND a.attname = 'geometry'"
    )
    assert typed.fetchall() == [("geometry", "geometry")]
    typed = client.execute(
        "SELECT column_name, data_type, udt_name FROM information_schema.columns WHERE table_name = 'lanes'"
        " AND column_name IN ('geometry', 'length_m') ORDER BY columns.column_name"
    ).fetchall()
    assert typed == [
        ("geometry", "USER-DEFINED", "geometry"),
        ("length_m", "double precision", "float8"),
    ], typed


main(*sys.argv[1:])
