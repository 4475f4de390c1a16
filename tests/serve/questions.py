"""What Grafana and Metabase ask of a database before they show its tables: questions.py POSTGRES

Their questions as they write them (Grafana 11, Metabase 0.50), and what a map must answer.
"""

import datetime
import sys

import psycopg

# Whether a schema is in the search path.
IN_PATH = """quote_ident(table_schema) IN (
          SELECT
            CASE WHEN trim(s[i]) = '"$user"' THEN user ELSE trim(s[i]) END
          FROM
            generate_series(
              array_lower(string_to_array(current_setting('search_path'),','),1),
              array_upper(string_to_array(current_setting('search_path'),','),1)
            ) as i,
            string_to_array(current_setting('search_path'),',') s
          )"""

GRAFANA_TABLES = f"""SELECT
    CASE WHEN {IN_PATH}
      THEN quote_ident(table_name)
      ELSE quote_ident(table_schema) || '.' || quote_ident(table_name)
    END AS "table"
    FROM information_schema.tables
    WHERE quote_ident(table_schema) NOT IN ('information_schema', 'pg_catalog', '_timescaledb_cache',
      '_timescaledb_catalog', '_timescaledb_internal', '_timescaledb_config', 'timescaledb_information',
      'timescaledb_experimental')
    ORDER BY CASE WHEN {IN_PATH} THEN 0 ELSE 1 END, 1"""

GRAFANA_COLUMNS = """select quote_ident(column_name) as "column", data_type as "type"
from information_schema.columns where quote_ident(table_name) = 'lanes'"""

METABASE_TABLES = """SELECT n.nspname AS schema, c.relname AS name,
  CASE c.relkind WHEN 'r' THEN 'TABLE' WHEN 'v' THEN 'VIEW' WHEN 'm' THEN 'MATERIALIZED VIEW' ELSE NULL END AS type,
  d.description AS description, stat.n_live_tup AS estimated_row_count
FROM pg_catalog.pg_class AS c INNER JOIN pg_catalog.pg_namespace AS n ON c.relnamespace = n.oid
  LEFT JOIN pg_catalog.pg_description AS d
    ON (c.oid = d.objoid) AND (d.objsubid = 0) AND (d.classoid = CAST('pg_class' AS REGCLASS))
  LEFT JOIN pg_stat_user_tables AS stat ON (n.nspname = stat.schemaname) AND (c.relname = stat.relname)
WHERE (c.relnamespace = n.oid) AND (n.nspname !~ '^pg_') AND (n.nspname <> 'information_schema')
  AND (c.relkind in ('r', 'p', 'v', 'f', 'm')) AND (n.nspname IN ('public'))
ORDER BY type ASC, schema ASC, name ASC"""

METABASE_FIELDS = """SELECT c.column_name AS name,
  CASE WHEN c.udt_schema IN ('public', 'pg_catalog') THEN FORMAT('%s', c.udt_name)
    ELSE FORMAT('"%s"."%s"', c.udt_schema, c.udt_name) END AS "database-type",
  c.ordinal_position - 1 AS "database-position", c.table_schema AS "table-schema", c.table_name AS "table-name",
  pk.column_name IS NOT NULL AS "pk?",
  COL_DESCRIPTION(CAST(CAST(FORMAT('%I.%I', CAST(c.table_schema AS TEXT), CAST(c.table_name AS TEXT)) AS REGCLASS) AS OID),
    c.ordinal_position) AS "field-comment",
  ((column_default IS NULL) OR (LOWER(column_default) = 'null')) AND (is_nullable = 'NO')
    AND NOT (((column_default IS NOT NULL) AND (column_default LIKE '%nextval(%')) OR (is_identity <> 'NO'))
    AS "database-required",
  ((column_default IS NOT NULL) AND (column_default LIKE '%nextval(%')) OR (is_identity <> 'NO')
    AS "database-is-auto-increment"
FROM information_schema.columns AS c LEFT JOIN (
  SELECT tc.table_schema, tc.table_name, kc.column_name
  FROM information_schema.table_constraints AS tc INNER JOIN information_schema.key_column_usage AS kc
    ON (tc.constraint_name = kc.constraint_name) AND (tc.table_schema = kc.table_schema)
      AND (tc.table_name = kc.table_name)
  WHERE tc.constraint_type = 'PRIMARY KEY') AS pk
  ON (c.table_schema = pk.table_schema) AND (c.table_name = pk.table_name) AND (c.column_name = pk.column_name)
WHERE c.table_schema !~ '^information_schema|catalog_history|pg_' AND (c.table_schema IN ('public'))
UNION ALL
SELECT pa.attname AS name, FORMAT_TYPE(pa.atttypid, pa.atttypmod) AS "database-type",
  pa.attnum - 1 AS "database-position", pn.nspname AS "table-schema", pc.relname AS "table-name", FALSE AS "pk?",
  NULL AS "field-comment", FALSE AS "database-required", FALSE AS "database-is-auto-increment"
FROM pg_catalog.pg_class AS pc INNER JOIN pg_catalog.pg_namespace AS pn ON pn.oid = pc.relnamespace
  INNER JOIN pg_catalog.pg_attribute AS pa ON pa.attrelid = pc.oid
WHERE pc.relkind = 'm' AND pa.attnum >= 1 AND pn.nspname IN ('public')
ORDER BY "table-schema" ASC, "table-name" ASC, "database-position" ASC"""

