"""Tries what a server that only reads must refuse.

    attack.py open HTTP POSTGRES        a server that lets everybody in
    attack.py slow HTTP POSTGRES        the same, with one query at a time
    attack.py closed HTTP POSTGRES      one with the user `ada`, password `byron-1815`, and the token `t0ken-t0ken`
    attack.py private HTTP POSTGRES CA  the same with TLS, by a certificate of CA
"""

import http.client as http_client
import json
import re
import socket
import ssl
import struct
import sys
import time
import urllib.error
import urllib.parse
import urllib.request

import adbc_driver_flightsql.dbapi
import psycopg

WRONG = []


def check(right, what):
    if not right:
        WRONG.append(what)


def connect(postgres, **more):
    host, port = postgres.split(":")
    given = {"host": host, "port": port, "dbname": "map", "user": "ada", "autocommit": True}
    return psycopg.connect(**(given | more), connect_timeout=20)


def status(address, headers=None, data=None, scheme="http", context=None):
    request = urllib.request.Request(f"{scheme}://{address}", headers=headers or {}, data=data)
    try:
        with urllib.request.urlopen(request, context=context) as answer:
            return answer.status, answer.read()
    except urllib.error.HTTPError as error:
        return error.code, error.read()


STATEMENTS = [
    "COPY (SELECT 1) TO '/tmp/evermap-attack.csv'",
    "COPY poses TO '/tmp/evermap-attack.parquet' STORED AS PARQUET",
    "COPY poses FROM '/etc/passwd'",
    "COPY poses TO STDOUT",
    "CREATE TABLE mine AS SELECT 1",
    "CREATE EXTERNAL TABLE passwords (line TEXT) STORED AS CSV LOCATION '/etc/passwd'",
    "CREATE VIEW mine AS SELECT 1",
    "CREATE FUNCTION mine(INT) RETURNS INT RETURN $1",
    "SELECT 1 AS a INTO mine",
    "DROP TABLE poses",
    "DROP SCHEMA public CASCADE",
    "INSERT INTO poses SELECT * FROM poses",
    "DELETE FROM poses",
    "UPDATE poses SET session = 'mine'",
    "TRUNCATE poses",
    "ALTER TABLE poses ADD COLUMN mine INT",
    "EXPLAIN ANALYZE INSERT INTO poses SELECT * FROM poses",
    "WITH gone AS (DELETE FROM poses RETURNING *) SELECT * FROM gone",
    "PREPARE mine AS SELECT 1",
    "SET datafusion.runtime.memory_limit = '1T'",
    "SET datafusion.catalog.information_schema = false",
    "DECLARE mine CURSOR FOR DELETE FROM poses",
    "SELECT * FROM '/etc/passwd'",
    "SELECT * FROM read_csv('/etc/passwd')",
    "SELECT pg_read_file('/etc/passwd')",
    "SELECT lo_import('/etc/passwd')",
    "SELECT repeat('a', 2000000000)",
    "SELECT " + " + ".join(["1"] * 20000),
    "SELECT " + "(" * 5000 + "1" + ")" * 5000,
    "VACUUM",
    "LISTEN mine",
    "CALL mine()",
    "LOAD 'mine'",
    "GRANT ALL ON poses TO ada",
    "KILL 1",
]


def refused(postgres):
    """What would write, or read what is not served, by both ways to say it."""
    for statement in STATEMENTS:
        for prepare in [False, True]:
            with connect(postgres) as connection:
                try:
                    if prepare:
                        connection.cursor(binary=True).execute(statement, prepare=True)
                    else:
                        # Without parameters and in one text with another: the simple protocol.
                        connection.pgconn.exec_(b"BEGIN")
                        result = connection.pgconn.exec_(statement.encode())
                        if result.error_message:
                            raise psycopg.Error(result.error_message.decode())
                    check(False, f"not refused: {statement:.80}")
                except psycopg.Error as error:
                    text = str(error)
                    check("panic" not in text and "server closed" not in text, f"{statement:.80}: {text}")
    with connect(postgres) as connection:
        rows = connection.execute("SELECT count(*) FROM poses").fetchone()
        check(rows[0] > 0, "the map lost its poses")
        names = connection.execute("SELECT table_name FROM information_schema.tables").fetchall()
        check("mine" not in [name for (name,) in names], "a table was made")


