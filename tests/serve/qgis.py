"""Asks a served map what QGIS 3.22 asks to list layers and to draw one: qgis.py POSTGRES

The statements were recorded from QGIS' own provider (qgis.core, data source "postgres"), and go as it sends them."""

import sys
from pathlib import Path

import psycopg
from psycopg.pq import ExecStatus

LINE_STRING_WITH_HEIGHTS = bytes([1]) + (1002).to_bytes(4, "little")


def main(postgres):
    host, port = postgres.split(":")
    client = psycopg.connect(host=host, port=port, dbname="map", user="me", autocommit=True)
    rows = lambda query: client.execute(query).fetchall()
    lanes = rows("SELECT site, lane, st_npoints(geometry) FROM lanes")

    def ask(statement):
        answer = client.pgconn.exec_(statement.encode())
        assert answer.status in (ExecStatus.TUPLES_OK, ExecStatus.COMMAND_OK), (statement, answer.error_message)
        cells = range(answer.ntuples), range(answer.nfields)
        return [[answer.get_value(row, column) for column in cells[1]] for row in cells[0]]

    statements = Path(__file__).with_suffix(".sql").read_text().split(";\n\n")
    answers = {statement.split("\n")[0]: ask(statement.split("\n", 1)[1]) for statement in statements}
    listed = {row[0]: row[2] for row in answers["-- layers"]}
    assert listed[b"lanes"] == b"geometry" and listed[b"intersections"] == b"geometry", listed
    # Lines, of no reference system, with heights.
    assert answers["-- geometries"] == [[b"0", b"{0:LINESTRING:2}"]], answers["-- geometries"]
    (key,) = answers["-- key"][0]
    columns = ask(
        f"SELECT attname,attnotnull FROM pg_index,pg_attribute WHERE indexrelid={key.decode()} "
        "AND indrelid=attrelid AND pg_attribute.attnum=any(pg_index.indkey)"
    )
    assert sorted(name for name, _ in columns) == [b"lane", b"site"], columns
    assert answers["-- extent"][0][0].startswith(b"BOX("), answers["-- extent"]

    # Rows, of which each has its place as well-known binary, and all else as text or in binary.
    columns = "st_asbinary(\"geometry\",'NDR'),\"site\"::text,\"lane\",array_out(\"next_lanes\")::text,\"sources\"::text"
    here = " WHERE \"geometry\" && st_makeenvelope(-1e4,-1e4,1e4,1e4,0)"
    (first_site, first_lane, _) = lanes[0]
    picked = f" WHERE (\"site\"::text='{first_site}' AND \"lane\"={first_lane})"
    for condition, expected in ((here, len(lanes)), (picked, 1)):
        ask(f'BEGIN READ ONLY;DECLARE qgis_1 BINARY CURSOR FOR SELECT {columns} FROM "public"."lanes"{condition}')
        found = ask("FETCH FORWARD 2000 FROM qgis_1")
        ask("CLOSE qgis_1;COMMIT")
        assert len(found) == expected, (condition, len(found))
        for place, site, lane, following, sources in found:
            points = next(number for of, name, number in lanes if (of.encode(), name) == (site, int.from_bytes(lane, "big")))
            assert place[:5] == LINE_STRING_WITH_HEIGHTS and len(place) == 9 + 24 * points
            assert following.startswith(b"{") and sources.startswith(b"[{")


main(*sys.argv[1:])
