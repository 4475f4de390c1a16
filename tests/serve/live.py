"""Watches a served map as Foxglove does, by its WebSocket protocol.

    live.py same HTTP RECORDING.mcap    all that is played is what the export of the map has
    live.py watched HTTP                subscriptions, time and what must be refused, on a server that lets everybody in
    live.py closed HTTP                 one with the token `t0ken-t0ken`
    live.py private HTTP CA             the same with TLS, by a certificate of CA
    live.py slow HTTP                   viewers that take nothing, until standard input ends
"""

import base64
import json
import ssl
import struct
import sys
import time
import urllib.request
from collections import Counter

from mcap.reader import make_reader
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

PLAYING, PAUSED, ENDED = 0, 1, 3


class Viewer:
    def __init__(self, address, protocol="foxglove.sdk.v1", scheme="ws", **more):
        self.socket = connect(f"{scheme}://{address}", subprotocols=[protocol], max_size=None, open_timeout=60, **more)
        assert self.socket.subprotocol == protocol
        self.channels, self.info, self.state, self.time = {}, None, None, None
        while self.state is None:
            self.next()
        assert self.info["op"] == "serverInfo" and {"time", "playbackControl"} <= set(self.info["capabilities"])

    def next(self):
        """The next message: (subscription, log time, payload), or an operation."""
        said = self.socket.recv(timeout=60)
        if isinstance(said, str):
            said = json.loads(said)
            if said["op"] == "serverInfo":
                self.info = said
            if said["op"] == "advertise":
                self.channels |= {channel["id"]: channel for channel in said["channels"]}
            return said
        if said[0] == 1:
            return *struct.unpack_from("<IQ", said, 1), said[13:]
        if said[0] == 2:
            (self.time,) = struct.unpack_from("<Q", said, 1)
        if said[0] == 5:
            status, at, speed, seeked, length = struct.unpack_from("<BQfBI", said, 1)
            self.state = (status, at, speed, bool(seeked), said[19 : 19 + length].decode())
        return said[0]

    def ask(self, **operation):
        self.socket.send(json.dumps(operation))

    def subscribe(self, channels):
        """Subscriptions have other numbers than channels."""
        wanted = [{"id": 1000 + channel, "channelId": channel} for channel in channels]
        self.ask(op="subscribe", subscriptions=wanted)

    def control(self, playing=True, speed=1000.0, seek=None, request="r"):
        command = struct.pack("<BBfBQI", 3, not playing, speed, seek is not None, seek or 0, len(request))
        self.socket.send(command + request.encode())

    def until(self, done):
        """Messages that come until something is so."""
        messages = []
        while not done():
            said = self.next()
            if isinstance(said, tuple):
                messages.append(said)
        return messages

    def answered(self, request):
        return self.until(lambda: self.state[4] == request)

    def ended(self):
        return self.until(lambda: self.state[0] == ENDED)

    def number(self, topic):
        (number,) = [number for number, channel in self.channels.items() if channel["topic"] == topic]
        return number


