"""A session as long as wanted, from a short one: its messages again and again, each time later.

    long_session.py FILE.mcap OUT.mcap TIMES

Header stamps (CDR, little endian, right behind the encapsulation header) and log times move on together, so the long
session is one drive that repeats its route. Watch what a run holds in memory, which must not grow with the session:

    /usr/bin/time -f '%M KiB' evermap run car_park --map MAP --sessions OUT.mcap
"""

import struct
import sys

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

GAP_NS = 1_000_000_000


def shifted(data, by):
    """The payload with its header stamp moved by so many nanoseconds."""
    seconds, nanoseconds = struct.unpack_from("<iI", data, 4)
    stamp = seconds * 1_000_000_000 + nanoseconds + by
    return data[:4] + struct.pack("<iI", *divmod(stamp, 1_000_000_000)) + data[12:]


def main():
    """Writes the long session."""
    source, target, times = sys.argv[1], sys.argv[2], int(sys.argv[3])
    with open(source, "rb") as file, open(target, "wb") as out:
        reader = make_reader(file)
        summary = reader.get_summary()
        step = summary.statistics.message_end_time - summary.statistics.message_start_time + GAP_NS
        writer = Writer(out, compression=CompressionType.LZ4, chunk_size=1 << 20)
        writer.start(profile="ros2")
        schemas = {
            id: writer.register_schema(schema.name, schema.encoding, schema.data)
            for id, schema in summary.schemas.items()
        }
        channels = {
            id: writer.register_channel(channel.topic, channel.message_encoding, schemas[channel.schema_id])
            for id, channel in summary.channels.items()
        }
        for time in range(times):
            for _, channel, message in reader.iter_messages():
                fixed = channel.topic == "/tf_static"
                if fixed and time > 0:
                    continue
                by = time * step
                data = message.data if fixed else shifted(message.data, by)
                log_time = message.log_time + by
                writer.add_message(channels[channel.id], log_time, data, log_time, message.sequence)
        writer.finish()


if __name__ == "__main__":
    main()
