"""Every message of some topics, as the official Python readers decode it: one JSON object a line.

    check_values.py [--digest] FILE TOPIC...

    {"topic": "/odom", "log_time": 1, "publish_time": 1, "sequence": 0, "message": {"header": {"stamp": …}}}

Lines are in log-time order. Messages are objects with their fields as declared, nested ones too.
- Byte arrays are lower-case hexadecimal, or with --digest {"length": 3, "sha256": "…"}.
- JSON has no NaN or infinities: they are the strings "NaN", "Infinity", "-Infinity".
- Payloads that rosbag2 compressed message by message (compression_mode: MESSAGE) are decompressed first: the readers
  leave that to their caller.
- A float32 is printed as the double of the same value: compare it after rounding to float32.
"""

import argparse
import hashlib
import json
import math
import sys

import zstandard
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"  # no CDR encapsulation header begins like this


def messages(file, topics):
    """Channel, record and decoded message of every message, in log-time order."""
    decoders = DecoderFactory()
    for schema, channel, record in make_reader(file).iter_messages(topics=topics):
        payload = record.data
        if payload.startswith(ZSTD_MAGIC):
            payload = zstandard.ZstdDecompressor().decompressobj().decompress(payload)
        decode = decoders.decoder_for(channel.message_encoding, schema)
        if decode is None:
            sys.exit(f"{channel.topic} is {channel.message_encoding}, which mcap-ros2-support does not decode")
        yield channel, record, decode(payload)


def plain(value, as_bytes):
    """A decoded value in the types that JSON has."""
    if isinstance(value, (bytes, bytearray, memoryview)):
        return as_bytes(bytes(value))
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    if hasattr(type(value), "_full_text"):  # a message: its fields are its slots
        return {name: plain(getattr(value, name), as_bytes) for name in type(value).__slots__}
    return [plain(item, as_bytes) for item in value]


def digest(data):
    """Bytes as their length and SHA-256."""
    return {"length": len(data), "sha256": hashlib.sha256(data).hexdigest()}


def main():
    """Prints the messages."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--digest", action="store_true", help="byte arrays as length and SHA-256")
    parser.add_argument("file")
    parser.add_argument("topics", nargs="+", metavar="topic")
    given = parser.parse_args()
    as_bytes = digest if given.digest else bytes.hex
    with open(given.file, "rb") as file:
        for channel, record, message in messages(file, given.topics):
            line = {
                "topic": channel.topic,
                "log_time": record.log_time,
                "publish_time": record.publish_time,
                "sequence": record.sequence,
                "message": plain(message, as_bytes),
            }
            json.dump(line, sys.stdout, allow_nan=False, separators=(",", ":"))
            sys.stdout.write("\n")


if __name__ == "__main__":
    main()
