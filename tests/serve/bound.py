"""Binds values to the parameters of queries, as programs do, and compares with literals in their place: bound.py POSTGRES"""

import datetime
import sys
import uuid
from decimal import Decimal

import pandas
import psycopg
import sqlalchemy

ID = uuid.UUID("0193f0a1-7e2b-7c3d-8e4f-5a6b7c8d9e0f")

# What stands in a query in place of values, and the values; each answer is as Postgres has it.
SAME = [
    ("SELECT %s + %s", [1, 2], 3),
    ("SELECT %s", [1], 1),
    ("SELECT %s", ["x"], "x"),
    ("SELECT %s", ["{x}"], "{x}"),
    ("SELECT %s", [1.5], 1.5),
    ("SELECT %s", [True], True),
    ("SELECT %s", [datetime.date(2026, 7, 1)], datetime.date(2026, 7, 1)),
    ("SELECT %s IS NULL", [None], True),
    ("SELECT 1 WHERE %s IS NULL", [None], 1),
    ("SELECT CASE WHEN %s IS NULL THEN %s END", [None, "later"], "later"),
    ("SELECT 'my lot' = ANY(%s)", [["my lot", "lot"]], True),
    ("SELECT 'a, {b} \"c\"' = ANY(%s)", [["x", 'a, {b} "c"']], True),
    ("SELECT '' = ANY(%s)", [[]], False),
    ("SELECT '' = ANY(%s)", [[""]], True),
    ("SELECT coalesce('NULL' = ANY(%s), false)", [[None, "z"]], False),
    ("SELECT CAST(9007199254740992 AS BIGINT) = %s", [Decimal(9007199254740993)], False),
    ("SELECT CAST(9007199254740992 AS BIGINT) = %b", [Decimal(9007199254740992)], True),
    ("SELECT 2 = ANY(%s)", [[Decimal("2.5"), Decimal("1")]], False),
    ("SELECT 2 = ANY(%b)", [[Decimal("2.5"), Decimal("2")]], True),
    ("SELECT %s", [ID], str(ID)),
    ("SELECT %b", [ID], str(ID)),
    ("SELECT %s", [[ID, None]], [str(ID), None]),
    ("SELECT %b", [[ID, None]], [str(ID), None]),
    ("SELECT %s::uuid", [ID], str(ID)),
    ("SELECT %s::uuid", [ID.hex.upper()], str(ID)),
    ("SELECT %s::uuid[]", [[ID, None]], [str(ID), None]),
    ("SELECT %s::uuid[]", [[ID.hex, None]], [str(ID), None]),
    (f"SELECT CAST('{ID.hex}' AS uuid) = %s", [ID], True),
    ("SELECT %s::jsonb", ['{"a": 1}'], '{"a": 1}'),
    ("SELECT %s::json", ["[1]"], "[1]"),
    ("SELECT %s::name", ["lanes"], "lanes"),
    (f"SELECT '{ID}' = %s", [ID], True),
    (f"SELECT '{ID}' = ANY(%s)", [[ID]], True),
    ("SELECT count(*) FROM (SELECT 1 FROM lanes LIMIT %s OFFSET %s) AS few", [1, 0], 1),
]

# Lists that are written as texts in a query, and answers as Postgres has them.
LISTS = [
    (r"""SELECT 'a, b' = ANY('{"a, b"}')""", True),
    (r"""SELECT 'a' = ANY('{"a, b"}')""", False),
    (r"""SELECT 'a "b" \' = SOME('{x,"a \"b\" \\"}')""", True),
    (r"""SELECT 'b' <> ALL('{"a, b",c}')""", True),
    (r"""SELECT '{"a, b",NULL,"NULL",it''s}'::text[]""", ["a, b", None, "NULL", "it's"]),
    (r"""SELECT CAST('{"a, b",c}' AS TEXT[])""", ["a, b", "c"]),
    (r"""SELECT '{1,NULL}'::int[]""", [1, None]),
]

# Conditions on lanes with a value, and the same with a literal.
LANES = [
    ("lane > %s", 1.5, "lane > 1.5"),
    ("lane > %s", -1, "true"),
    ("lane > %s", 2**40, "false"),
    ("lane = %s", Decimal("1.5"), "false"),
    ("lane = %b", Decimal("1.5"), "false"),
    ("lane = %s", Decimal("1"), "lane = 1"),
    ("lane = %s", Decimal("1.000"), "lane = 1"),
    ("lane = ANY(%s)", [], "false"),
    ("lane = ANY(%s)", [1, 2], "lane IN (1, 2)"),
    ("lane = ANY(%s)", [Decimal("1.5"), Decimal("2")], "lane = 2"),
    ("lane = ANY(%s)", [-1, 2**40], "false"),
    ("length_m > %s", 10, "length_m > 10"),
    ("length_m > %s", Decimal("10.25"), "length_m > 10.25"),
    ("site = %s", "nowhere", "false"),
    ("site = %s", None, "false"),
]


def refused(ask, expected):
    try:
        found = ask()
    except psycopg.Error as error:
        assert expected in str(error), error
    else:
        raise AssertionError(f"{expected}: {found}")


