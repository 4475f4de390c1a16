"""Rows per second from MCAP to decoded messages, on one core: our scan to Arrow, mcap-ros2-support, roboto-mcap-codec.

All decode every field of 100,000 messages of one topic. Ours and `roboto-mcap-codec` give Arrow batches,
`mcap-ros2-support` Python objects. "decode only" is roboto reading a copy without compression from memory: no disk,
no zstd. Ours always reads the compressed file.
"""

import json
import sys
import time

from recordings import MESSAGES, recording
from side_by_side import Contender, arguments, race, table


def official(path, topic):
    """Rows decoded by `mcap` and `mcap-ros2-support`."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        return sum(1 for _ in reader.iter_decoded_messages(topics=[topic], log_time_order=False))


def roboto(path, topic):
    """Rows decoded by `roboto-mcap-codec` to Arrow."""
    import mcap_codec

    with open(path, "rb") as file:
        data = file.read()
    start = time.perf_counter()
    cursor = mcap_codec.open_mcap_file(
        lambda offset, length: data[offset : offset + length],
        len(data),
        channel=mcap_codec.TopicName(topic),
        timestamp=mcap_codec.TimestampSource("message_log_time"),
    )
    with cursor:
        rows = sum(batch.num_rows for batch in cursor)
    return rows, time.perf_counter() - start


def worker(peer, path, topic):
    """Does a peer's work once, in a process of its own; imports are off the clock."""
    if peer == "roboto":
        import pyarrow  # noqa: F401

        rows, seconds = roboto(path, topic)
    else:
        import mcap_ros2.decoder  # noqa: F401

        start = time.perf_counter()
        rows = official(path, topic)
        seconds = time.perf_counter() - start
    print(json.dumps({"rows": rows, "seconds": seconds}))


def main():
    """Races them on two message types."""
    given = arguments(__doc__).parse_args()
    for kind in ("imu", "odometry"):
        path, topic = recording(given.folder, kind)
        plain, _ = recording(given.folder, kind, plain=True)
        python = [sys.executable, __file__, "--worker"]
        contenders = [
            Contender("evermap scan", [given.scan, path, topic, "--threads", "1"]),
            Contender("roboto-mcap-codec", [*python, "roboto", path, topic]),
            Contender("roboto-mcap-codec, decode only", [*python, "roboto", plain, topic]),
            Contender("mcap-ros2-support", [*python, "official", path, topic]),
        ]
        race(contenders, given.runs, given.core)
        table(f"{MESSAGES:,} {kind} messages, one core", contenders, MESSAGES, "rows")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--worker"]:
        worker(*sys.argv[2:5])
    else:
        main()