def bounded(postgres):
    """A query ends when its time, its rows or its client say so, and the next is answered."""
    long = "SELECT count(*) FROM generate_series(1, 3000000) a, generate_series(1, 3000000) b"
    for what in [long, "SELECT * FROM generate_series(1, 1000000)"]:
        with connect(postgres) as connection:
            try:
                connection.execute(what).fetchall()
                check(False, f"not bounded: {what}")
            except psycopg.Error as error:
                check("took longer" in str(error) or "more than" in str(error), str(error))
    with connect(postgres) as connection:
        connection.execute("SET statement_timeout = 0")
        import threading

        threading.Timer(0.3, connection.cancel_safe).start()
        try:
            connection.execute(long).fetchall()
            check(False, "not cancelled")
        except psycopg.Error as error:
            check("cancel" in str(error), f"cancelled: {error}")
        check(connection.execute("SELECT 1").fetchone() == (1,), "no answer after cancelling")


def opened(address):
    """A connection that takes next to nothing of what it is sent."""
    host, port = address.split(":")
    stream = socket.socket()
    stream.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    stream.connect((host, int(port)))
    return stream


def slow(http, postgres):
    """Clients that read nothing leave the only place for a query when their time is over; what they get then is no whole
    answer."""
    long = b"SELECT a.value, b.value FROM generate_series(1, 100) a, generate_series(1, 900) b\0"
    part = said(b"P", b"\0" + long + b"\0\0") + said(b"B", b"\0\0\0\0\0\0\0\0") + said(b"E", b"\0" + struct.pack("!i", 9))
    ways = {
        "a query": (postgres, start(user="me", database="map") + said(b"Q", long)),
        "a part of an answer": (postgres, start(user="me", database="map") + part + said(b"S", b"")),
        "rows by HTTP": (http, b"GET /sql?format=arrow&query=" + quoted(long) + b" HTTP/1.1\r\nHost: localhost\r\n\r\n"),
    }
    for what, (address, message) in ways.items():
        with opened(address) as stream:
            stream.sendall(message)
            # A query waits for a place for 3 s, and the one before has it for 3 s.
            time.sleep(1.5)
            code, _ = status(http + "/sql?query=SELECT%201")
            check(code == 200, f"{what} that nobody reads keeps its place: {code}")


def busy(http):
    """A query that computes without a pause is answered when its time is over, and others beside it."""
    # One row, just short of what is refused.
    query = b"SELECT levenshtein(repeat('a', 95000), repeat('b', 95000)) AS far"
    begun = time.monotonic()
    code, said = status(http + "/sql?query=" + quoted(query).decode())
    check(code == 503 and b"took longer" in said, f"{code} {said[:200]!r}")
    check(time.monotonic() - begun < 15, "a query that computes has no end")
    code, _ = status(http + "/sql?query=SELECT%201")
    check(code == 200, f"beside a query that computes: {code}")


def stranger(http):
    """Who may not come in does not stay, however often it asks."""
    host, port = http.split(":")
    begun = time.monotonic()
    with socket.create_connection((host, int(port)), timeout=10) as stream:
        try:
            while time.monotonic() < begun + 25:
                stream.sendall(b"GET /health HTTP/1.1\r\nHost: localhost\r\n\r\n")
                if not stream.recv(4096):
                    return
                time.sleep(1)
        except OSError:
            return
    check(False, "a connection that may not come in is still open after 25 s")


def quoted(query):
    return urllib.parse.quote(query.rstrip(b"\0")).encode()


HALF_A_HEAD = b"GET /health HTTP/1.1\r\nHost: "
HALF_A_BODY = b"POST /sql HTTP/1.1\r\nHost: localhost\r\nContent-Length: 100000\r\n\r\nSELECT"