def main(postgres):
    host, port = postgres.split(":")
    client = psycopg.connect(host=host, port=port, dbname="map", user="me", autocommit=True)

    def ask(query, values=None, binary=False, prepare=None):
        with client.cursor(binary=binary) as cursor:
            return cursor.execute(query, values, prepare=prepare).fetchall()

    for binary in (False, True):
        for query, values, expected in SAME:
            found = ask(query, values, binary)
            assert found == [(expected,)] and type(found[0][0]) is type(expected), (query, values, found)
        for condition, value, literal in LANES:
            query = "SELECT site, lane FROM lanes WHERE {} ORDER BY site, lane"
            found = ask(query.format(condition), [value], binary, True)
            assert found == ask(query.format(literal)), (condition, value, found)
    for prepare in (False, True):
        for query, expected in LISTS:
            found = ask(query, prepare=prepare)
            assert found == [(expected,)], (query, found)
        refused(lambda: ask("SELECT '7'::uuid", prepare=prepare), "expected a value of the type uuid, found `7`")
        refused(lambda: ask("SELECT 1 = ANY('{{1},{2}}')", prepare=prepare), "expected a list such as {1,2}, found `{{1},{2}}`")
    lanes = ask("SELECT site, lane FROM lanes ORDER BY site, lane")
    assert lanes and {site for site, _ in lanes} != {None}
    site = lanes[0][0]
    of_site = "SELECT site, lane FROM lanes WHERE (%s IS NULL OR site = %s) ORDER BY site, lane"
    assert ask(of_site, [None, None]) == lanes
    assert ask(of_site, [site, site]) == [lane for lane in lanes if lane[0] == site]
    assert ask(of_site, ["nowhere", "nowhere"]) == []
    half, passes = ask("SELECT sum(forward_passes * %s), sum(forward_passes) FROM lanes", [Decimal("0.5")])[0]
    assert float(half) == float(passes) / 2, (half, passes)

    # An integer is no instant, as it is none where it is written.
    for value in (5, 10**10, 2**62):
        refused(lambda: ask("SELECT 1 FROM poses WHERE stamp < %s", [value]), "expected two values that go together, found time")
    ((first, last),) = ask("SELECT min(stamp), max(stamp) FROM poses")
    ((poses,),) = ask("SELECT count(*) FROM poses")
    assert ask("SELECT count(*) FROM poses WHERE stamp >= %s", [first]) == [(poses,)]
    assert ask("SELECT count(*) FROM poses WHERE stamp >= %s", [str(first)]) == [(poses,)]
    assert ask("SELECT count(*) FROM poses WHERE stamp > %s + %s", [last, datetime.timedelta(seconds=1)]) == [(0,)]
    early = datetime.datetime(1500, 1, 1, tzinfo=datetime.timezone.utc)
    refused(lambda: ask("SELECT 1 FROM poses WHERE stamp > %s", [early]), "found one beyond it")

    # What says no type at all, as texts.
    bare = client.pgconn
    for query, given, expected in [
        (b"SELECT 1 FROM poses WHERE stamp < $1", [b"5"], "found `5`"),
        (b"SELECT 1 FROM lanes WHERE lane = $1", [b"1.5"], "found `1.5`"),
        (b"SELECT 1 FROM lanes WHERE lane = ANY($1)", [b"{1,{2}}"], "expected a list such as {1,2}"),
        (b"SELECT $2", [b"1"], "expected 2 parameters, found 1"),
    ]:
        said = bare.exec_params(query, given).error_message.decode()
        assert expected in said, (query, said)
    bare.prepare(b"told", b"SELECT 1 FROM lanes WHERE site = $3 AND lane = ANY($1)")
    told = bare.describe_prepared(b"told")
    assert [told.param_type(number) for number in range(told.nparams)] == [1016, 705, 25]

    # By cursors of the server's.
    query = "SELECT lane, geometry, sources FROM lanes WHERE lane >= %s AND site = ANY(%s) AND %s IS NULL ORDER BY site, lane"
    values = [0, [site, "my lot"], None]
    whole = {binary: ask(query, values, binary) for binary in (False, True)}
    assert whole[False]
    with psycopg.connect(host=host, port=port, dbname="map", user="me") as transaction:
        for binary in (False, True):
            with transaction.cursor(name="mine", binary=binary) as cursor:
                cursor.execute(query, values)
                assert cursor.fetchmany(1) + cursor.fetchall() == whole[binary]
    engine = sqlalchemy.create_engine(f"postgresql+psycopg://me@{postgres}/map")
    with engine.connect() as connection:
        literals = sqlalchemy.select(sqlalchemy.literal(1), sqlalchemy.literal("x"), sqlalchemy.literal(1.5))
        assert connection.execute(literals).fetchall() == [(1, "x", 1.5)]
        asked = sqlalchemy.text("SELECT site, lane FROM lanes WHERE lane >= :least ORDER BY site, lane")
        streamed = connection.execution_options(stream_results=True).execute(asked, {"least": 0})
        assert [tuple(row) for row in streamed] == lanes
        parts = list(pandas.read_sql(asked, connection, params={"least": 0}, chunksize=1))
        assert len(pandas.concat(parts)) == len(lanes)


main(*sys.argv[1:])
