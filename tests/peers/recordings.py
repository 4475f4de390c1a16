"""Recordings to measure on, made from a seed: the same bytes every time, nothing to download.

    recordings.py FOLDER      makes imu.mcap, long_imu.mcap, odometry.mcap and images.mcap there, if they are not there yet

- imu.mcap, odometry.mcap: 100,000 small CDR messages of one topic each, zstd chunks of 1 MiB, indexed.
- long_imu.mcap: ten times as many.
- images.mcap: 300 raw images of 640 × 480 grey pixels, the same way.
- A file NAME.plain.mcap is the same without compression: what is left of reading it is decoding.
"""

import random
import struct
import sys
from pathlib import Path

from mcap.writer import CompressionType, Writer

MESSAGES = 100_000
IMAGES = 300
WIDTH, HEIGHT = 640, 480

HEADER = """================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
GEOMETRY = """================================================================================
MSG: geometry_msgs/Vector3
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
"""
IMU = f"""std_msgs/Header header
geometry_msgs/Quaternion orientation
float64[9] orientation_covariance
geometry_msgs/Vector3 angular_velocity
float64[9] angular_velocity_covariance
geometry_msgs/Vector3 linear_acceleration
float64[9] linear_acceleration_covariance
{HEADER}{GEOMETRY}"""
ODOMETRY = f"""std_msgs/Header header
string child_frame_id
geometry_msgs/PoseWithCovariance pose
geometry_msgs/TwistWithCovariance twist
================================================================================
MSG: geometry_msgs/PoseWithCovariance
geometry_msgs/Pose pose
float64[36] covariance
================================================================================
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/TwistWithCovariance
geometry_msgs/Twist twist
float64[36] covariance
================================================================================
MSG: geometry_msgs/Twist
geometry_msgs/Vector3 linear
geometry_msgs/Vector3 angular
{HEADER}{GEOMETRY}"""
IMAGE = f"""std_msgs/Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
{HEADER}"""


def text(value):
    """A CDR string: its length with the closing zero, its bytes, the zero."""
    data = value.encode() + b"\0"
    return struct.pack("<I", len(data)) + data


def aligned(data, to):
    """CDR alignment counts from behind the 4-byte encapsulation header."""
    return data + b"\0" * (-(len(data) - 4) % to)


def opening(index, frame, period_ns=1_000_000):
    """The encapsulation header and a std_msgs/Header; and the stamp in it."""
    stamp = 1_700_000_000_000_000_000 + index * period_ns
    seconds, nanoseconds = divmod(stamp, 1_000_000_000)
    return stamp, b"\0\1\0\0" + struct.pack("<iI", seconds, nanoseconds) + text(frame)


def imus(noise, indices=range(MESSAGES)):
    """Readings of a shaking sensor; its covariances never change."""
    covariance = [0.01, 0, 0, 0, 0.01, 0, 0, 0, 0.01]
    body = struct.Struct("<37d")
    for index in indices:
        stamp, start = opening(index, "imu_link")
        turn, push = [noise.gauss(0, 0.1) for _ in range(3)], [noise.gauss(0, 1) for _ in range(3)]
        values = [0, 0, 0, 1, *covariance, *turn, *covariance, *push, *covariance]
        yield stamp, aligned(start, 8) + body.pack(*values)


def odometries(noise, indices=range(MESSAGES)):
    """A vehicle that wanders; its covariances grow."""
    body = struct.Struct("<85d")
    x = y = 0.0
    for index in indices:
        stamp, start = opening(index, "odom", period_ns=20_000_000)
        x, y = x + noise.gauss(0.02, 0.001), y + noise.gauss(0, 0.001)
        pose = [x, y, 0, 0, 0, 0, 1] + [1e-6 * index] + [0] * 35
        twist = [noise.gauss(1, 0.05), 0, 0, 0, 0, noise.gauss(0, 0.1)] + [1e-4] + [0] * 35
        yield stamp, aligned(aligned(start, 4) + text("base_link"), 8) + body.pack(*pose, *twist)


def images(noise):
    """Grey gradients that drift, with two bits of noise: they compress about as camera images do."""
    speckle = noise.randbytes(4 * WIDTH * HEIGHT)
    two_bits = bytes(value & 3 for value in range(256))
    speckle = speckle.translate(two_bits)
    ramp = bytes((value // 4) & 0xFC for value in range(2 * 1024))
    for index in range(IMAGES):
        stamp, start = opening(index, "camera", period_ns=80_000_000)
        rows = b"".join(ramp[(index + row) % 1024 :][:WIDTH] for row in range(HEIGHT))
        offset = noise.randrange(3 * WIDTH * HEIGHT)
        mixed = int.from_bytes(rows, "little") | int.from_bytes(speckle[offset:][: len(rows)], "little")
        middle = aligned(start, 4) + struct.pack("<II", HEIGHT, WIDTH) + text("mono8") + b"\0"
        body = aligned(middle, 4) + struct.pack("<II", WIDTH, len(rows)) + mixed.to_bytes(len(rows), "little")
        yield stamp, body


KINDS = {
    "imu": ("/imu", "sensor_msgs/msg/Imu", IMU, imus),
    "long_imu": ("/imu", "sensor_msgs/msg/Imu", IMU, lambda noise: imus(noise, range(10 * MESSAGES))),
    "odometry": ("/odom", "nav_msgs/msg/Odometry", ODOMETRY, odometries),
    "images": ("/image", "sensor_msgs/msg/Image", IMAGE, images),
}


def write(path, kind, compression, made=None):
    """Writes a recording, of the messages that are given or those of its kind; it has its name only when it is complete."""
    topic, schema_name, schema, messages = KINDS[kind]
    partial = path.with_suffix(".part")
    with open(partial, "wb") as file:
        writer = Writer(file, chunk_size=1 << 20, compression=compression)
        writer.start(profile="ros2", library="evermap peers")
        schema_id = writer.register_schema(schema_name, "ros2msg", schema.encode())
        channel = writer.register_channel(topic, "cdr", schema_id)
        for sequence, (stamp, payload) in enumerate(made or messages(random.Random(1))):
            writer.add_message(channel, stamp, payload, stamp, sequence)
        writer.finish()
    partial.rename(path)


def recording(folder, kind, plain=False):
    """The path and the topic of a recording, made now if it is not there."""
    path = Path(folder) / (f"{kind}.plain.mcap" if plain else f"{kind}.mcap")
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        write(path, kind, CompressionType.NONE if plain else CompressionType.ZSTD)
    return str(path), KINDS[kind][0]


if __name__ == "__main__":
    for name in KINDS:
        print(recording(sys.argv[1], name)[0])