def silent(http, postgres, half):
    """Connections that say nothing, or half of something, are closed within seconds and keep nobody out."""
    begun = time.monotonic()
    halves = [opened(postgres) for _ in range(300)] + [opened(http) for _ in range(300)]
    for stream in halves[300:]:
        stream.sendall(half)
    code, _ = status(http + "/health")
    check(code == 200, f"HTTP beside connections that say nothing: {code}")
    with connect(postgres) as connection:
        check(connection.execute("SELECT 1").fetchone() == (1,), "Postgres beside connections that say nothing")
    for stream in halves:
        stream.settimeout(max(0.1, begun + 20 - time.monotonic()))
        try:
            rest = stream.recv(1024)
            check(rest == b"" or b"408" in rest, f"a connection that says nothing got {rest!r}")
        except ConnectionError:
            pass
        except TimeoutError:
            check(False, "a connection that says nothing is still open after 20 s")
            break
        finally:
            stream.close()


def wire(postgres, message):
    """What a server answers to bytes, until it closes or is silent."""
    host, port = postgres.split(":")
    with socket.create_connection((host, int(port)), timeout=5) as stream:
        stream.sendall(message)
        answer = b""
        try:
            while piece := stream.recv(65536):
                answer += piece
        except TimeoutError:
            pass
        return answer


def at_once(postgres, ca, protocol):
    """What a server answers to somebody who begins with TLS, and says to speak this protocol."""
    context = ssl.create_default_context(cafile=ca)
    context.set_alpn_protocols([protocol])
    host, port = postgres.split(":")
    try:
        with socket.create_connection((host, int(port)), timeout=5) as plain:
            with context.wrap_socket(plain, server_hostname="localhost") as private:
                private.sendall(start(user="ada", database="map"))
                return private.recv(1024)
    except OSError:
        return b""


def goes(postgres, free):
    """Who goes in the middle of a query leaves its place; `free` says how many there are."""
    leaving = connect(postgres, password="byron-1815", sslmode="require")
    leaving.pgconn.send_query(b"SELECT count(*) FROM generate_series(1, 1000000) a, generate_series(1, 1000000) b")
    leaving.pgconn.flush()
    time.sleep(1)
    places = [free()]
    # It says that it goes, which nobody reads before its query ends.
    leaving.close()
    begun = time.monotonic()
    while places[-1] != 32 and time.monotonic() < begun + 20:
        time.sleep(0.5)
        places.append(free())
    check(places[0] == 31 and places[-1] == 32, f"places while somebody goes: {places}")


def said(kind, body):
    return kind + struct.pack("!i", len(body) + 4) + body


def start(**parameters):
    body = struct.pack("!i", 196608)
    for name, value in parameters.items():
        body += name.encode() + b"\0" + value.encode() + b"\0"
    return said(b"", body + b"\0")


QUERY = said(b"Q", b"SELECT session FROM poses LIMIT 1\0")


def formats(postgres):
    """A format for each of two columns where there are three, of a query and of a cursor, is an error; the next is answered."""
    sync, end = said(b"S", b""), said(b"X", b"")
    two = struct.pack("!hhhhh", 0, 0, 2, 1, 1)
    cursor = b"DECLARE mine CURSOR FOR SELECT 1, 2, 3\0"
    for query in [b"SELECT 1, 2, 3", b"FETCH 1 FROM mine"]:
        for describe in [b"", said(b"D", b"P\0")]:
            bound = said(b"P", b"\0" + query + b"\0\0\0") + said(b"B", b"\0\0" + two) + describe + said(b"E", b"\0\0\0\0\0")
            answer = wire(postgres, start(user="me", database="map") + said(b"Q", cursor) + bound + sync + QUERY + end)
            check(b"08P01" in answer and b"SELECT 1\0" in answer, f"{query} {describe}: {answer[-300:]!r}")


def malformed(postgres, hello, messages):
    """What is no message is answered with an error of the protocol, and ends the connection."""
    for message in messages:
        begun = time.monotonic()
        answer = wire(postgres, hello + message)
        check(b"08P01" in answer and b"FATAL" in answer, f"{message[:40]!r}: {answer[-200:]!r}")
        check(time.monotonic() - begun < 4, f"{message[:40]!r} does not end its connection")