# No key of a map refers to another table.
METABASE_REFERENCES = """SELECT fk_ns.nspname AS "fk-table-schema", fk_table.relname AS "fk-table-name",
  fk_column.attname AS "fk-column-name", pk_table.relname AS "pk-table-name", pk_column.attname AS "pk-column-name"
FROM pg_constraint AS c INNER JOIN pg_class AS fk_table ON c.conrelid = fk_table.oid
  INNER JOIN pg_namespace AS fk_ns ON c.connamespace = fk_ns.oid
  INNER JOIN pg_attribute AS fk_column ON c.conrelid = fk_column.attrelid
  INNER JOIN pg_class AS pk_table ON c.confrelid = pk_table.oid
  INNER JOIN pg_attribute AS pk_column ON c.confrelid = pk_column.attrelid
WHERE fk_ns.nspname !~ '^information_schema|catalog_history|pg_' AND c.contype = 'f'::char
  AND fk_column.attnum = ANY(c.conkey) AND pk_column.attnum = ANY(c.confkey)"""

# As DBeaver asks for the key of a table.
KEYS = """SELECT c.conname, c.contype, a.attname FROM pg_catalog.pg_constraint c
  JOIN pg_catalog.pg_class t ON t.oid = c.conrelid
  JOIN pg_catalog.pg_attribute a ON a.attrelid = t.oid AND a.attnum = ANY(c.conkey)
WHERE t.relname = 'lanes' ORDER BY a.attnum"""


def main(postgres):
    host, port = postgres.split(":")
    client = psycopg.connect(host=host, port=port, dbname="map", user="me", autocommit=True)

    def ask(query):
        return client.execute(query).fetchall()

    tables = [name for (name,) in ask(GRAFANA_TABLES)]
    assert "lanes" in tables and "poses" in tables, tables
    assert ("length_m", "double precision") in ask(GRAFANA_COLUMNS)
    found = [name for (_, name, kind, *_) in ask(METABASE_TABLES) if kind == "TABLE"]
    assert "lanes" in found and "lanes_pkey" not in found, found
    fields = [row for row in ask(METABASE_FIELDS) if row[4] == "lanes"]
    assert [row[2] for row in fields] == list(range(len(fields))), fields
    assert {row[0] for row in fields if row[5]} == {"site", "lane"}, fields
    assert ("length_m", "float8") in [row[:2] for row in fields], fields
    assert ask(METABASE_REFERENCES) == []
    assert ask(KEYS) == [("lanes_pkey", "p", "site"), ("lanes_pkey", "p", "lane")]
    # Instants are in UTC, whatever zone a client names.
    for said in ["SET TIME ZONE 'Europe/Berlin'", "SET timezone TO 'Europe/Berlin'"]:
        client.execute(said)
        for asked in ["SHOW timezone", "SHOW TIME ZONE", "SELECT current_setting('TimeZone')"]:
            assert ask(asked) == [("UTC",)], (said, asked)
    noon = datetime.datetime(2026, 1, 1, 12, tzinfo=datetime.timezone.utc)
    for asked, values in [("SELECT now()", []), ("SELECT %s::timestamptz", [noon])]:
        answer = client.execute(asked, values)
        assert answer.description[0].type_code == psycopg.adapters.types["timestamptz"].oid, asked
        (instant,) = answer.fetchone()
        assert instant.utcoffset() == datetime.timedelta(0), (asked, instant)
        assert not values or instant == noon, (asked, instant)
    # A member of a nested column, as Postgres has it.
    ((x, y),) = ask("SELECT (map_from_vehicle).x, (p.map_from_vehicle).y FROM poses p ORDER BY stamp LIMIT 1")
    assert isinstance(x, float) and isinstance(y, float)
    # What would answer of other rows than are asked for is refused.
    client.execute('SET search_path = "$user", public')
    try:
        client.execute("SET search_path TO v1")
    except psycopg.errors.FeatureNotSupported as error:
        assert "v1.lanes" in str(error), error
    else:
        sys.exit("search_path is passed over")


main(*sys.argv[1:])
