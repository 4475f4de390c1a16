"""What drivers of Postgres say around queries: drivers.py POSTGRES"""

import subprocess
import sys

import psycopg


def fails(client, query, error, **more):
    try:
        client.execute(query, **more)
    except error:
        return
    sys.exit(f"{query} is no {error.__name__}")


def savepoints(connect):
    """An error aborts a transaction, until its client goes back to a savepoint or ends it."""
    failed = psycopg.errors.InFailedSqlTransaction
    with connect() as client:
        # As nested blocks are said, and by text and prepared.
        try:
            with client.transaction(), client.transaction():
                fails(client, "SELECT nothing FROM lanes", psycopg.errors.UndefinedColumn)
                fails(client, "SELECT 1", failed)
                raise psycopg.Rollback()
        except psycopg.Error as error:
            sys.exit(f"a nested block: {error}")
        for prepare in [False, True]:
            client.execute("SAVEPOINT mine", prepare=prepare)
            fails(client, "SELECT nothing FROM lanes", psycopg.errors.UndefinedColumn, prepare=prepare)
            assert client.info.transaction_status == psycopg.pq.TransactionStatus.INERROR
            for refused in ["SELECT 1", "SAVEPOINT other", "SHOW timezone", "BEGIN"]:
                fails(client, refused, failed, prepare=prepare)
            client.execute("ROLLBACK TO mine", prepare=prepare)
            assert client.info.transaction_status == psycopg.pq.TransactionStatus.INTRANS
            assert client.execute("SELECT 1", prepare=prepare).fetchone() == (1,)
        fails(client, "SELECT nothing FROM lanes", psycopg.errors.UndefinedColumn)
        client.rollback()
        assert client.execute("SELECT 1").fetchone() == (1,)


def psql(host, port):
    """psql goes back by itself where it is told so."""
    said = ["BEGIN", "SELECT nothing FROM lanes", "SELECT 41 + 1 AS still", "COMMIT"]
    commands = [part for query in said for part in ["-c", query]]
    door = ["-h", host, "-p", port, "-U", "me", "-d", "map"]
    ran = subprocess.run(["psql", "-X", "-v", "ON_ERROR_ROLLBACK=on", *door, *commands], capture_output=True, text=True)
    assert " 42" in ran.stdout and "COMMIT" in ran.stdout, ran


def main(postgres):
    host, port = postgres.split(":")
    savepoints(lambda: psycopg.connect(host=host, port=port, dbname="map", user="me"))
    psql(host, port)


main(*sys.argv[1:])