# Short, long, with texts and lists that do not end, with more than their kind has.
MESSAGES = [
    b"S" + struct.pack("!i", 0),
    b"Q" + struct.pack("!i", -1),
    b"d" + struct.pack("!i", 2**31 - 1) + b"x" * 100,
    said(b"Q", b"SELECT 1"),
    said(b"Q", b"SELECT 1\0SELECT 2\0"),
    said(b"P", b"\0SELECT 1\0"),
    said(b"P", b"\0SELECT 1\0" + struct.pack("!h", 3)),
    said(b"B", b"\0\0"),
    said(b"B", b"\0\0" + struct.pack("!hhi", 0, 1, 1000)),
    said(b"B", b"\0\0" + struct.pack("!hhh", 2, 0, 0)),
    said(b"C", b""),
    said(b"D", b""),
    said(b"E", b"\0"),
    said(b"E", b""),
    said(b"X", b"more"),
    said(b"F", b"\0\0\0\1"),
    b"GET / HTTP/1.1\r\n\r\n",
]

BEGINNINGS = [
    b"\0" * 8,
    b"\0\0\x27\x11" + b"\0" * 100,
    said(b"", b"\0\3\0\0user\0"),
    said(b"", b"\0\3\0\0user\0ada\0"),
    said(b"", b"\0\3\0\0\0more"),
]


def parameters(postgres):
    """An interval that is cut short, bound as bytes, is an error; rows by the billion are no room that is made before one comes;
    the next query is answered."""
    hello, sync, end = start(user="me", database="map"), said(b"S", b""), said(b"X", b"")
    parse = said(b"P", b"\0SELECT CAST($1 AS INTERVAL)\0" + struct.pack("!hi", 1, 1186))
    bind = said(b"B", b"\0\0" + struct.pack("!hhhi", 1, 1, 1, 3) + b"abc" + struct.pack("!h", 0))
    answer = wire(postgres, hello + parse + bind + said(b"E", b"\0\0\0\0\0") + sync + QUERY + end)
    check(b"22P03" in answer and b"SELECT 1\0" in answer, f"an interval: {answer[-300:]!r}")
    parse = said(b"P", b"\0SELECT 1, 2\0\0\0") + said(b"B", b"\0\0" + b"\0" * 6)
    for rows in [-1, 2**31 - 1]:
        answer = wire(postgres, hello + parse + said(b"E", b"\0" + struct.pack("!i", rows)) + sync + end)
        check(b"SELECT 1\0" in answer, f"{rows} rows at once: {answer[-300:]!r}")
    cursor = b"DECLARE mine CURSOR FOR SELECT * FROM generate_series(1, 100)\0"
    for much, rows in [(b"2000000000", 100), (b"ALL", 100), (b"99999999999999999999999", 100), (b"70", 70)]:
        fetch = said(b"Q", cursor) + said(b"Q", b"FETCH " + much + b" FROM mine\0")
        answer = wire(postgres, hello + fetch + end)
        check(b"SELECT %d\0" % rows in answer, f"FETCH {much}: {answer[-300:]!r}")


def prepared(postgres):
    """More statements than a client may keep prepared are an error, unless it closes some; the next query is answered."""
    sync, end = said(b"S", b""), said(b"X", b"")
    statement = lambda name: said(b"P", name + b"\0SELECT 1\0\0\0")
    all_of_them = b"".join(statement(b"s%d" % at) for at in range(1024)) + sync
    closed = said(b"Q", b"DEALLOCATE s7\0") + statement(b"in its place") + sync
    message = start(user="me", database="map") + all_of_them + closed + statement(b"more") + sync + QUERY + end
    answer = wire(postgres, message)
    check(answer.count(b"54000") == 1 and b"SELECT 1\0" in answer, f"statements: {answer[-300:]!r}")


