"""Asks by statements that are prepared once while files are replaced: prepared.py POSTGRES MAP LOGS"""

import json
import shutil
import sys
import time
from pathlib import Path

import psycopg


def main(postgres, map, logs):
    map, logs = Path(map), Path(logs)
    host, port = postgres.split(":")
    client = psycopg.connect(host=host, port=port, dbname="map", user="me", autocommit=True)
    bare = client.pgconn

    def prepared(name, query):
        said = bare.prepare(name, query).error_message
        assert not said, said

        def ask():
            found = bare.exec_prepared(name, [])
            if found.error_message:
                return found.error_message.decode()
            return [found.get_value(0, column) for column in range(found.nfields)]

        return ask

    # What was just looked at is believed for a while: until then Parquet may be what stumbles over it.
    def noticed(ask, is_meant):
        end = time.monotonic() + 60
        while not is_meant(found := ask()) and time.monotonic() < end:
            time.sleep(0.1)
        return found

    lanes = prepared(b"lanes", b"SELECT count(*), sum(length_m) FROM lanes")
    first = lanes()
    assert isinstance(first, list) and int(first[0]) > 0, first
    version = json.loads((map / "versions/2.json").read_text())
    content = version["layers"]["lanes"]["artifacts"][0]["content"]
    path = map / f"artifacts/{content}.parquet"
    whole = path.read_bytes()
    other = bytearray(whole)
    other[len(whole) // 2] ^= 0x7F
    path.write_bytes(other)
    refused = noticed(lanes, lambda found: "expected the digest" in found)
    assert "expected the digest" in refused, refused
    path.write_bytes(whole)
    assert noticed(lanes, lambda found: found != refused) == first

    monday, tuesday = (
        prepared(day.encode(), f"SELECT count(*) FROM {day}.messages".encode()) for day in ("monday", "tuesday")
    )
    before = monday()
    assert isinstance(before, list) and before != tuesday(), before
    shutil.copy(logs / "monday.mcap", logs / "tuesday.mcap")
    assert tuesday() == before


main(*sys.argv[1:])
