"""Has all places that one address gets, two, and asks from another: crowd.py HTTP POSTGRES"""

import socket
import struct
import sys
import time

import psycopg

HERE, ELSEWHERE = "127.0.0.1", "127.0.0.2"
FULL = "expected at most 2 connections from 127.0.0.1 at once"
HEALTH = b"GET /health HTTP/1.1\r\nHost: localhost\r\n\r\n"
ONCE = HEALTH.replace(b"\r\n\r\n", b"\r\nConnection: close\r\n\r\n")


def opened(address, of):
    host, port = address.split(":")
    return socket.create_connection((host, int(port)), timeout=30, source_address=(of, 0))


def asked(stream, message):
    stream.sendall(message)
    return stream.recv(4096)


def health(http, of):
    with opened(http, of) as stream:
        answer = asked(stream, ONCE)
        while piece := stream.recv(4096):
            answer += piece
        return answer


def until(ask):
    """What is free again is known soon after its client has gone."""
    end = time.monotonic() + 30
    while not ask():
        assert time.monotonic() < end
        time.sleep(0.1)


def main(http, postgres):
    two = [opened(http, HERE) for _ in range(2)]
    for stream in two:
        assert asked(stream, HEALTH).startswith(b"HTTP/1.1 200")
    refused = health(http, HERE)
    assert refused.startswith(b"HTTP/1.1 503") and FULL.encode() in refused, refused
    assert b"--per-address" in refused, refused
    assert health(http, ELSEWHERE).startswith(b"HTTP/1.1 200")
    assert asked(two[0], HEALTH).startswith(b"HTTP/1.1 200")
    for stream in two:
        stream.close()
    until(lambda: health(http, HERE).startswith(b"HTTP/1.1 200"))

    host, port = postgres.split(":")

    def client():
        return psycopg.connect(host=host, port=port, dbname="map", user="me")

    clients = [client() for _ in range(2)]
    try:
        client()
    except psycopg.OperationalError as error:
        assert FULL in str(error), error
    else:
        raise AssertionError("a third client")
    said = struct.pack("!i", 196608) + b"user\0me\0database\0map\0\0"
    with opened(postgres, ELSEWHERE) as stream:
        answer = asked(stream, struct.pack("!i", len(said) + 4) + said)
        assert answer.startswith(b"R"), answer
    assert clients[0].execute("SELECT 1").fetchone() == (1,)
    clients[1].close()

    def comes_in():
        try:
            client().close()
        except psycopg.OperationalError:
            return False
        return True

    until(comes_in)


main(*sys.argv[1:])