def before_a_password(postgres):
    """Queries that come before a password, or after a wrong answer, have no answer."""
    hello = start(user="ada", database="map")
    for what, message in [
        ("a query at once", QUERY),
        ("a query in place of a password", hello + QUERY),
        ("prepared", hello + said(b"P", b"\0SELECT 1\0\0\0") + said(b"S", b"")),
        ("an unknown mechanism", hello + said(b"p", b"PLAIN\0" + struct.pack("!i", -1)) + QUERY),
        ("no nonce", hello + said(b"p", b"SCRAM-SHA-256\0" + struct.pack("!i", 3) + b"abc") + QUERY),
        ("a plain password", hello + said(b"p", b"byron-1815\0") + QUERY),
        ("a long message", hello + b"p" + struct.pack("!i", 2**31 - 1) + b"x" * 100),
        ("a negative length", hello + b"p" + struct.pack("!i", -5) + QUERY),
        ("as if one were in", start(user="ada", database="map", evermap_in="true") + QUERY),
    ]:
        answer = wire(postgres, message)
        check(b"monday" not in answer and b"D\0" not in answer, f"{what}: {answer[:200]!r}")
    # Who is no user is asked for a password as a user is, with the same salt.
    first = b"n,,n=,r=0123456789abcdef"
    challenge = said(b"p", b"SCRAM-SHA-256\0" + struct.pack("!i", len(first)) + first)
    asked = [wire(postgres, start(user=user, database="map") + challenge) for user in ["ada", "nobody", "robot"]]
    salts = [re.search(rb",s=([^,]+),i=", answer) for answer in asked]
    check(all(salts) and len({salt[1] for salt in salts}) == 1, f"users are told from others: {asked}")
    for password in ["wrong-password", "", "byron-181"]:
        for user in ["ada", "nobody", "robot"]:
            try:
                connect(postgres, user=user, password=password or None).close()
                check(False, f"{user} came in with {password!r}")
            except psycopg.Error:
                pass


def paths(http):
    for path in [
        "/page/../Cargo.toml",
        "/page/..%2f..%2fCargo.toml",
        "/page/%2e%2e/%2e%2e/etc/passwd",
        "/layers/..%2f..%2fetc%2fpasswd",
        "/layers/poses%22%20UNION%20SELECT",
        "/tiles/lot/1/0/0/0",
        "/tiles/lot/1/x/0/0",
        "/tiles/lot'%20OR%201=1/1/0/0/0",
        "/maps/..%2fmap/layers",
        "/maps/other/layers",
        "/images?session=../../etc/passwd&camera=a&stamp=1",
        "/sql?query=COPY%20poses%20TO%20'/tmp/evermap-attack.csv'",
        "/sql?query=SELECT%201&format=exe",
        "/sql?query=SELECT%201&version=999",
        "/sql",
        "//etc/passwd",
        "/nothing",
        "/maps/map/nothing",
        "/layers/poses?format=xlsx",
        "/layers/poses?bogus=1",
        "/layers/poses?version=-1",
        "/layers/%ff",
        "/images?session=monday&camera=a&stamp=99999999999999999999",
        "/teach/lot?stamp=soon",
        "/teach/lot/spot?revision=-1",
        "/foxglove",
    ]:
        code, body = status(http + path)
        check(400 <= code < 500 and b"root:" not in body, f"{path}: {code} {body[:100]!r}")
        check(is_refusal(body), f"{path}: no reason: {body[:100]!r}")
    for path in ["/layers", "/maps/map/layers", "/health"]:
        code, body = status(http + path, data=b"more")
        check(code == 405 and is_refusal(body) and path.encode() in body, f"POST {path}: {code} {body[:100]!r}")


def is_refusal(body):
    """Whether it is what all errors are, an object of JSON."""
    try:
        return set(json.loads(body)) == {"error", "place", "next"}
    except ValueError:
        return False