def same(http, recording):
    expected, schemas = Counter(), {}
    with open(recording, "rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            expected[channel.topic, message.log_time, message.data] += 1
            schemas[channel.topic] = (schema.name, schema.encoding, schema.data, channel.message_encoding)
    viewer = Viewer(http + "/foxglove")
    for channel in viewer.channels.values():
        data = channel["schema"].encode()
        if channel["schemaEncoding"] == "protobuf":
            data = base64.b64decode(data)
        told = (channel["schemaName"], channel["schemaEncoding"], data, channel["encoding"])
        assert schemas.pop(channel["topic"]) == told, channel["topic"]
    assert not schemas, schemas.keys()
    stamps = [stamp for _, stamp, _ in expected]
    for key, stamp in (("dataStartTime", min(stamps)), ("dataEndTime", max(stamps))):
        assert viewer.info[key] == {"sec": stamp // 10**9, "nsec": stamp % 10**9}, key
    # Nothing is played before it is asked for; then it can be played as fast as it can be taken.
    assert viewer.state[0] == PAUSED
    viewer.control(playing=False, request="still")
    viewer.answered("still")
    viewer.subscribe(viewer.channels)
    viewer.control(request="go")
    found = Counter()
    for subscription, stamp, payload in viewer.ended():
        found[viewer.channels[subscription - 1000]["topic"], stamp, payload] += 1
    missing, more = expected - found, found - expected
    assert not missing and not more, (len(missing), len(more), sum(expected.values()))
    assert viewer.state[1] == max(stamps)
    print(f"{sum(found.values())} messages of {len(viewer.channels)} channels")


def watched(http):
    viewer = Viewer(http + "/maps/map/foxglove", "foxglove.websocket.v1")
    tf, lanes = viewer.number("/tf"), viewer.number("/lanes")
    # The first subscription begins it, in the time of the drive.
    begun = time.monotonic()
    viewer.subscribe([tf])
    first = viewer.until(lambda: viewer.state[0] == PLAYING and viewer.time is not None)
    messages = first + [viewer.next() for _ in range(20)]
    messages = [one for one in messages if isinstance(one, tuple)]
    assert messages and all(one[0] == 1000 + tf for one in messages)
    played = (messages[-1][1] - messages[0][1]) * 1e-9
    assert played <= time.monotonic() - begun + 1.5, played
    # Who comes later to what holds is told it.
    viewer.control(playing=False, request="stand")
    viewer.answered("stand")
    assert viewer.state[0] == PAUSED
    viewer.subscribe([lanes])
    told = viewer.next()
    assert told[0] == 1000 + lanes and told[1] >= messages[-1][1], told[:2]
    # Nothing comes while it stands, and nothing after it was unsubscribed.
    viewer.ask(op="unsubscribe", subscriptionIds=[1000 + tf])
    viewer.control(request="on")
    rest = viewer.ended()
    assert not rest, rest[:1]
    # From the middle on, with what holds; then, anew, from the beginning.
    first, last = ((viewer.info[key]["sec"] * 10**9 + viewer.info[key]["nsec"]) for key in ("dataStartTime", "dataEndTime"))
    viewer.subscribe([tf])
    viewer.control(seek=(first + last) // 2, request="middle")
    viewer.answered("middle")
    assert viewer.state[3] and viewer.state[1] >= (first + last) // 2
    rest = viewer.ended()
    assert Counter(one[0] for one in rest)[1000 + lanes] == 1
    assert all(one[1] >= (first + last) // 2 for one in rest)
    viewer.control(request="anew")
    viewer.answered("anew")
    assert viewer.state[3] and viewer.state[1] == first
    again = viewer.ended()
    assert len(again) > len(rest) and again[0][1] == first
    # One session.
    monday = Viewer(http + "/foxglove?session=monday")
    assert {channel["topic"] for channel in monday.channels.values()} >= {"/trajectory/monday", "/tf"}
    assert all("tuesday" not in channel["topic"] for channel in monday.channels.values())

    # What makes no sense is said, and the viewer stays.
    for wrong in ["{", "[]", '{"op":"subscribe","subscriptions":[{"id":1,"channelId":99999}]}', b"\x03\x07", b"\x03" * 40]:
        viewer.socket.send(wrong)
        said = viewer.next()
        assert said["op"] == "status" and said["level"] == 2, said
    viewer.socket.send(b"")
    viewer.ask(op="getParameters", parameterNames=["a"])
    viewer.control(playing=False, request="there")
    viewer.answered("there")
    # What is larger than any request ends the connection.
    try:
        viewer.socket.send("x" * (2 << 20))
        viewer.until(lambda: False)
        raise SystemExit("a message of 2 MiB was taken")
    except ConnectionClosed:
        pass
    gone = Viewer.__new__(Viewer)
    gone.socket = connect(f"ws://{http}/foxglove?session=sunday", subprotocols=["foxglove.sdk.v1"])
    gone.channels, gone.info, gone.state, gone.time = {}, None, None, None
    assert gone.next()["op"] == "serverInfo"
    said = gone.next()
    assert said["op"] == "status" and "no poses of session sunday" in said["message"], said

    for code, asked, more in [
        (403, "", {"origin": "https://evil.example"}),
        # Nobody has a token where there are no users.
        (403, "?token=anything", {"origin": "https://evil.example"}),
        (403, "?token=", {"origin": "https://evil.example"}),
        (403, "", {"origin": "null"}),
        (403, "", {"origin": "https://app.foxglove.dev.evil.example"}),
        (403, "", {"origin": f"https://{http}.evil.example"}),
        (400, "", {"subprotocols": ["graphql-ws"]}),
        (400, "", {"subprotocols": None}),
    ]:
        try:
            connect(f"ws://{http}/foxglove{asked}", **({"subprotocols": ["foxglove.sdk.v1"]} | more)).close()
            raise SystemExit(f"came in with {asked} {more}")
        except InvalidStatus as error:
            assert error.response.status_code == code, (error, asked, more)
    # A program that is no page may say one all the same.
    Viewer(http + "/foxglove?token=anything").socket.close()
    for origin in ["https://app.foxglove.dev", "file://", "http://localhost:8080", f"http://{http}"]:
        Viewer(http + "/foxglove", origin=origin).socket.close()


def closed(http):
    for address, more in [
        ("/foxglove", {}),
        ("/foxglove?token=wrong-wrong", {}),
        ("/foxglove?token=", {}),
        ("/maps?token=t0ken-t0ken", {}),
        ("/foxglove", {"additional_headers": {"Authorization": "Bearer wrong"}}),
    ]:
        try:
            connect(f"ws://{http}{address}", subprotocols=["foxglove.sdk.v1"], **more).close()
            raise SystemExit(f"came in by {address} {more}")
        except InvalidStatus as error:
            assert error.response.status_code == 401, error
    # Who has a token was given it, whatever page it is used on.
    Viewer(http + "/foxglove?token=t0ken-t0ken", origin="https://viewers.example").socket.close()
    token = {"Authorization": "Bearer t0ken-t0ken"}
    Viewer(http + "/foxglove", additional_headers=token).socket.close()
    try:
        Viewer(http + "/foxglove", additional_headers=token, origin="https://evil.example")
        raise SystemExit("a page of elsewhere came in by what the browser remembers")
    except InvalidStatus as error:
        assert error.response.status_code == 403, error


def private(http, ca):
    context = ssl.create_default_context(cafile=ca)
    address = http.replace("127.0.0.1", "localhost") + "/foxglove?token=t0ken-t0ken"
    viewer = Viewer(address, scheme="wss", ssl=context)
    viewer.subscribe(viewer.channels)
    viewer.control()
    assert viewer.ended()


def slow(http):
    viewers = []
    for _ in range(16):
        viewer = Viewer(http + "/foxglove")
        viewer.subscribe(viewer.channels)
        # Anew and anew, and none of it is read.
        for _ in range(2000):
            viewer.control(seek=0)
        viewers.append(viewer)
    try:
        Viewer(http + "/foxglove")
        raise SystemExit("more viewers than places")
    except InvalidStatus as error:
        assert error.response.status_code == 503, error
    with urllib.request.urlopen(f"http://{http}/sql?query=SELECT%20count(*)%20AS%20n%20FROM%20poses") as answer:
        assert json.load(answer)[0]["n"] > 0
    print("watching", flush=True)
    sys.stdin.read()


MODES = {"same": same, "watched": watched, "closed": closed, "private": private, "slow": slow}
MODES[sys.argv[1]](*sys.argv[2:])
