"""Reads a served map by many clients at once until standard input ends, and holds every answer to one version.

    readers.py POSTGRES HTTP
"""

import json
import sys
import threading
import time
import urllib.request

import psycopg

QUERY = """
SELECT (SELECT count(DISTINCT session) FROM poses) AS version,
       (SELECT count(*) FROM poses) AS poses,
       (SELECT count(*) FROM lanes) - (SELECT rows FROM layers WHERE layer = 'lanes') AS off,
       (SELECT rows FROM layers WHERE layer = 'poses') AS listed
"""
CLIENTS = 20
ENOUGH = threading.Event()
SEEN, WRONG = {}, []
LAST = [0]


def hold(version, poses, off, listed):
    """One drive a version: sessions are counted as versions are. A version has one number of poses."""
    if poses != listed or off != 0 or SEEN.setdefault(version, poses) != poses:
        WRONG.append((version, poses, off, listed))


def by_postgres(postgres):
    host, port = postgres.split(":")
    with psycopg.connect(host=host, port=port, dbname="map", user="me", autocommit=True) as client:
        newest = 0
        while True:
            # What is asked after the last version was published shows it.
            last = ENOUGH.is_set()
            row = client.execute(QUERY).fetchone()
            hold(*map(int, row))
            if row[0] < newest:
                WRONG.append(("older than before", row))
            newest = row[0]
            if last:
                LAST[0] = int(row[1])
                return


def by_http(http):
    while not ENOUGH.is_set():
        request = urllib.request.Request(f"http://{http}/sql", data=QUERY.encode(), method="POST")
        with urllib.request.urlopen(request) as answer:
            hold(*json.load(answer)[0].values())


def kept(work, address):
    try:
        work(address)
    except Exception as error:
        WRONG.append(repr(error))


def main(postgres, http):
    clients = [(by_postgres, postgres)] * CLIENTS + [(by_http, http)] * 4
    threads = [threading.Thread(target=kept, args=client) for client in clients]
    for thread in threads:
        thread.start()
    while not SEEN and not WRONG:
        time.sleep(0.01)
    print("reading", flush=True)
    sys.stdin.read()
    ENOUGH.set()
    for thread in threads:
        thread.join()
    for what in WRONG[:10]:
        print(what)
    print(f"versions {sorted(SEEN)}, last {LAST[0]}")
    sys.exit(bool(WRONG))


main(*sys.argv[1:])