def main(kind, http, postgres, ca=None):
    query = "/sql?query=SELECT%20count(*)%20AS%20n%20FROM%20poses"
    if kind == "open":
        refused(postgres)
        bounded(postgres)
        formats(postgres)
        malformed(postgres, start(user="me", database="map"), MESSAGES)
        malformed(postgres, b"", BEGINNINGS)
        parameters(postgres)
        prepared(postgres)
        paths(http)
        silent(http, postgres, HALF_A_HEAD)
        silent(http, postgres, HALF_A_BODY)
        code, answer = status(http + "/sql", data=b" " * (2 << 20) + b"SELECT 1")
        check(code == 413 and b'"error"' in answer, f"a body that is too long: {code} {answer[:200]!r}")
        code, _ = status(http + query, {"Host": "evil.example"})
        check(code == 403, f"a page of elsewhere: {code}")
        door = http_client.HTTPConnection(http)
        door.request("GET", "/maps/map")
        answer = door.getresponse()
        check((answer.status, answer.getheader("Location")) == (308, "/maps/map/"), f"/maps/map: {answer.status}")
        code, _ = status(http + "/sql", data=b"DROP TABLE poses")
        check(code == 400, f"DROP by HTTP: {code}")
    if kind == "slow":
        slow(http, postgres)
        busy(http)
    if kind == "closed":
        before_a_password(postgres)
        stranger(http)
        first = [b"", b"SCRAM-SHA-256\0", b"SCRAM-SHA-256\0" + struct.pack("!i", -2), b"SCRAM-SHA-256\0" + struct.pack("!i", 99)]
        long = said(b"Q", b"SELECT 1" + b" " * 10_000 + b"\0")
        malformed(postgres, start(user="ada", database="map"), [said(b"p", body) for body in first] + [long])
        with connect(postgres, password="byron-1815") as connection:
            check(connection.execute("SELECT count(*) FROM poses").fetchone()[0] > 0, "ada reads")
        for path in ["/", "/health", "/metrics", "/maps", "/page/index.html", query]:
            for header in [{}, {"Authorization": "Bearer wrong"}, {"Authorization": "Basic YWRhOg=="}]:
                code, _ = status(http + path, header)
                check(code == 401, f"{path} with {header}: {code}")
        code, _ = status(http + query, {"Authorization": "Bearer t0ken-t0ken"})
        check(code == 200, f"with a token: {code}")
        code, _ = status(http + query, {"Authorization": "Basic YWRhOmJ5cm9uLTE4MTU="})
        check(code == 200, f"with a password: {code}")
        header = "adbc.flight.sql.authorization_header"
        for token, comes_in in [("Bearer t0ken-t0ken", True), ("Bearer wrong", False)]:
            try:
                with adbc_driver_flightsql.dbapi.connect(
                    f"grpc://{http}", db_kwargs={header: token}, autocommit=True
                ) as connection, connection.cursor() as cursor:
                    cursor.execute("SELECT 1")
                    check(comes_in, f"ADBC came in with {token}")
            except adbc_driver_flightsql.dbapi.Error as error:
                check(not comes_in, f"ADBC with {token}: {error}")
    if kind == "private":
        context = ssl.create_default_context(cafile=ca)
        token = {"Authorization": "Bearer t0ken-t0ken"}
        code, _ = status(http.replace("127.0.0.1", "localhost") + query, token, scheme="https", context=context)
        check(code == 200, f"by TLS: {code}")
        try:
            status(http + query, token)
            check(False, "HTTP without TLS")
        except (http_client.HTTPException, OSError):
            pass
        # Its driver insists that the server says which protocol it speaks.
        options = {
            adbc_driver_flightsql.DatabaseOptions.TLS_ROOT_CERTS.value: open(ca).read(),
            adbc_driver_flightsql.DatabaseOptions.AUTHORIZATION_HEADER.value: token["Authorization"],
        }
        address = "grpc+tls://" + http.replace("127.0.0.1", "localhost")
        with adbc_driver_flightsql.dbapi.connect(address, db_kwargs=options, autocommit=True) as connection:
            with connection.cursor() as cursor:
                cursor.execute("SELECT 1 AS one")
                check(cursor.fetchone() == (1,), "Flight SQL by TLS")
        # As with `sslnegotiation=direct`: who comes in is asked for a password.
        for protocol, asked in [("postgresql", b"R"), ("http/1.1", b"")]:
            answer = at_once(postgres, ca, protocol)
            check(answer[:1] == asked, f"TLS at once, to speak {protocol}: {answer!r}")
        with connect(postgres, password="byron-1815", sslmode="require") as connection:
            check(connection.execute("SELECT 1").fetchone() == (1,), "by TLS")

        def free():
            metrics = http.replace("127.0.0.1", "localhost") + "/metrics"
            _, told = status(metrics, token, scheme="https", context=context)
            return int(re.search(rb"^evermap_queries_free (\d+)$", told, re.MULTILINE)[1])

        goes(postgres, free)
        try:
            connect(postgres, password="byron-1815", sslmode="disable").close()
            check(False, "Postgres without TLS")
        except psycopg.Error as error:
            check("TLS" in str(error), str(error))
        for bytes_ in [b"\x16\x03\x01\x00\x05hello", b"\0" * 100, b"GET / HTTP/1.1\r\n\r\n"]:
            wire(postgres, bytes_)
            wire(http, bytes_)
    for what in WRONG:
        print(what)
    print(f"{len(WRONG)} attacks succeeded")
    sys.exit(bool(WRONG))


main(*sys.argv[1:])
